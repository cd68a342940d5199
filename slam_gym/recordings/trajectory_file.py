"""Trajectories in the format that `evo` and others read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike


def write_tum(path: str | Path, times: ArrayLike, poses: ArrayLike) -> None:
    """Poses (t, 3) [m, m, rad] at `times` (t,) [s], one a line: `t x y z qx qy qz qw` (Sturm et al., IROS 2012).

    Raises ValueError where the shapes do not fit, or a number is not finite.
    """
    at, trajectory = np.asarray(times, np.float64), np.asarray(poses, np.float64)
    if at.ndim != 1 or trajectory.shape != (len(at), 3):
        raise ValueError(f"times, poses: shapes {at.shape} and {trajectory.shape}, expected (t,) and (t, 3)")
    if not (np.isfinite(at).all() and np.isfinite(trajectory).all()):
        raise ValueError("times, poses: not all of them are finite")
    half, zero = 0.5 * trajectory[:, 2], np.zeros(len(at))
    rows = np.column_stack([at, trajectory[:, :2], zero, zero, zero, np.sin(half), np.cos(half)])
    np.savetxt(path, rows, fmt="%.9g", header="timestamp x y z qx qy qz qw")
