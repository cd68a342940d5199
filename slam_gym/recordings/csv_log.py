"""User logs as CSV tables: one row per measurement, with the odometry in the first row of each step.

    time,forward,lateral,turn,x,y
    0.0,0,0,0,8.0,1.0
    0.0,,,,6.0,-2.0
    0.5,1.0,0.0,0.02,7.0,0.9

`time` [s]: consecutive rows with the same time are one step, whose motion only the first of them has. `forward`,
`lateral`, `turn` [m, m, rad]: the motion since the previous step, in the frame of the robot at that step; in the first
step, where the robot starts. `x`, `y` [m] ahead and to the left, or `range`, `bearing` [m, rad]: a measurement, empty
in a step without measurements. Optional: standard deviations of the motion and the measurement, in columns with the
prefix `sigma_`; `size`, `sigma_size` [m] of the feature; `kind`, its class from 0, −2 or empty if unknown; `source`,
its identity, −1 if spurious, −2 or empty if unknown.
"""

import csv
import io
import math
from pathlib import Path

import numpy as np

from slam_gym._files import content_of
from slam_gym.recordings.recording import Recording, RecordingError, naming, starts_of
from slam_gym.types import LARGEST, UNKNOWN_KIND, UNLABELLED, Array, IntArray, Scan

MOTION, POINT, POLAR = ("forward", "lateral", "turn"), ("x", "y"), ("range", "bearing")
_OPTIONAL = ("size", "sigma_size", "kind", "source")
_WHEELS = (0.02, 0.01)  # [m] default σ of a motion: constant part, and part per metre
_COMPASS = (0.01, 0.02, 0.05)  # [rad] default σ of a turn: constant part, part per metre, and part per radian
_SIGMAS = {"x": 0.05, "y": 0.05, "range": 0.05, "bearing": 0.01}  # [m, m, m, rad] default σ of a measurement


def from_csv(path: str | Path, *, range: float | None = None, field_of_view: float | None = None) -> Recording:
    """Read a log from a CSV table (see the module's docstring).

    Without `sigma_` columns, the standard deviations of a motion over d [m] that turns by a [rad] are 0.02 + 0.01 d [m]
    and 0.01 + 0.02 d + 0.05 |a| [rad], those of the start 0.02 m and 0.01 rad, of a point 0.05 m, of a range 0.05 m and
    of a bearing 0.01 rad.

    Arguments:
        path: path of the table.
        range: [m] of the sensor; by default the distance of the farthest measurement.
        field_of_view: [rad] centred on the heading; by default the smallest that contains all measurements.

    Raises FileNotFoundError, or RecordingError that names file, line and column; for a covariance that is too
    elongated, the number of the measurement, from 0.
    """
    file = Path(path)
    with naming(file):
        try:
            table = _table(content_of(file).decode("utf-8-sig"))
        except UnicodeDecodeError:
            raise RecordingError("is no text in UTF-8") from None
        except csv.Error as error:
            raise RecordingError(str(error)) from None
        measured = POLAR if "range" in table else POINT
        first = np.flatnonzero(np.diff(table["time"], prepend=-math.inf))
        seen = ~np.isnan(table[measured[0]])
        scan = _scan({name: column[seen] for name, column in table.items()}, measured)
        motions = np.column_stack([table[name][first] for name in MOTION])
        sigmas = _motion_sigmas(table, motions, first)
        distances = np.hypot(*scan.points.T) if seen.any() else np.ones(1)
        widest = np.abs(np.arctan2(scan.points[:, 1], scan.points[:, 0])).max(initial=0.1)
        return Recording(
            name=file.name,
            source=file.name,
            terms="as its owner says",
            times=table["time"][first],
            motions=motions,
            motion_covariances=np.eye(3) * sigmas[:, :, None] ** 2,
            starts=starts_of(np.add.reduceat(seen, first)),
            points=scan.points,
            covariances=scan.covariances,
            sizes=scan.sizes,
            size_variances=scan.size_variances,
            kinds=_integers(table, "kind", UNKNOWN_KIND)[seen],
            sources=_integers(table, "source", UNLABELLED)[seen],
            range=max(float(distances.max()), 1e-9) if range is None else range,
            field_of_view=min(2.0 * float(widest), 2.0 * math.pi) if field_of_view is None else field_of_view,
        )


def _table(text: str) -> dict[str, Array]:
    """The columns of a CSV text, NaN where empty. Raises RecordingError, naming line and column, for invalid cells."""
    reader = csv.DictReader(io.StringIO(text, newline=None), skipinitialspace=True)
    names = [str(name).strip() for name in reader.fieldnames or ()]
    measured = POLAR if "range" in names else POINT
    for name in ("time", *MOTION, *measured):
        if name not in names:
            raise RecordingError(f"column {name!r} is missing; there are {', '.join(names) or 'none'}")
    if len(set(names)) < len(names):
        raise RecordingError(f"a column is there twice: {', '.join(names)}")
    reader.fieldnames = names
    known = ("time", *MOTION, *measured, *(f"sigma_{name}" for name in (*MOTION, *measured)), *_OPTIONAL)
    if unknown := sorted(set(names) - set(known)):
        raise RecordingError(f"unknown column {unknown[0]!r}; known: {', '.join(known)}")
    columns: dict[str, list[float]] = {name: [] for name in names}
    lines = []
    for row in reader:
        lines.append(reader.line_num)
        where = f"line {reader.line_num}"
        if None in row or None in row.values():
            raise RecordingError(f"{where}: expected {len(names)} columns")
        for name in names:
            columns[name].append(_number(row[name], f"{where}: column {name!r}"))
    if not columns["time"]:
        raise RecordingError("has no row")
    table = {name: np.array(column) for name, column in columns.items()}
    _check(table, measured, lines)
    return table


def _integers(table: dict[str, Array], name: str, unknown: int) -> IntArray:
    """The column of that name, `unknown` where it is empty or there is none."""
    column = table.get(name, np.full(len(table["time"]), math.nan))
    return np.where(np.isnan(column), unknown, column).astype(np.int64)


def _number(text: str, where: str) -> float:
    """The number in a cell, NaN if it is empty. Raises RecordingError if it is no finite number."""
    if not text.strip():
        return math.nan
    try:
        value = float(text.replace("_", "?"))  # Python would read 1_0 as 10
    except ValueError:
        raise RecordingError(f"{where}: {text[:40]!r} is no number") from None
    if not math.isfinite(value):
        raise RecordingError(f"{where}: {text[:40]!r} is not finite; a cell without a number is empty")
    return value


def _check(table: dict[str, Array], measured: tuple[str, str], lines: list[int]) -> None:
    """Raise RecordingError for the first row where time descends, or a motion or measurement is incomplete."""
    time, empty = table["time"], {name: np.isnan(column) for name, column in table.items()}
    first = np.diff(time, prepend=-math.inf) != 0.0
    integers = {name: table.get(name, np.zeros(len(time))) for name in ("kind", "source")}
    refused = {
        "column 'time' is empty": empty["time"],
        "column 'time' descends": np.diff(time, prepend=time[:1]) < 0.0,
        f"only one of {measured[0]!r} and {measured[1]!r} is given": empty[measured[0]] != empty[measured[1]],
        "column 'range' is not above 0": table.get("range", np.ones(1)) <= 0.0,
        "column 'size' is negative": table.get("size", np.zeros(1)) < 0.0,
    }
    refused["column 'kind' is -1; a class that is unknown is -2 or an empty cell"] = integers["kind"] == -1.0
    for name, column in integers.items():
        refused[f"column {name!r} is no integer"] = ~np.isnan(column) & (column != np.round(column))
        refused[f"column {name!r} is below -2"] = column < -2.0
        refused[f"column {name!r} is above 2⁵³, the limit of exact integers"] = column > 2.0**53
    for name, often in (("turn", "degrees, or absolute headings"), ("bearing", "degrees")):
        beyond = np.abs(table.get(name, np.zeros(1))) > 2.0 * math.pi
        refused[f"column {name!r} [rad] is more than a turn; are these {often}?"] = beyond
    for name in (name for name in table if name.removeprefix("sigma_") in (*MOTION, *measured, "size")):
        refused[f"column {name!r} is above {LARGEST:.0e}"] = np.abs(table[name]) > LARGEST
    for name in MOTION:
        refused[f"column {name!r} is empty in the first row of a step"] = first & empty[name]
        again = f"column {name!r} is given again at the same time: a step has one motion, in its first row"
        refused[again] = ~first & ~empty[name]
    if ("size" in table) != ("sigma_size" in table):
        raise RecordingError("columns 'size' and 'sigma_size': only one of them is there")
    for name in (name for name in table if name.startswith("sigma_")):
        wanted = first if name.removeprefix("sigma_") in MOTION else ~empty.get(name.removeprefix("sigma_"), first)
        refused[f"column {name!r} is empty"] = wanted & empty[name]
        refused[f"column {name!r} is not above 0"] = table[name] <= 0.0
    if "size" in table:
        refused["only one of 'size' and 'sigma_size' is given"] = empty["size"] != empty["sigma_size"]
    for what, bad in refused.items():
        if bad.any():
            raise RecordingError(f"line {lines[int(bad.argmax())]}: {what}")


def _motion_sigmas(table: dict[str, Array], motions: Array, first: IntArray) -> Array:
    """(T, 3) standard deviations of the motions [m, m, rad]. The first is where the robot starts, not driven."""
    motions = np.concatenate([np.zeros((1, 3)), motions[1:]])
    driven = np.hypot(motions[:, 0], motions[:, 1])
    along = _WHEELS[0] + _WHEELS[1] * driven
    turned = _COMPASS[0] + _COMPASS[1] * driven + _COMPASS[2] * np.abs(motions[:, 2])
    columns = [table.get(f"sigma_{name}") for name in MOTION]
    sigmas = [by_rule if c is None else c[first] for c, by_rule in zip(columns, (along, along, turned))]
    return np.column_stack(sigmas)


def _scan(rows: dict[str, Array], measured: tuple[str, str]) -> Scan:
    """All measurements of the log, as one scan."""
    a, b = (rows[name] for name in measured)
    sigma_a, sigma_b = (rows.get(f"sigma_{name}", np.full(len(a), _SIGMAS[name])) for name in measured)
    sized = {"sizes": rows.get("size"), "size_sigma": rows.get("sigma_size")}
    if measured == POLAR:
        return Scan.from_polar(a, b, sigma_a, sigma_b, **sized)
    covariances = np.eye(2) * np.column_stack([sigma_a, sigma_b])[:, :, None] ** 2
    return Scan.from_points(np.column_stack([a, b]), covariances, **sized)
