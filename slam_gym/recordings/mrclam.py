"""MR.CLAM: five robots among fifteen barcoded landmarks in a room of 15 m × 8 m, with a Vicon's truth.

Published by K. Leung, Y. Halpern, T. Barfoot and H. Liu, "The UTIAS multi-robot cooperative localization and mapping
dataset", IJRR 30(8), 2011, to be cited; for educational use. A set is a folder with `Barcodes.dat`,
`Landmark_Groundtruth.dat` and `RobotN_{Odometry,Measurement,Groundtruth}.dat`, each of which may be gzipped. The
stationary groups are those that S. Choi extracted (Triangulation Toolbox, `mrclamN.mat`).
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from slam_gym._compile import compiled
from slam_gym.geometry import relative, wrap_angle
from slam_gym.recordings.recording import Recording, RecordingError
from slam_gym.recordings.relocation_cases import RelocationCases
from slam_gym.types import NONE, Array, BoolArray, IntArray

SOURCE = (
    "MR.CLAM, University of Toronto Institute for Aerospace Studies. Cite: Leung, Halpern, Barfoot and Liu, IJRR 30(8) "
    "(2011)."
)
TERMS = "For educational use; cite the paper."
ROBOTS = (1, 2, 3, 4, 5)
_RANGE, _FIELD_OF_VIEW = 12.0, math.radians(65.0)  # [m], [rad] of the camera, with room to spare
_AT_REST = 1e-4  # [m], [rad] σ of a step without motion
_PAUSE = 10.0  # [s] between the log of one robot and that of the next


@dataclass(frozen=True)
class Noise:
    """What the log does not say; chosen on set 6, with all of its robots in view.

    Wheels report what they were told to do: the robots do it a little later, and less of it. Variances of the motion
    add up with time; those of a barcode grow with its range, and are half as much again in σ as the Vicon shows, since
    a barcode that is looked at for long is off by the same all the time.
    """

    delay: float = 0.2  # [s] after which a robot does what its odometry says
    forward_scale: float = 0.93  # of the speed reported, how much is driven
    turn_scale: float = 0.85  # of the turning speed reported, how much is turned
    forward: float = 0.12  # [m/√s] at 1 m/s
    lateral: float = 0.02  # [m/√s] likewise
    turn: float = 0.15  # [rad/√s] at 1 rad/s
    drift: float = 0.004  # [m/√s] in addition
    turn_drift: float = 0.025  # [rad/√s] in addition
    range: float = 0.15  # [m]
    range_per_metre: float = 0.05  # [m/m] of the range, added in quadrature
    bearing: float = 0.03  # [rad]
    misread: float = 1.0  # [m] from where the Vicon has it, a barcode was taken for another
    together: float = 0.05  # [s] measurements that are no farther apart make one scan


GROUPED = Noise(range=0.15, range_per_metre=0.0, bearing=0.02)
"""That of the stationary groups, as their poses show it: σ of ranges 0.14 to 0.16 m, of bearings 0.013 to 0.024 rad."""


def mrclam(folder: str | Path, robot: int, noise: Noise | None = None) -> Recording:
    """The log of one robot of a set: one step for each instant at which its camera saw a barcode.

    Identities are subject numbers, 6 to 20. Barcodes of other robots, those that nobody wears, and those that were
    misread (a handful a set, up to 6 m from where the Vicon has them) are spurious (NONE).
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
    driven = odometry * [1.0, noise.forward_scale, noise.turn_scale] + [noise.delay, 0.0, 0.0]
    growth = (noise.forward, noise.lateral, noise.turn, noise.drift, noise.turn_drift)
    motions, covariances = _integrate(times, driven, growth)
    points, point_covariances = _cartesian(measured[:, 2], measured[:, 3], noise)
    sources = _subjects(measured[:, 1].astype(np.int64), barcodes, landmarks[:, 0].astype(np.int64))
    poses = _interpolated(truth[:, 0], truth[:, 1:], measured[:, 0])
    sources[_misread(points, sources, poses, landmarks, noise.misread)] = NONE
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
        sources=sources,
        reference_times=truth[:, 0] - times[0],
        reference_poses=truth[:, 1:].copy(),
        landmark_ids=landmarks[:, 0].astype(np.int64),
        landmarks=landmarks[:, 1:3].copy(),
        range=_RANGE,
        field_of_view=_FIELD_OF_VIEW,
    )


def mrclam_all(
    folder: str | Path, noise: Noise | None = None, link: tuple[float, float, float] = (0.05, 0.05, math.radians(2.0))
) -> Recording:
    """The logs of all robots of a set, one after the other, for one map of them all.

    It is as if a single robot were picked up at the end of each log and put down at the start of the next: that motion
    is the relative pose that the Vicon gives, with standard deviations `link` [m, m, rad]. Everything within a log is
    as in `mrclam`, but for the clock, which starts again ten seconds after the log before; of the reference, what was
    recorded from the first step of each log to its last stays. Raises as `mrclam`.
    """
    logs = [mrclam(folder, robot, noise) for robot in ROBOTS]
    ends = np.array([log.times[-1] for log in logs])
    begins = np.concatenate([[0.0], np.cumsum(ends + _PAUSE)[:-1]])
    motions = [log.motions.copy() for log in logs]
    covariances = [log.motion_covariances.copy() for log in logs]
    for k in range(1, len(logs)):
        motions[k][0] = relative(_reference_at(logs[k - 1], ends[k - 1]), _reference_at(logs[k], 0.0))
        covariances[k][0] = np.diag(np.square(link))
    references = [_reference_of(log) for log in logs]
    rows = np.concatenate([[0], np.cumsum([len(log.points) for log in logs])])
    together: dict[str, Any] = {name: np.concatenate([getattr(log, name) for log in logs]) for name in _PER_MEASUREMENT}
    return replace(
        logs[0],
        name=f"mrclam/{Path(folder).name}/all",
        times=np.concatenate([log.times + begin for log, begin in zip(logs, begins)]),
        motions=np.concatenate(motions),
        motion_covariances=np.concatenate(covariances),
        starts=np.concatenate([log.starts[:-1] + row for log, row in zip(logs, rows)] + [rows[-1:]]),
        reference_times=np.concatenate([times + begin for (times, _), begin in zip(references, begins)]),
        reference_poses=np.concatenate([poses for _, poses in references]),
        **together,
    )


_PER_MEASUREMENT = ("points", "covariances", "sizes", "size_variances", "sources")


def _reference_of(log: Recording) -> tuple[Array, Array]:
    """Times and poses of the Vicon from the first step of a log to its last, of these two themselves too."""
    end = float(log.times[-1])
    during = (log.reference_times > 0.0) & (log.reference_times < end)
    times = np.concatenate([[0.0], log.reference_times[during], [end]])
    poses = [_reference_at(log, 0.0)[None], log.reference_poses[during], _reference_at(log, end)[None]]
    return times, np.concatenate(poses)


def _reference_at(log: Recording, time: float) -> Array:
    """Pose (3,) of the Vicon at a time of the log, interpolated."""
    pose: Array = _interpolated(log.reference_times, log.reference_poses, np.array([time]))[0]
    pose[2] = wrap_angle(float(pose[2]))
    return pose


def _interpolated(known: Array, poses: Array, times: Array) -> Array:
    """Poses (t, 3) between those (G, 3) at `known` (G,); headings are not wrapped."""
    columns = (poses[:, 0], poses[:, 1], np.unwrap(poses[:, 2]))
    return np.column_stack([np.interp(times, known, column) for column in columns])


def _misread(points: Array, sources: IntArray, poses: Array, landmarks: Array, limit: float) -> BoolArray:
    """(M,) which barcodes are farther than `limit` [m] from where the Vicon has them, seen from poses (M, 3)."""
    place = dict(zip(landmarks[:, 0].astype(int).tolist(), landmarks[:, 1:3].tolist()))
    true = np.array([place.get(source, (math.nan, math.nan)) for source in sources.tolist()]).reshape(-1, 2)
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = poses[:, 0] + c * points[:, 0] - s * points[:, 1], poses[:, 1] + s * points[:, 0] + c * points[:, 1]
    far: BoolArray = np.hypot(x - true[:, 0], y - true[:, 1]) > limit  # never for NaN
    return far


def stationary(path: str | Path, noise: Noise | None = None) -> RelocationCases:
    """Groups of three or more measurements that a robot made within a second and a centimetre, with its true pose.

    From a file `mrclamN.mat`, N = 1 … 5; landmarks are numbered from 1. Gross errors were removed by those who
    extracted the groups, and barcodes of robots too: nothing is spurious. Most groups repeat the one before, since
    robots stand still for long. `noise` is by default that of the groups themselves. Raises FileNotFoundError, or
    RecordingError that names file, variable and row.
    """
    noise, path = noise or GROUPED, Path(path)
    content = _matlab(path, {"landmark": 3, "groundtruth": 4, "measurement": 4})
    landmarks, truth, measured = content["landmark"], content["groundtruth"], content["measurement"]
    if not np.array_equal(truth[:, 0], np.arange(1, len(truth) + 1)):
        raise RecordingError(f"{path}: variable 'groundtruth': the cases are not numbered 1 … {len(truth)}")
    for column, known, what in ((0, truth[:, 0], "case"), (1, landmarks[:, 0], "landmark")):
        stray = ~np.isin(measured[:, column], known)
        if stray.any():
            row = int(stray.argmax())
            raise RecordingError(f"{path}: variable 'measurement': row {row + 1} is of no {what} that is there")
    measured = measured[np.argsort(measured[:, 0], kind="stable")]
    points, covariances = _cartesian(measured[:, 2], measured[:, 3], noise)
    counts = np.bincount(measured[:, 0].astype(np.int64) - 1, minlength=len(truth))
    return RelocationCases(
        name=f"mrclam/stationary/{path.stem}",
        source=SOURCE,
        terms=TERMS,
        landmark_ids=landmarks[:, 0].astype(np.int64),
        landmarks=landmarks[:, 1:].copy(),
        starts=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        points=points,
        covariances=covariances,
        sources=measured[:, 1].astype(np.int64),
        poses=truth[:, 1:].copy(),
    )


def _matlab(path: Path, variables: dict[str, int]) -> dict[str, Array]:
    """Tables of a MATLAB file by name, each with so many columns of finite numbers."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: not there. {SOURCE}")
    try:
        content: dict[str, Any] = loadmat(path)
    except Exception as error:  # scipy raises whatever the damage leads to
        raise RecordingError(f"{path}: no readable MATLAB file: {error}") from error
    for name, columns in variables.items():
        shape = np.shape(content.get(name, ()))
        if len(shape) != 2 or shape[0] == 0 or shape[1] != columns:
            raise RecordingError(f"{path}: variable {name!r}: expected a table of {columns} columns, found {shape}")
        bad = ~np.isfinite(content[name]).all(axis=1)
        if bad.any():
            raise RecordingError(f"{path}: variable {name!r}: row {int(bad.argmax()) + 1} is not finite")
    return {name: np.asarray(content[name], np.float64) for name in variables}


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
def _integrate(times: Array, odometry: Array, growth: tuple[float, float, float, float, float]) -> tuple[Array, Array]:
    """Motion (T, 3) and covariance (T, 3, 3) between `times`, from rows (time, v, ω) that hold until the next one.

    C ← F C Fᵀ + Q with F = ∂(u ⊕ du)/∂u: what a robot turns too far early on, it is aside of its way later.
    """
    forward, lateral, turn, drift, turn_drift = growth
    motions, covariances = np.zeros((len(times), 3)), np.zeros((len(times), 3, 3))
    at = 0
    for k in range(len(times)):
        now, C = times[k - 1] if k > 0 else times[0], _AT_REST**2 * np.eye(3)
        x, y, theta = 0.0, 0.0, 0.0
        while now < times[k]:
            while at + 1 < len(odometry) and odometry[at + 1, 0] <= now:
                at += 1
            end = min(times[k], odometry[at + 1, 0]) if at + 1 < len(odometry) else times[k]
            if now < odometry[at, 0]:  # before the first row
                end = min(end, odometry[at, 0])
            dt = end - now
            v, w = (odometry[at, 1], odometry[at, 2]) if odometry[at, 0] <= now else (0.0, 0.0)
            c, s = math.cos(theta + 0.5 * dt * w), math.sin(theta + 0.5 * dt * w)
            x, y, theta = x + dt * v * c, y + dt * v * s, theta + dt * w
            F = np.eye(3)
            F[0, 2], F[1, 2] = -dt * v * s, dt * v * c
            C = F @ C @ F.T
            along, across = dt * ((forward * v) ** 2 + drift**2), dt * ((lateral * v) ** 2 + drift**2)
            C[0, 0] += c * c * along + s * s * across
            C[0, 1] += c * s * (along - across)
            C[1, 0] += c * s * (along - across)
            C[1, 1] += s * s * along + c * c * across
            C[2, 2] += dt * ((turn * w) ** 2 + turn_drift**2)
            now = end
        motions[k, 0], motions[k, 1], motions[k, 2] = x, y, wrap_angle(theta)
        covariances[k] = 0.5 * (C + C.T)
    return motions, covariances


def _cartesian(ranges: Array, bearings: Array, noise: Noise) -> tuple[Array, Array]:
    """Points (M, 2) and covariances (M, 2, 2) in R."""
    ahead = np.column_stack([np.cos(bearings), np.sin(bearings)])
    aside = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    along = noise.range**2 + (noise.range_per_metre * ranges) ** 2
    covariances = along[:, None, None] * ahead[:, :, None] * ahead[:, None, :]
    covariances += ((noise.bearing * ranges) ** 2)[:, None, None] * aside[:, :, None] * aside[:, None, :]
    return ranges[:, None] * ahead, covariances


def _subjects(codes: IntArray, barcodes: IntArray, landmarks: IntArray) -> IntArray:
    """(M,) subject that wears each barcode, NONE where it is no landmark."""
    worn_by = {code: subject for subject, code in barcodes.tolist() if subject in set(landmarks.tolist())}
    return np.array([worn_by.get(code, NONE) for code in codes.tolist()], dtype=np.int64)
