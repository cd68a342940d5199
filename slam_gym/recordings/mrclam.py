"""MR.CLAM: five robots among fifteen barcoded landmarks in a room of 15 m × 8 m, with ground truth by Vicon.

Published by K. Leung, Y. Halpern, T. Barfoot and H. Liu, "The UTIAS multi-robot cooperative localization and mapping
dataset", IJRR 30(8), 2011, to be cited; for educational use. A set is a folder with `Barcodes.dat`,
`Landmark_Groundtruth.dat` and `RobotN_{Odometry,Measurement,Groundtruth}.dat`, each of which may be gzipped.
"""

import io
import math
from pathlib import Path

import numpy as np

from slam_gym._files import content_of
from slam_gym.geometry import wrap_angles
from slam_gym.recordings.recording import Recording, RecordingError, Spans, interpolate, naming, published_file
from slam_gym.types import SPURIOUS, Array, IntArray, Scan

SOURCE = (
    "MR.CLAM, University of Toronto Institute for Aerospace Studies. Cite: Leung, Halpern, Barfoot and Liu, IJRR 30(8) "
    "(2011)."
)
TERMS = "For educational use; cite the paper."
ROBOTS = (1, 2, 3, 4, 5)
_RANGE, _FIELD_OF_VIEW = 12.0, math.radians(65.0)  # [m], [rad] of the camera, with a margin
_LARGEST = 1e10  # greatest number: seconds since 1970, metres, radians, barcodes
_MISREAD = 1.0  # [m] from the position by Vicon, above which a barcode was misread
_TOGETHER = 0.05  # [s] greatest time between consecutive measurements of one scan
_AT_REST = 1e-4  # [m], [rad] σ of a step without motion

# The log contains no noise model; this one was chosen on all robots of set 6. The odometry is the commanded motion,
# which the robots carry out with a delay, and not fully. Variances of the motion add up with time. The σ of a barcode
# grows with its range, and is 1.5 times that of the errors by Vicon, because a barcode seen for a long time has the
# same error all the time.
_DELAY = 0.2  # [s] from a command in the odometry to its execution
_FORWARD_SCALE, _TURN_SCALE = 0.93, 0.85  # fractions of the commanded speed and turning speed that are carried out
_FORWARD_SIGMA, _LATERAL_SIGMA = 0.12, 0.02  # [m/√s] at 1 m/s
_TURN_SIGMA = 0.15  # [rad/√s] at 1 rad/s
_DRIFT, _TURN_DRIFT = 0.004, 0.025  # [m/√s], [rad/√s] in addition, at any speed
_RANGE_SIGMA, _RANGE_SIGMA_PER_METRE = 0.15, 0.05  # [m], and [m/m] of the range, added in quadrature
_BEARING_SIGMA = 0.03  # [rad]


def mrclam(folder: str | Path, robot: int) -> Recording:
    """Read the log of one robot of a set: one step for each instant at which its camera saw a barcode.

    Identities are subject numbers, 6 to 20. Barcodes of other robots, barcodes of no subject, and misread barcodes (a
    few in each set, up to 6 m from their position by Vicon) are spurious. The reference poses are those by Vicon.
    Raises FileNotFoundError, or RecordingError that names file and row, without counting comments.
    """
    if robot not in ROBOTS:
        raise ValueError(f"robot: {robot} is none of 1 … 5")
    folder = Path(folder)
    with naming(folder):
        odometry = _table(folder, f"Robot{robot}_Odometry.dat", 3, ascending=True)  # [s], speed [m/s], turn [rad/s]
        measured = _table(folder, f"Robot{robot}_Measurement.dat", 4, ascending=True)  # [s], barcode, range, bearing
        truth = _table(folder, f"Robot{robot}_Groundtruth.dat", 4, ascending=True)  # [s], x, y [m], heading [rad]
        barcodes = _table(folder, "Barcodes.dat", 2, counts=2)  # subject, barcode
        landmarks = _table(folder, "Landmark_Groundtruth.dat", 5, counts=1)  # subject, x, y [m], and their σ
        measured = measured[(measured[:, 0] >= truth[0, 0]) & (measured[:, 0] <= truth[-1, 0])]
        if len(measured) == 0:
            raise RecordingError("there is no measurement within the times of the ground truth")
        first = np.flatnonzero(np.diff(measured[:, 0], prepend=-math.inf) > _TOGETHER)
        times = measured[first, 0]
        motions, motion_covariances = _driven(times, odometry)
        range_sigmas = np.hypot(_RANGE_SIGMA, _RANGE_SIGMA_PER_METRE * measured[:, 2])
        seen = Scan.from_polar(measured[:, 2], measured[:, 3], range_sigmas, _BEARING_SIGMA)
        poses = interpolate(truth[:, 0], truth[:, 1:], measured[:, 0])
        return Recording(
            name=f"mrclam/{folder.name}/robot{robot}",
            source=SOURCE,
            terms=TERMS,
            times=times - times[0],
            motions=motions,
            motion_covariances=motion_covariances,
            starts=np.append(first, len(measured)).astype(np.int64),
            points=seen.points,
            covariances=seen.covariances,
            sources=_sources(landmarks, barcodes, measured[:, 1], poses, seen.points),
            reference_times=truth[:, 0] - times[0],
            reference_poses=truth[:, 1:].copy(),
            landmark_ids=landmarks[:, 0].astype(np.int64),
            landmarks=landmarks[:, 1:3].copy(),
            range=_RANGE,
            field_of_view=_FIELD_OF_VIEW,
        )


def _sources(landmarks: Array, barcodes: Array, codes: Array, poses: Array, points: Array) -> IntArray:
    """(M,) landmark behind each of the measured `codes` (M,); SPURIOUS where there is none, or the code was misread.

    The measurements `points` (M, 2) in R were made from `poses` (M, 3).
    """
    place = {int(row[0]): row[1:3] for row in landmarks}
    worn_by = {int(code): int(subject) for subject, code in barcodes if int(subject) in place}
    sources = np.array([worn_by.get(int(code), SPURIOUS) for code in codes], dtype=np.int64)
    true = np.array([place.get(source, (math.nan, math.nan)) for source in sources.tolist()]).reshape(-1, 2)
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = poses[:, 0] + c * points[:, 0] - s * points[:, 1], poses[:, 1] + s * points[:, 0] + c * points[:, 1]
    sources[np.hypot(x - true[:, 0], y - true[:, 1]) > _MISREAD] = SPURIOUS  # never for NaN
    return sources


def _table(folder: Path, name: str, columns: int, *, ascending: bool = False, counts: int = 0) -> Array:
    """The numbers (rows, columns) of a text file, gzipped or not. Text after a # is a comment.

    `ascending`: the first column must ascend. `counts`: number of leading columns that must be integers ≥ 0.
    """
    path = published_file(folder, name, SOURCE)
    with naming(path):
        table = np.loadtxt(io.BytesIO(content_of(path)), ndmin=2)
        if len(table) == 0 or table.shape[1] != columns:
            raise RecordingError(f"no table of {columns} columns")
        bad = ~(np.abs(table) <= _LARGEST).all(axis=1)
        bad |= (table[:, :counts] != np.abs(np.round(table[:, :counts]))).any(axis=1)
        if ascending:
            bad |= np.diff(table[:, 0], prepend=-math.inf) < 0.0
        if bad.any():
            row, what = int(bad.argmax()) + 1, "goes back in time" if ascending else "is no whole number"
            raise RecordingError(f"row {row} is not finite, above {_LARGEST:.0e}, or {what}")
    return table


def _driven(times: Array, odometry: Array) -> tuple[Array, Array]:
    """Motion (T, 3) and covariance (T, 3, 3) between `times`, from commands (time, v, ω) that hold until the next one.

    An early error of the heading becomes a lateral error later: C = Σ F Q Fᵀ over the spans, F = ∂u/∂du.
    """
    spans = Spans.between(times, odometry[:, 0] + _DELAY)
    v, w = np.where(spans.command >= 0, odometry[spans.command, 1:].T, 0.0)
    v, w, dt = _FORWARD_SCALE * v, _TURN_SCALE * w, spans.seconds
    heading = spans.headings(dt * w) + 0.5 * dt * w
    c, s = np.cos(heading), np.sin(heading)
    moved = dt * np.array([v * c, v * s, w])
    motions = np.column_stack([spans.sums(part, len(times)) for part in moved])
    cumulative = np.cumsum(moved[:2], axis=1)  # from the start of the log, used for the remainder of each step
    last = np.searchsorted(spans.step, spans.step, side="right") - 1
    x_left, y_left = cumulative[:, last] - cumulative
    along = dt * ((_FORWARD_SIGMA * v) ** 2 + _DRIFT**2)
    across = dt * ((_LATERAL_SIGMA * v) ** 2 + _DRIFT**2)
    turned = dt * ((_TURN_SIGMA * w) ** 2 + _TURN_DRIFT**2)
    xx = c * c * along + s * s * across + y_left**2 * turned
    xy = c * s * (along - across) - x_left * y_left * turned
    yy = s * s * along + c * c * across + x_left**2 * turned
    xt, yt = -y_left * turned, x_left * turned
    rows = [[xx, xy, xt], [xy, yy, yt], [xt, yt, turned]]
    whole = np.tile(np.eye(3), (len(times), 1, 1))
    whole[:, 0, 2], whole[:, 1, 2] = -motions[:, 1], motions[:, 0]
    covariances = _AT_REST**2 * whole @ whole.transpose(0, 2, 1)
    covariances += np.array([[spans.sums(entry, len(times)) for entry in row] for row in rows]).transpose(2, 0, 1)
    motions[:, 2] = wrap_angles(motions[:, 2])
    return motions, covariances
