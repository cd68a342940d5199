"""What a mapped log leaves on disk: trajectories that `evo` and others read, the map, the errors over time.

LOG.reference.tum           poses of the reference, where it has headings
LOG.ASSOCIATOR.tum          poses of the robot, in the frame of its map
LOG.ASSOCIATOR.map.csv      features of the map, in the same frame
LOG.ASSOCIATOR.errors.csv   the positions, aligned, against the reference
"""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from agents.evaluation.log_measures import compare
from agents.evaluation.mapped_log import MappedLog
from agents.evaluation.records import stem
from slam_gym.recordings.recording import Recording, write_tum
from slam_gym.types import Array

MAP_FIELDS = (
    "id", "identity", "confirmed", "seen", "x", "y", "variance_x", "covariance_xy", "variance_y", "size",
)  # fmt: skip
ERROR_FIELDS = ("time", "x", "y", "reference_x", "reference_y", "error")


def write_mapped_log(folder: Path, log: Recording, associator: str, mapped: MappedLog) -> None:
    """All files of a log mapped with an associator."""
    folder.mkdir(parents=True, exist_ok=True)
    known = np.isfinite(log.reference_poses[:, 2])
    if known.any():
        write_tum(folder / f"{stem(log.name)}.reference.tum", log.reference_times[known], log.reference_poses[known])
    base = stem(log.name, associator)
    write_tum(folder / f"{base}.tum", log.times, mapped.poses)
    m = mapped.map
    integers = (m.ids, mapped.sources, mapped.confirmed.astype(int), m.seen)
    floats = (*m.positions.T, *m.covariances.reshape(-1, 4)[:, [0, 1, 3]].T, m.sizes)
    _write_columns(folder / f"{base}.map.csv", MAP_FIELDS, (*integers, *floats))
    compared = compare(log, mapped)
    errors = (compared.times, *compared.aligned.T, *compared.reference[:, :2].T, compared.errors)
    _write_columns(folder / f"{base}.errors.csv", ERROR_FIELDS, errors)


def read_columns(path: Path) -> dict[str, Array]:
    """Columns of a CSV file written by `write_mapped_log`, by name."""
    with path.open(encoding="utf-8", newline="") as file:
        names, *rows = csv.reader(file)
    return dict(zip(names, np.array(rows, np.float64).reshape(-1, len(names)).T))


def _write_columns(path: Path, names: Iterable[str], columns: Iterable[Array]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        for row in zip(*(column.tolist() for column in columns)):
            writer.writerow([f"{value:.9g}" if isinstance(value, float) else value for value in row])
