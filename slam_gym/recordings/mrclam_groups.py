"""MR.CLAM's stationary groups as relocation cases; S. Choi extracted them (Triangulation Toolbox, `mrclamN.mat`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from slam_gym.recordings.mrclam import SOURCE, TERMS, Noise
from slam_gym.recordings.reading import RecordingError, read_matlab, starts_of
from slam_gym.recordings.relocation_cases import RelocationCases
from slam_gym.types import Array

GROUPED = Noise(range=0.15, range_per_metre=0.0, bearing=0.02)
"""That of the stationary groups, as their poses show it: σ of ranges 0.14 to 0.16 m, of bearings 0.013 to 0.024 rad."""
_COLUMNS = {"landmark": 3, "groundtruth": 4, "measurement": 4}  # of the variables of a file


def stationary(path: str | Path, noise: Noise | None = None) -> RelocationCases:
    """Groups of three or more measurements that a robot made within a second and a centimetre, with its true pose.

    From a file `mrclamN.mat`, N = 1 … 5; landmarks are numbered from 1. Gross errors were removed by those who
    extracted the groups, and barcodes of robots too: nothing is spurious. Most groups repeat the one before, since
    robots stand still for long. `noise` is by default that of the groups themselves. Raises FileNotFoundError, or
    RecordingError that names file, variable and row.
    """
    noise, path = noise or GROUPED, Path(path)
    content = read_matlab(path, _COLUMNS, SOURCE)
    landmarks, truth, measured = (_checked_table(path, name, content[name]) for name in _COLUMNS)
    if not np.array_equal(truth[:, 0], np.arange(1, len(truth) + 1)):
        raise RecordingError(f"{path}: variable 'groundtruth': the cases are not numbered 1 … {len(truth)}")
    for column, known, what in ((0, truth[:, 0], "case"), (1, landmarks[:, 0], "landmark")):
        stray = ~np.isin(measured[:, column], known)
        if stray.any():
            row = int(stray.argmax())
            raise RecordingError(f"{path}: variable 'measurement': row {row + 1} is of no {what} that is there")
    measured = measured[np.argsort(measured[:, 0], kind="stable")]
    points, covariances = noise.points(measured[:, 2], measured[:, 3])
    return RelocationCases(
        name=f"mrclam/stationary/{path.stem}",
        source=SOURCE,
        terms=TERMS,
        landmark_ids=landmarks[:, 0].astype(np.int64),
        landmarks=landmarks[:, 1:].copy(),
        starts=starts_of(np.bincount(measured[:, 0].astype(np.int64) - 1, minlength=len(truth))),
        points=points,
        covariances=covariances,
        sources=measured[:, 1].astype(np.int64),
        poses=truth[:, 1:].copy(),
    )


def _checked_table(path: Path, name: str, value: Array) -> Array:
    """A variable as a table of finite numbers with its columns."""
    if np.ndim(value) != 2 or len(value) == 0 or value.shape[1] != _COLUMNS[name]:
        expected = f"expected a table of {_COLUMNS[name]} columns, found {np.shape(value)}"
        raise RecordingError(f"{path}: variable {name!r}: {expected}")
    bad = ~np.isfinite(value).all(axis=1)
    if bad.any():
        raise RecordingError(f"{path}: variable {name!r}: row {int(bad.argmax()) + 1} is not finite")
    return np.asarray(value, np.float64)
