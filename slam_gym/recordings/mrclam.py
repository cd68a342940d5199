"""MR.CLAM: five robots among fifteen barcoded landmarks in a room of 15 m × 8 m, with a Vicon's truth.

Published by K. Leung, Y. Halpern, T. Barfoot and H. Liu, "The UTIAS multi-robot cooperative localization and mapping
dataset", IJRR 30(8), 2011, to be cited; for educational use. A set is a folder with `Barcodes.dat`,
`Landmark_Groundtruth.dat` and `RobotN_{Odometry,Measurement,Groundtruth}.dat`, each of which may be gzipped.
Its stationary groups are relocation cases; S. Choi extracted them (Triangulation Toolbox, `mrclamN.mat`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slam_gym._files import content_of, gunzipped, lines_of
from slam_gym._jit import compiled
from slam_gym.geometry import wrap_angle
from slam_gym.recordings.reading import (
    Points,
    RecordingError,
    check_finite,
    check_shapes,
    check_starts,
    from_polar,
    naming,
    numbers_of,
    read_matlab,
    refuse_rows,
    starts_of,
)
from slam_gym.recordings.recording import Recording, interpolate
from slam_gym.types import SPURIOUS, UNLABELLED, UNPAIRED, Array, IntArray, Landmarks, Scan

SOURCE = (
    "MR.CLAM, University of Toronto Institute for Aerospace Studies. Cite: Leung, Halpern, Barfoot and Liu, IJRR 30(8) "
    "(2011)."
)
TERMS = "For educational use; cite the paper."
ROBOTS = (1, 2, 3, 4, 5)
_RANGE, _FIELD_OF_VIEW = 12.0, math.radians(65.0)  # [m], [rad] of the camera, with room to spare
_LARGEST = 1e10  # of any number: seconds since 1970, metres, radians, barcodes
_MISREAD = 1.0  # [m] from where the Vicon has it, a barcode was taken for another
_TOGETHER = 0.05  # [s] measurements that are no farther apart make one scan
_AT_REST = 1e-4  # [m], [rad] σ of a step without motion


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

    def points(self, ranges: Array, bearings: Array) -> Points:
        """Barcodes at ranges (M,) [m] and bearings (M,) [rad]."""
        return from_polar(ranges, bearings, self.range**2 + (self.range_per_metre * ranges) ** 2, self.bearing)


def mrclam(folder: str | Path, robot: int, noise: Noise | None = None) -> Recording:
    """The log of one robot of a set: one step for each instant at which its camera saw a barcode.

    Identities are subject numbers, 6 to 20. Barcodes of other robots, those that nobody wears, and those that were
    misread (a handful a set, up to 6 m from where the Vicon has them) are spurious.
    The poses of the reference are the Vicon's. Raises FileNotFoundError, or RecordingError that names file and line.
    """
    if robot not in ROBOTS:
        raise ValueError(f"robot: {robot} is none of 1 … 5")
    folder = Path(folder)
    with naming(folder):
        return _recording(_read(folder, robot), noise or Noise(), f"mrclam/{folder.name}/robot{robot}")


def _recording(tables: _Tables, noise: Noise, name: str) -> Recording:
    times, start = tables.measured[:, 0], tables.truth[0, 0]
    measured = tables.measured[(times >= start) & (times <= tables.truth[-1, 0])]
    if len(measured) == 0:
        raise RecordingError("nothing was measured while the Vicon saw the robot")
    first = np.flatnonzero(np.diff(measured[:, 0], prepend=-math.inf) > _TOGETHER)
    times = measured[first, 0]
    driven = tables.odometry * [1.0, noise.forward_scale, noise.turn_scale] + [noise.delay, 0.0, 0.0]
    growth = (noise.forward, noise.lateral, noise.turn, noise.drift, noise.turn_drift)
    motions, covariances = _integrate(times, driven, growth)
    seen = noise.points(measured[:, 2], measured[:, 3])
    return Recording(
        name=name,
        source=SOURCE,
        terms=TERMS,
        times=times - times[0],
        motions=motions,
        motion_covariances=covariances,
        starts=np.append(first, len(measured)).astype(np.int64),
        points=seen.points,
        covariances=seen.covariances,
        sources=_sources(tables, measured, seen.points, _MISREAD),
        reference_times=tables.truth[:, 0] - times[0],
        reference_poses=tables.truth[:, 1:].copy(),
        landmark_ids=tables.landmarks[:, 0].astype(np.int64),
        landmarks=tables.landmarks[:, 1:3].copy(),
        range=_RANGE,
        field_of_view=_FIELD_OF_VIEW,
    )


class _Tables(NamedTuple):
    """The files of one robot of a set."""

    odometry: Array  # time [s], forward speed [m/s], turning speed [rad/s]
    measured: Array  # time, barcode, range [m], bearing [rad]
    truth: Array  # time, x, y, heading of the robot
    barcodes: Array  # subject, barcode
    landmarks: Array  # subject, x, y, and their standard deviations


def _read(folder: Path, robot: int) -> _Tables:
    tables = _Tables(
        _table(folder, f"Robot{robot}_Odometry.dat", 3, ascending=True),
        _table(folder, f"Robot{robot}_Measurement.dat", 4, ascending=True),
        _table(folder, f"Robot{robot}_Groundtruth.dat", 4, ascending=True),
        _table(folder, "Barcodes.dat", 2),
        _table(folder, "Landmark_Groundtruth.dat", 5),
    )
    for name, numbers in (("Barcodes.dat", tables.barcodes), ("Landmark_Groundtruth.dat", tables.landmarks[:, :1])):
        if (numbers != np.round(numbers)).any() or (numbers < 0.0).any():
            raise RecordingError(f"{folder / name}: a subject or barcode is no whole number")
    if len(np.unique(tables.landmarks[:, 0])) < len(tables.landmarks):
        raise RecordingError(f"{folder / 'Landmark_Groundtruth.dat'}: a subject is there twice")
    return tables


def _sources(tables: _Tables, measured: Array, points: Array, limit: float) -> IntArray:
    """(M,) landmark behind each barcode; SPURIOUS where it is none, or farther than `limit` [m] from where it stands.

    `points` (M, 2) in R are the measurements, looked at from the Vicon's poses.
    """
    place = {int(row[0]): row[1:3] for row in tables.landmarks}
    worn_by = {int(code): int(subject) for subject, code in tables.barcodes if int(subject) in place}
    sources = np.array([worn_by.get(int(code), SPURIOUS) for code in measured[:, 1]], dtype=np.int64)
    true = np.array([place.get(source, (math.nan, math.nan)) for source in sources.tolist()]).reshape(-1, 2)
    poses = interpolate(tables.truth[:, 0], tables.truth[:, 1:], measured[:, 0])
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = poses[:, 0] + c * points[:, 0] - s * points[:, 1], poses[:, 1] + s * points[:, 0] + c * points[:, 1]
    sources[np.hypot(x - true[:, 0], y - true[:, 1]) > limit] = SPURIOUS  # never for NaN
    return sources


def _table(folder: Path, name: str, columns: int, *, ascending: bool = False) -> Array:
    """The numbers (rows, columns) of a text file, or of its gzipped form. Lines that begin with # are comments."""
    path = next((p for p in (folder / name, folder / f"{name}.gz") if p.is_file()), None)
    if path is None:
        raise FileNotFoundError(f"{folder / name}: not there, gzipped or not. {SOURCE}")
    with naming(path):
        content = content_of(path)
        lines = list(lines_of(gunzipped(content) if path.suffix == ".gz" else content))
        rows = [(number, text) for number, line in lines if (text := line.split("#", 1)[0].strip())]
        table = np.array([_row(number, text, columns) for number, text in rows]).reshape(-1, columns)
        if len(table) == 0:
            raise RecordingError(f"no table of {columns} columns")
        bad = ~(np.abs(table) <= _LARGEST).all(axis=1)
        if ascending:
            bad |= np.diff(table[:, 0], prepend=-math.inf) < 0.0
        if bad.any():
            number = rows[int(bad.argmax())][0]
            raise RecordingError(f"line {number} is not finite, above {_LARGEST:.0e}, or goes back in time")
    return table


def _row(number: int, text: str, columns: int) -> list[float]:
    words = text.split()
    if len(words) != columns:
        raise RecordingError(f"line {number}: {len(words)} columns, expected {columns} columns")
    try:
        return [float(word) for word in words]
    except ValueError as error:
        raise RecordingError(f"line {number}: {error}") from None


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


@dataclass(frozen=True)
class RelocationCases:
    """Scans in a surveyed map, the identity behind each measurement, and the pose that each scan was taken from.

    Raises RecordingError, naming the field, where arrays do not fit together or hold what they may not.
    """

    name: str
    source: str  # where it is published and what to cite
    terms: str  # under which it may be used
    landmark_ids: IntArray  # (L,) identities, none twice
    landmarks: Array  # (L, 2) [m] in W
    starts: IntArray  # (C + 1,) the measurements of case k are rows starts[k]:starts[k + 1] of the arrays (M, …)
    points: Array  # (M, 2) [m] in R
    covariances: Array  # (M, 2, 2) [m²] in R
    sources: IntArray  # (M,) identity behind each measurement, −1 spurious, −2 unknown
    poses: Array  # (C, 3) [m, m, rad] true poses in W

    def __post_init__(self) -> None:
        L, C, M = len(self.landmark_ids), len(self.poses), len(self.points)
        shapes = {"landmarks": (L, 2), "starts": (C + 1,), "points": (M, 2), "covariances": (M, 2, 2)}
        check_shapes(self, {**shapes, "sources": (M,), "poses": (C, 3)})
        check_finite(self, ("landmarks", "points", "covariances", "poses"))
        check_starts(self.starts, M)
        if len(np.unique(self.landmark_ids)) != L:
            raise RecordingError("field 'landmark_ids' names a landmark twice")
        if not np.isin(self.sources, [SPURIOUS, UNLABELLED, *self.landmark_ids]).all():
            raise RecordingError("field 'sources' names a landmark that is not there")

    def __len__(self) -> int:
        return len(self.poses)

    def scan(self, case: int) -> Scan:
        """What was measured. Sizes are unknown."""
        rows = slice(self.starts[case], self.starts[case + 1])
        return Scan.from_points(self.points[rows], self.covariances[rows])

    def features_of(self, case: int) -> IntArray:
        """(m,) row of `landmarks` behind each measurement, UNPAIRED where there is none: the true hypothesis."""
        rows = {identity: row for row, identity in enumerate(self.landmark_ids.tolist())}
        sources = self.sources[self.starts[case] : self.starts[case + 1]]
        return np.array([rows.get(source, UNPAIRED) for source in sources.tolist()], dtype=np.int64)

    def map(self, sigma: float = 0.01) -> Landmarks:
        """The surveyed landmarks, each off by `sigma` [m] per axis, independently of the others."""
        return Landmarks.from_points(self.landmarks, sigma=sigma)


GROUPED = Noise(range=0.15, range_per_metre=0.0, bearing=0.02)
"""That of the stationary groups, as their poses show it: σ of ranges 0.14 to 0.16 m, of bearings 0.013 to 0.024 rad."""
_FARTHEST_GROUP = 1e5  # [m], [rad]; and more groups or landmarks than that are none of this dataset
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
        refuse_rows(
            path, name, (np.abs(table[:, 1:]) > _FARTHEST_GROUP).any(axis=1), f"holds more than {_FARTHEST_GROUP:g}"
        )
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
