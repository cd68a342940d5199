"""What a run over a log leaves on disk: trajectories that `evo` and others read, the map, the errors over time.

LOG.reference.tum           poses of the reference, where it has headings
LOG.ASSOCIATOR.tum          poses of the run, in the frame of its map
LOG.ASSOCIATOR.map.csv      features of the map, in the same frame
LOG.ASSOCIATOR.errors.csv   the run, aligned, against the reference
"""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np

from agents.evaluation.recording_measures import compare
from agents.evaluation.recording_run import Run
from slam_gym.geometry import transform
from slam_gym.recordings.recording import Recording
from slam_gym.recordings.trajectory_file import write_tum
from slam_gym.types import Array

MAP_FIELDS = (
    "id", "identity", "confirmed", "seen", "x", "y", "variance_x", "covariance_xy", "variance_y", "size",
)  # fmt: skip
ERROR_FIELDS = ("time", "x", "y", "reference_x", "reference_y", "error")


def stem(*names: str) -> str:
    """A file's name for a log, and an associator that may itself be a path or `module:function`."""
    return ".".join(re.sub(r"[^\w\-]+", "-", name).strip("-") for name in names)


def write_run(folder: Path, log: Recording, name: str, run: Run, align: Array) -> None:
    """All files of a run; `align` (3,) is the pose that moves its map onto the reference."""
    folder.mkdir(parents=True, exist_ok=True)
    known = np.isfinite(log.reference_poses[:, 2])
    if known.any():
        write_tum(folder / f"{stem(log.name)}.reference.tum", log.reference_times[known], log.reference_poses[known])
    base = stem(log.name, name)
    write_tum(folder / f"{base}.tum", log.times, run.poses)
    covariances = run.covariances.reshape(-1, 4)[:, [0, 1, 3]]
    columns = (run.features, run.identities, run.confirmed.astype(int), run.seen)
    features = zip(*(column.tolist() for column in columns), *run.positions.T, *covariances.T, run.sizes)
    _write_csv(folder / f"{base}.map.csv", MAP_FIELDS, features)
    times, estimated, reference = compare(log, run)
    aligned = transform(align, np.ascontiguousarray(estimated[:, :2]))
    errors = np.hypot(*(aligned - reference[:, :2]).T)
    _write_csv(folder / f"{base}.errors.csv", ERROR_FIELDS, zip(times, *aligned.T, *reference[:, :2].T, errors))


def read_columns(path: Path) -> dict[str, Array]:
    """Columns of a CSV file written by `write_run`, by name."""
    with path.open(encoding="utf-8", newline="") as file:
        names = next(csv.reader(file))
    table = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2).reshape(-1, len(names))
    return dict(zip(names, table.T))


def _write_csv(path: Path, names: tuple[str, ...], rows: object) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        for row in rows:  # type: ignore[attr-defined]
            writer.writerow([f"{value:.9g}" if isinstance(value, float) else value for value in row])
