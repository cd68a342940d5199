"""MR.CLAM: five robots among fifteen barcoded landmarks in a room of 15 m × 8 m, with a Vicon's truth.

Published by K. Leung, Y. Halpern, T. Barfoot and H. Liu, "The UTIAS multi-robot cooperative localization and mapping
dataset", IJRR 30(8), 2011, to be cited; for educational use. A set is a folder with `Barcodes.dat`,
`Landmark_Groundtruth.dat` and `RobotN_{Odometry,Measurement,Groundtruth}.dat`, each of which may be gzipped.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slam_gym._compile import compiled
from slam_gym.geometry import wrap_angle
from slam_gym.recordings.recording import Recording, RecordingError
from slam_gym.types import NONE, Array, IntArray

SOURCE = (
    "MR.CLAM, University of Toronto Institute for Aerospace Studies. Cite: Leung, Halpern, Barfoot and Liu, IJRR 30(8) "
    "(2011)."
)
TERMS = "For educational use; cite the paper."
ROBOTS = (1, 2, 3, 4, 5)
_RANGE, _FIELD_OF_VIEW = 12.0, math.radians(65.0)  # [m], [rad] of the camera, with room to spare


@dataclass(frozen=True)
class Noise:
    """What the log does not say. Variances of the motion add up with time, in proportion to the speeds."""

    forward: float = 0.05  # [m/√s] at 1 m/s
    lateral: float = 0.02  # [m/√s] likewise
    turn: float = 0.15  # [rad/√s] at 1 rad/s
    drift: float = 0.025  # [m/√s] and [rad/√s] in addition, since robots also move when their wheels report nothing
    range: float = 0.15  # [m]
    bearing: float = 0.02  # [rad]
    together: float = 0.05  # [s] measurements that are no farther apart make one scan


def mrclam(folder: str | Path, robot: int, noise: Noise | None = None) -> Recording:
    """The log of one robot of a set: one step for each instant at which its camera saw a barcode.

    Identities are subject numbers, 6 to 20. Barcodes of other robots, and those that nobody wears, are spurious (NONE).
    The poses of the reference are the Vicon's. Raises FileNotFoundError, or RecordingError that names file and line.
    """
    if robot not in ROBOTS:
        raise ValueError(f"robot: {robot} is none of 1 … 5")
    noise, folder = noise or Noise(), Path(folder)
    odometry = _table(folder, f"Robot{robot}_Odometry.dat", 3, ascending=True)
    measured = _table(folder, f"Robot{robot}_Measurement.dat", 4, ascending=True)
    truth = _table(folder, f"Robot{robot}_Groundtruth.dat", 4, ascending=True)
    barcodes = _table(folder, "Barcodes.dat", 2).astype(np.int64)
    landmarks = _table(folder, "Landmark_Groundtruth.dat", 5)
    measured = measured[(measured[:, 0] >= truth[0, 0]) & (measured[:, 0] <= truth[-1, 0])]
    new = np.diff(measured[:, 0], prepend=-math.inf) > noise.together
    first = np.flatnonzero(new)
    times = measured[first, 0]
    motions, covariances = _integrate(times, odometry, noise.forward, noise.lateral, noise.turn, noise.drift)
    points, point_covariances = _cartesian(measured[:, 2], measured[:, 3], noise)
    unknown = np.full(len(points), math.nan)
    return Recording(
        name=f"mrclam/{folder.name}/robot{robot}",
        source=SOURCE,
        terms=TERMS,
        times=times - times[0],
        motions=motions,
        motion_covariances=covariances,
        starts=np.append(first, len(measured)).astype(np.int64),
        points=points,
        covariances=point_covariances,
        sizes=unknown,
        size_variances=unknown.copy(),
        sources=_subjects(measured[:, 1].astype(np.int64), barcodes, landmarks[:, 0].astype(np.int64)),
        reference_times=truth[:, 0] - times[0],
        reference_poses=truth[:, 1:].copy(),
        landmark_ids=landmarks[:, 0].astype(np.int64),
        landmarks=landmarks[:, 1:3].copy(),
        range=_RANGE,
        field_of_view=_FIELD_OF_VIEW,
    )


def _table(folder: Path, name: str, columns: int, *, ascending: bool = False) -> Array:
    """The numbers (rows, columns) of a text file, or of its gzipped form. Lines that begin with # are comments."""
    path = next((p for p in (folder / name, folder / f"{name}.gz") if p.is_file()), None)
    if path is None:
        raise FileNotFoundError(f"{folder / name}: not there, gzipped or not. {SOURCE}")
    try:
        table = np.loadtxt(path, comments="#", ndmin=2)
    except (ValueError, OSError, EOFError, zlib.error) as error:
        raise RecordingError(f"{path}: {error}") from error
    if table.shape[1:] != (columns,) or len(table) == 0:
        raise RecordingError(f"{path}: table of shape {table.shape}, expected {columns} columns")
    bad = ~np.isfinite(table).all(axis=1)
    if ascending:
        bad |= np.diff(table[:, 0], prepend=-math.inf) < 0.0
    if bad.any():
        raise RecordingError(f"{path}: row {int(np.flatnonzero(bad)[0]) + 1} is not finite or goes back in time")
    return table


@compiled
def _integrate(
    times: Array, odometry: Array, forward: float, lateral: float, turn: float, drift: float
) -> tuple[Array, Array]:
    """Motion (T, 3) and covariance (T, 3, 3) between `times`, from rows (time, v, ω) that hold until the next one."""
    motions, covariances = np.zeros((len(times), 3)), np.zeros((len(times), 3, 3))
    at = 0
    for k in range(len(times)):
        now = times[k - 1] if k > 0 else times[0]
        x, y, theta, along, across, around = 0.0, 0.0, 0.0, 1e-8, 1e-8, 1e-8
        while now < times[k]:
            while at + 1 < len(odometry) and odometry[at + 1, 0] <= now:
                at += 1
            end = min(times[k], odometry[at + 1, 0]) if at + 1 < len(odometry) else times[k]
            dt = end - now if odometry[at, 0] <= now else 0.0
            v, w = odometry[at, 1], odometry[at, 2]
            x += dt * v * math.cos(theta + 0.5 * dt * w)
            y += dt * v * math.sin(theta + 0.5 * dt * w)
            theta += dt * w
            along += dt * ((forward * v) ** 2 + drift**2)
            across += dt * ((lateral * v) ** 2 + drift**2)
            around += dt * ((turn * w) ** 2 + drift**2)
            now = end
        motions[k, 0], motions[k, 1], motions[k, 2] = x, y, wrap_angle(theta)
        covariances[k, 0, 0], covariances[k, 1, 1], covariances[k, 2, 2] = along, across, around
    return motions, covariances


def _cartesian(ranges: Array, bearings: Array, noise: Noise) -> tuple[Array, Array]:
    """Points (M, 2) and covariances (M, 2, 2) in R."""
    ahead = np.column_stack([np.cos(bearings), np.sin(bearings)])
    aside = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    covariances = noise.range**2 * ahead[:, :, None] * ahead[:, None, :]
    covariances += ((noise.bearing * ranges) ** 2)[:, None, None] * aside[:, :, None] * aside[:, None, :]
    return ranges[:, None] * ahead, covariances


def _subjects(codes: IntArray, barcodes: IntArray, landmarks: IntArray) -> IntArray:
    """(M,) subject that wears each barcode, NONE where it is no landmark."""
    worn_by = {code: subject for subject, code in barcodes.tolist() if subject in set(landmarks.tolist())}
    return np.array([worn_by.get(code, NONE) for code in codes.tolist()], dtype=np.int64)
