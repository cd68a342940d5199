"""Trajectory errors of estimated against true poses (t, 3), pose i at the instant of pose i."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from slam_gym.metrics.map_quality import landmark_rmse
from slam_gym.types import Array


@dataclass(frozen=True, slots=True)
class PoseError:
    """Root mean square errors."""

    translation: float  # [m]
    rotation: float  # [rad]


def ate(estimated: Array, true: Array, *, aligned: bool = False) -> float:
    """Absolute trajectory error [m]: root mean square distance of the estimated from the true positions.

    Of poses (t, 3) or positions (t, 2), all in one frame; `aligned` first moves the estimate rigidly onto the truth
    (Sturm et al., IROS 2012), for estimates that live in a frame of their own. NaN for t = 0. Raises ValueError
    where the shapes differ or a value is not finite.
    """
    return landmark_rmse(estimated[:, :2], true[:, :2], aligned=aligned)


def rpe(estimated: Array, true: Array, *, delta: int = 1) -> PoseError:
    """Relative pose error of poses (t, 3): of the motion over `delta` steps, each seen from its own start.

    Needs no alignment (Sturm et al., IROS 2012). NaN for t ≤ delta. ValueError as `ate`, or for delta < 1.
    """
    estimated, true = _trajectories(estimated, true)
    if delta < 1:
        raise ValueError(f"delta must be at least 1 step, got {delta}")
    motion, true_motion = (_relative(poses[:-delta], poses[delta:]) for poses in (estimated, true))
    return _rms(_relative(true_motion, motion))


def _relative(a: Array, b: Array) -> Array:
    """⊖a ⊕ b, row by row."""
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    x, y = b[:, 0] - a[:, 0], b[:, 1] - a[:, 1]
    return np.column_stack([c * x + s * y, -s * x + c * y, b[:, 2] - a[:, 2]])


def _rms(errors: Array) -> PoseError:
    if not len(errors):
        return PoseError(math.nan, math.nan)
    turn = np.arctan2(np.sin(errors[:, 2]), np.cos(errors[:, 2]))
    return PoseError(math.sqrt((errors[:, :2] ** 2).sum(axis=1).mean()), math.sqrt((turn**2).mean()))


def _trajectories(estimated: Array, true: Array) -> tuple[Array, Array]:
    estimated, true = np.asarray(estimated, np.float64), np.asarray(true, np.float64)
    if estimated.ndim != 2 or estimated.shape[1] != 3 or estimated.shape != true.shape:
        raise ValueError(f"trajectories must both be poses (t, 3), got {estimated.shape} and {true.shape}")
    if not (np.isfinite(estimated).all() and np.isfinite(true).all()):
        raise ValueError("trajectories must be finite")
    return estimated, true
