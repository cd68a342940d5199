"""The Victoria Park log: a vehicle with a laser among some 300 trees, 4 km in 26 minutes.

Published by E. Nebot and J. Guivant, University of Sydney; cite Guivant and Nebot, "Optimization of the simultaneous
localization and map-building algorithm for real-time implementation", IEEE TRA 17(3), 2001. The identities of the
trunks are by S. Huang, Z. Wang and G. Dissanayake (I-SLSJF): they come from the authors' SLAM, not from a survey.

The reader needs in one folder: `aa3_dr.mat` (odometry), `VictoriaParkSinSincronizar.mat` (detections),
`aa3_gpsx.mat` (GPS), and `data_sensor_clean_clean.mat` (identities).
"""

import io
import math
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from slam_gym._files import content_of
from slam_gym.recordings.recording import Recording, RecordingError, Spans, naming, starts_of
from slam_gym.types import SPURIOUS, UNLABELLED, Array, IntArray, Scan

SOURCE = (
    "Victoria Park, E. Nebot and J. Guivant, University of Sydney. Cite: Guivant and Nebot, IEEE TRA 17(3), 2001; for "
    "the identities also Huang, Wang and Dissanayake, 'Iterated SLSJF: a sparse local submap joining algorithm', 2008."
)
TERMS = "No licence is published for the data: ask the authors before you pass it on."
_LENGTH, _HALF_WIDTH = 2.83, 0.76  # [m] wheel base; from the middle of the rear axle to the wheel of the encoder
_AHEAD, _ASIDE = 3.78, 0.5  # [m] position of the laser, from the middle of the rear axle
_RANGE = 80.0  # [m] of the laser
_FASTEST, _SHARPEST = 100.0, 1.2  # [m/s], [rad] limits; at 1.31 rad of steering the middle of the axle would not move
_LONGEST, _FARTHEST = 1e7, 1e5  # [s] greatest duration; [m] greatest distance of a detection
_AT_REST = 1e-4  # [m], [rad] σ of a step without motion

# The log contains no noise model. Variances of the motion add up with time, while the vehicle moves.
_SPEED_SIGMA, _LATERAL_SIGMA = 0.3, 0.1  # [m/√s] along and across the path
_TURN_SIGMA = math.radians(2.0)  # [rad/√s]
_RANGE_SIGMA = 0.3  # [m] includes the difference between views of a trunk from different sides
_BEARING_SIGMA = math.radians(1.0)  # [rad]
_SIZE_SIGMA, _SIZE_SIGMA_PER_METRE = 0.05, 0.005  # [m] of a trunk's diameter; [m/m] of the range, added in quadrature


def victoria_park(folder: str | Path) -> Recording:
    """Read the whole log from the published files in `folder`: one step per laser scan, with trunk diameters as sizes.

    Detections missing from a scan of the label file are SPURIOUS, and detections in scans that it does not contain are
    UNLABELLED. The reference is the position of the GPS antenna, near the laser. Its time stamps are used unchanged:
    the error of a good trajectory is smallest for a shift of only 0.1 s.
    Raises FileNotFoundError, or RecordingError that names file and variable.
    """
    folder = Path(folder)
    with naming(folder):
        wheels = _wheels(folder / "aa3_dr.mat")
        scans, starts, polar = _detections(folder / "VictoriaParkSinSincronizar.mat")
        gps = np.column_stack(_columns(folder / "aa3_gpsx.mat", "timeGps", "Lo_m", "La_m"))
        sources = _identities(folder, scans, starts, polar)
        motions, motion_covariances = _driven(scans, wheels)
        bearings = polar[:, 1] - 0.5 * math.pi  # the laser measures them from its right
        seen = Scan.from_polar(polar[:, 0], bearings, _RANGE_SIGMA, _BEARING_SIGMA)
        return Recording(
            name="victoria_park",
            source=SOURCE,
            terms=TERMS,
            times=scans,
            motions=motions,
            motion_covariances=motion_covariances,
            starts=starts,
            points=seen.points,
            covariances=seen.covariances,
            sizes=polar[:, 2].copy(),
            size_variances=_SIZE_SIGMA**2 + (_SIZE_SIGMA_PER_METRE * polar[:, 0]) ** 2,
            sources=sources,
            reference_times=1e-3 * gps[:, 0],
            reference_poses=np.column_stack([gps[:, 1:], np.full(len(gps), np.nan)]),
            range=_RANGE,
            field_of_view=math.pi,
        )


def _wheels(path: Path) -> tuple[Array, Array, Array]:
    """Times (n,) [ms], speeds (n,) [m/s] and steering (n,) [rad]."""
    times, speed, steering = _columns(path, "time", "speed", "steering")
    _refuse(path, "time", np.diff(times, prepend=times[0]) < 0.0, "comes before the row before it")
    _refuse(path, "speed", np.abs(speed) > _FASTEST, f"is above {_FASTEST:g} m/s")
    _refuse(path, "steering", np.abs(steering) > _SHARPEST, f"is above {_SHARPEST:g} rad")
    return times, speed, steering


def _columns(path: Path, *names: str) -> list[Array]:
    """Variables of a file, which must have one length."""
    columns = [_numbers(path, name, value) for name, value in zip(names, read_matlab(path, *names))]
    if len(set(map(len, columns))) > 1:
        raise RecordingError(f"{path}: variables {', '.join(names)} are not of one length")
    return columns


def _detections(path: Path) -> tuple[Array, IntArray, Array]:
    """Times of scans (T,) [s], first row of each (T + 1,), and rows (M, 3): range [m], bearing [rad], diameter [m]."""
    times, cells = read_matlab(path, "TLsr", "zt")
    scans = _numbers(path, "TLsr", times)
    far = (np.diff(scans, prepend=scans[0]) < 0.0) | (np.abs(scans) > _LONGEST)
    _refuse(path, "TLsr", far, f"comes before the row before it, or after {_LONGEST:g} s")
    if cells.dtype != object or cells.size != len(scans):
        raise RecordingError(f"{path}: variable 'zt': expected {len(scans)} cells, found {cells.dtype} {cells.shape}")
    tables = []
    for k, entry in enumerate(cells.ravel(), 1):
        cell = np.asarray(entry)
        if cell.dtype.kind not in "fiu" or cell.size % 3 or not (np.abs(cell) <= _FARTHEST).all():
            raise RecordingError(f"{path}: variable 'zt': cell {k} is no table of 3 rows of finite numbers")
        tables.append(cell.astype(np.float64).reshape(3, -1).T)
    return scans, starts_of([len(table) for table in tables]), np.concatenate(tables)


def _driven(scans: Array, wheels: tuple[Array, Array, Array]) -> tuple[Array, Array]:
    """Motion (T, 3) of the laser from scan to scan, and its covariance (T, 3, 3), by the vehicle's kinematics.

    With the speed v_c = v / (1 − tan α · H / L) of the middle of the rear axle and the curvature κ = tan α / L,
    ẋ = v_c (cos θ − κ (a sin θ + b cos θ)), ẏ = v_c (sin θ + κ (a cos θ − b sin θ)), θ̇ = v_c κ
    (Guivant and Nebot 2001). A command holds until the next one.
    """
    time, speed, steering = wheels
    spans = Spans.between(scans, 1e-3 * time)
    dt = np.where(spans.command >= 0, spans.seconds, 0.0)
    tangent = np.tan(steering[spans.command])
    v, curvature = speed[spans.command] / (1.0 - tangent * _HALF_WIDTH / _LENGTH), tangent / _LENGTH
    theta = spans.headings(dt * v * curvature)
    c, s = np.cos(theta), np.sin(theta)
    moved = (
        dt * v * (c - curvature * (_AHEAD * s + _ASIDE * c)),
        dt * v * (s + curvature * (_AHEAD * c - _ASIDE * s)),
        dt * v * curvature,
    )
    motions = np.column_stack([spans.sums(part, len(scans)) for part in moved])
    moving = spans.sums(np.where(v != 0.0, dt, 0.0), len(scans))  # [s]
    variances = np.square([_SPEED_SIGMA, _LATERAL_SIGMA, _TURN_SIGMA]) * moving[:, None] + _AT_REST**2  # (T, 3)
    return motions, np.eye(3) * variances[:, :, None]


def _identities(folder: Path, scans: Array, starts: IntArray, polar: Array) -> IntArray:
    """(M,) identity of each detection, joined with the labels by time, bearing and range."""
    path, name = folder / "data_sensor_clean_clean.mat", "data_sensor_clean_clean"
    (table,) = read_matlab(path, name)
    labels = _numbers(path, name, table, 6)
    beyond = ~((labels[:, 5] >= 0.0) & (labels[:, 5] < 1 << 31) & (np.abs(labels[:, 0]) < 1 << 53))
    _refuse(path, name, beyond, "has no identity, or no time")
    keys = {(round(t), round(b, 6), round(r, 6)): int(source) for t, r, b, _, _, source in labels.tolist()}
    stamps = np.repeat(np.round(1000.0 * scans).astype(np.int64), np.diff(starts))
    rows = zip(stamps.tolist(), polar.tolist(), strict=True)
    identities = [keys.pop((t, round(b, 6), round(r, 6)), SPURIOUS) for t, (r, b, _) in rows]
    if keys:
        time = next(iter(keys))[0]
        raise RecordingError(f"{folder}: {len(keys)} labels fit no detection, the first at {time} ms")
    return np.where(np.isin(stamps, np.round(labels[:, 0]).astype(np.int64)), identities, UNLABELLED)


def read_matlab(path: Path, *names: str) -> list[Any]:
    """Variables of a MATLAB file.

    Raises FileNotFoundError, or RecordingError for a file that is too large, unreadable or lacks a variable.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: not there. {SOURCE}")
    try:
        read = loadmat(io.BytesIO(content_of(path)), variable_names=names)
    except Exception as error:  # scipy raises whatever the damage leads to
        raise RecordingError(f"{path}: no readable MATLAB file: {error}") from error
    for name in names:
        if name not in read:
            raise RecordingError(f"{path}: variable {name!r} is missing")
    return [read[name] for name in names]


def _numbers(path: Path, name: str, value: Any, columns: int | None = None) -> Array:
    """A variable of a MATLAB file as finite float64: a table of `columns` columns, or a flat array if that is None."""
    array = np.asarray(value)
    if array.dtype.kind not in "fiu" or array.size == 0:
        raise RecordingError(f"{path}: variable {name!r}: expected numbers, found {array.dtype} {array.shape}")
    if columns is None:
        array = array.ravel()
    elif array.ndim != 2 or array.shape[1] != columns:
        raise RecordingError(f"{path}: variable {name!r}: expected a table of {columns} columns, found {array.shape}")
    table = np.ascontiguousarray(array, np.float64)
    _refuse(path, name, ~np.isfinite(table.reshape(len(table), -1)).all(axis=1), "is not finite")
    return table


def _refuse(path: Path, name: str, bad: Any, what: str) -> None:
    """Raise RecordingError, naming file, variable and row, at the first row where `bad` (n,) is True."""
    if bad.any():
        raise RecordingError(f"{path}: variable {name!r}: row {int(bad.argmax()) + 1} {what}")
