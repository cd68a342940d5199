"""What the readers of logs share: one error, MATLAB files, points from ranges and bearings."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.io import loadmat

from slam_gym.types import Array, IntArray


class RecordingError(ValueError):
    """A recording, or a file that should hold one, is not what it should be. Names the file, field or line."""


def refuse(name: str, bad: Any, what: str) -> None:
    """RecordingError naming the first entry of a field at which `bad` (n,) holds."""
    if bad.any():
        raise RecordingError(f"field {name!r}: entry {int(np.flatnonzero(bad)[0])} {what}")


def check_shapes(record: object, shapes: dict[str, tuple[int, ...]]) -> None:
    """RecordingError naming the first field of a record whose array has another shape."""
    for name, shape in shapes.items():
        found = np.shape(getattr(record, name))
        if found != shape:
            raise RecordingError(f"field {name!r} has shape {found}, expected {shape}")


def check_finite(record: object, names: Iterable[str]) -> None:
    """RecordingError naming the first field and entry that is not finite."""
    for name in names:
        finite = np.isfinite(getattr(record, name))
        refuse(name, ~finite.all(axis=tuple(range(1, finite.ndim))), "is not finite")


def check_starts(starts: IntArray, count: int) -> None:
    """RecordingError unless `starts` ascends from 0 to the number of measurements."""
    refuse("starts", np.diff(starts, prepend=0) < 0, "descends")
    if starts[0] != 0 or starts[-1] != count:
        raise RecordingError(f"field 'starts' goes from {starts[0]} to {starts[-1]}, expected 0 to {count}")


def starts_of(counts: ArrayLike) -> IntArray:
    """(T + 1,) rows at which the measurements of each step start, and their end, from their numbers (T,)."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


class Points(NamedTuple):
    """Measured points in R."""

    points: Array  # (M, 2) [m]
    covariances: Array  # (M, 2, 2) [m²]


def from_polar(ranges: Array, bearings: Array, range_variance: float | Array, bearing_sigma: float) -> Points:
    """Points from ranges (M,) [m] with a variance [m²], for all or each (M,), and bearings (M,) with a σ [rad]."""
    ahead = np.column_stack([np.cos(bearings), np.sin(bearings)])
    aside = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    along = np.broadcast_to(range_variance, ranges.shape)[:, None, None]
    across = np.square(bearing_sigma * ranges)[:, None, None]
    covariances = along * ahead[:, :, None] * ahead[:, None, :]
    covariances += across * aside[:, :, None] * aside[:, None, :]
    return Points(ranges[:, None] * ahead, covariances)


def read_matlab(path: Path, names: Iterable[str], source: str) -> dict[str, Any]:
    """The variables of a MATLAB file from a `source` to be cited.

    Raises FileNotFoundError, or RecordingError for what is unreadable or missing.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: not there. {source}")
    try:
        content: dict[str, Any] = loadmat(path)
    except Exception as error:  # scipy raises whatever the damage leads to
        raise RecordingError(f"{path}: no readable MATLAB file: {error}") from error
    for name in names:
        if name not in content:
            raise RecordingError(f"{path}: variable {name!r} is missing")
    return {name: content[name] for name in names}
