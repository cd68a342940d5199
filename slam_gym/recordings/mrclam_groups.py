"""MR.CLAM's stationary groups as relocation cases; S. Choi extracted them (Triangulation Toolbox, `mrclamN.mat`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from slam_gym.recordings.matlab_file import read_matlab
from slam_gym.recordings.mrclam import SOURCE, TERMS, Noise
from slam_gym.recordings.reading import RecordingError, naming, numbers_of, refuse_rows, starts_of
from slam_gym.recordings.relocation_cases import RelocationCases

GROUPED = Noise(range=0.15, range_per_metre=0.0, bearing=0.02)
"""That of the stationary groups, as their poses show it: σ of ranges 0.14 to 0.16 m, of bearings 0.013 to 0.024 rad."""
_FARTHEST = 1e5  # [m], [rad]; and more groups or landmarks than that are none of this dataset
_COLUMNS = {"landmark": 3, "groundtruth": 4, "measurement": 4}  # of the variables of a file


def stationary(path: str | Path, noise: Noise | None = None) -> RelocationCases:
    """Groups of three or more measurements that a robot made within a second and a centimetre, with its true pose.

    From a file `mrclamN.mat`, N = 1 … 5; landmarks are numbered from 1. Gross errors were removed by those who
    extracted the groups, and barcodes of robots too: nothing is spurious. Most groups repeat the one before, since
    robots stand still for long. `noise` is by default that of the groups themselves. Raises FileNotFoundError, or
    RecordingError that names file, variable and row.
    """
    noise, path = noise or GROUPED, Path(path)
    content = read_matlab(path, list(_COLUMNS), SOURCE)
    tables = {name: numbers_of(path, name, content[name], columns) for name, columns in _COLUMNS.items()}
    landmarks, truth, measured = tables.values()
    for name, table in tables.items():
        refuse_rows(path, name, (np.abs(table[:, 1:]) > _FARTHEST).any(axis=1), f"holds more than {_FARTHEST:g}")
    whole = (landmarks[:, 0] == np.round(landmarks[:, 0])) & (landmarks[:, 0] >= 0) & (landmarks[:, 0] < 1 << 53)
    refuse_rows(path, "landmark", ~whole, "has no whole number")
    if not np.array_equal(truth[:, 0], np.arange(1, len(truth) + 1)):
        raise RecordingError(f"{path}: variable 'groundtruth': the cases are not numbered 1 … {len(truth)}")
    for column, known, what in ((0, truth[:, 0], "case"), (1, landmarks[:, 0], "landmark")):
        refuse_rows(path, "measurement", ~np.isin(measured[:, column], known), f"is of no {what} that is there")
    measured = measured[np.argsort(measured[:, 0], kind="stable")]
    points, covariances = noise.points(measured[:, 2], measured[:, 3])
    with naming(path):
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
