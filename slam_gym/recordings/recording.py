"""A log of odometry and feature scans in a common format; `recordings/FORMAT.md` describes its file.

A log is a sequence of T steps. In step t the robot moves by `motions[t]` and then takes a scan. `Odometry` and `Scan`
are those of the simulator, so whatever runs on one runs on the other.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slam_gym._files import MAX_BYTES, array_of, replacing, zip_members
from slam_gym.geometry import compose, compose_jacobians, wrap_angles
from slam_gym.types import LARGEST, SPURIOUS, UNKNOWN_KIND, UNLABELLED, Array, BoolArray, IntArray, Odometry, Scan
from slam_gym.validation import check_measurements

FORMAT, VERSION = "slam_gym recording", 1
_PER_MEASUREMENT = ("points", "covariances", "sizes", "size_variances", "kinds", "sources")
_TEXTS = ("name", "source", "terms")
_INTEGERS = ("starts", "kinds", "sources", "landmark_ids")
_NUMBERS = ("range", "field_of_view")
_UNKNOWN = {"sizes": math.nan, "size_variances": math.nan, "kinds": UNKNOWN_KIND}  # where a field is left out
_LARGEST_IDENTITY = 1 << 20
_TOLERANCE = 1e-9  # for asymmetry and negative eigenvalues, relative to the largest entry


class RecordingError(ValueError):
    """A recording, or a file that should contain one, is invalid. The message names the file, field or line."""


@contextlib.contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Turn errors into RecordingErrors that name `path`, or a line. Floating-point warnings are suppressed."""
    try:
        with np.errstate(all="ignore"):  # the checks of fields reject numbers that overflow
            yield
    except (ValueError, ArithmeticError) as error:
        message = str(error)
        raise RecordingError(message if message.startswith(str(path)) else f"{path}: {message}") from None


@dataclass(frozen=True, kw_only=True)
class Recording:
    """A log. Frames: R is the robot at the time of a step, W the frame of the reference, if there is one.

    The heading of a reference pose is NaN where only the position is known. Identities are not changed, unless one is
    2²⁰ or above: then they are renumbered 0, 1, 2 … in their order, so that tables by identity stay small.
    Raises RecordingError, naming the field, where arrays do not fit together or contain invalid entries.
    """

    name: str
    source: str  # where it is published and what to cite
    terms: str  # terms of use
    times: Array  # (T,) [s] not descending
    motions: Array  # (T, 3) [m, m, rad] pose at step t in R of step t − 1 (of the start, for t = 0)
    motion_covariances: Array  # (T, 3, 3) [m², m·rad, rad²]
    starts: IntArray  # (T + 1,) measurements of step t: rows starts[t]:starts[t + 1] of the arrays (M, …)
    points: Array  # (M, 2) [m] in R
    covariances: Array  # (M, 2, 2) [m²] in R
    sizes: Array = None  # type: ignore[assignment]  # (M,) [m] measured intrinsic attribute, NaN where unknown: default
    size_variances: Array = None  # type: ignore[assignment]  # (M,) [m²], NaN where unknown
    kinds: IntArray = None  # type: ignore[assignment]  # (M,) class from 0, −2 where unknown: default
    sources: IntArray  # (M,) identity ≥ 0 of the feature behind each measurement, see below; −1 spurious, −2 unknown
    reference_times: Array = field(default_factory=lambda: np.empty(0))  # (G,) [s] ascending
    reference_poses: Array = field(default_factory=lambda: np.empty((0, 3)))  # (G, 3) [m, m, rad] in W, see below
    landmark_ids: IntArray = field(default_factory=lambda: np.empty(0, np.int64))  # (L,) identities of known landmarks
    landmarks: Array = field(default_factory=lambda: np.empty((0, 2)))  # (L, 2) [m] positions in W
    range: float  # [m] greatest range of the sensor
    field_of_view: float  # [rad] of the sensor, centred on the heading

    def __post_init__(self) -> None:
        for name in (array.name for array in fields(self) if array.name not in (*_TEXTS, *_NUMBERS)):
            given = getattr(self, name)
            unknown = given is None and name in _UNKNOWN
            values = np.full(len(self.points), _UNKNOWN[name]) if unknown else np.asarray(given)
            object.__setattr__(self, name, _as_stored(name, values))
        _validate(self)
        if max(self.sources.max(initial=0), self.landmark_ids.max(initial=0)) >= _LARGEST_IDENTITY:
            known = np.unique(np.concatenate([self.sources[self.sources >= 0], self.landmark_ids]))
            rank = np.where(self.sources >= 0, np.searchsorted(known, self.sources), self.sources)
            object.__setattr__(self, "sources", rank.astype(np.int64))
            object.__setattr__(self, "landmark_ids", np.searchsorted(known, self.landmark_ids).astype(np.int64))

    def __len__(self) -> int:
        return len(self.times)

    def odometry(self, step: int) -> Odometry:
        """The motion before the scan of `step`."""
        return Odometry(self.motions[step], self.motion_covariances[step])

    def scan(self, step: int) -> Scan:
        """The scan of `step`."""
        rows = slice(self.starts[step], self.starts[step + 1])
        return Scan(*(getattr(self, name)[rows] for name in _PER_MEASUREMENT if name != "sources"))

    def sources_of(self, step: int) -> IntArray:
        """(m,) identities of the features behind the measurements of `step`."""
        return self.sources[self.starts[step] : self.starts[step + 1]]

    def steps(self) -> Iterator[tuple[Odometry, Scan, IntArray]]:
        """Odometry, scan and identities, step by step."""
        for step in range(len(self)):
            yield self.odometry(step), self.scan(step), self.sources_of(step)

    def part(self, first: int = 0, last: int | None = None) -> Recording:
        """Steps `first` … `last` − 1, with the whole reference. Raises IndexError outside the log."""
        last = len(self) if last is None else last
        if not 0 <= first < last <= len(self):
            raise IndexError(f"steps {first} … {last} of a recording of {len(self)}")
        return self._reduced(slice(first, last), self.motions, self.motion_covariances)

    def every(self, count: int) -> Recording:
        """Steps 0, `count`, 2·`count` …; motions and covariances of the steps between are compounded.

        The measurements of the steps between are dropped. Raises ValueError for a count below 1.
        """
        if count < 1:
            raise ValueError(f"every {count}th step of a recording: expected at least 1")
        motions, covariances = self.motions.copy(), self.motion_covariances.copy()
        for k in range(1, len(self)):
            if k % count != 1 % count:  # append the motion to that of the step before
                to_before, to_motion = compose_jacobians(motions[k - 1], self.motions[k])
                motions[k] = compose(motions[k - 1], self.motions[k])
                before = to_before @ covariances[k - 1] @ to_before.T
                joint = before + to_motion @ self.motion_covariances[k] @ to_motion.T
                covariances[k] = 0.5 * (joint + joint.T)
        return self._reduced(slice(None, None, count), motions, covariances)

    def _reduced(self, kept: slice, motions: Array, motion_covariances: Array) -> Recording:
        """The `kept` steps and their measurements, with their motions among the given ones of all steps."""
        counts, steps = np.diff(self.starts), np.arange(len(self))
        rows = np.repeat(np.isin(steps, steps[kept]), counts)
        return replace(
            self,
            times=self.times[kept],
            motions=motions[kept],
            motion_covariances=motion_covariances[kept],
            starts=starts_of(counts[kept]),
            **{name: getattr(self, name)[rows] for name in _PER_MEASUREMENT},
        )


def save(recording: Recording, path: str | Path) -> None:
    """Write a recording to `path` (.npz, no pickles), atomically. Raises RecordingError for more than `load` reads."""
    target = Path(path)
    arrays: dict[str, Any] = {field.name: np.asarray(getattr(recording, field.name)) for field in fields(recording)}
    if (recording.kinds == UNKNOWN_KIND).all():  # then earlier releases can read the file
        del arrays["kinds"]
    if sum(array.nbytes + 1024 for array in arrays.values()) > MAX_BYTES:  # with the heads of its members
        raise RecordingError(f"{path}: {len(recording.points)} measurements are more than {MAX_BYTES >> 20} MB")
    with replacing(target) as file:
        np.savez_compressed(file, format=np.array(FORMAT), version=np.array(VERSION), **arrays)


def load(path: str | Path) -> Recording:
    """Read a recording file (`recordings/FORMAT.md`), such as `save` writes.

    Raises FileNotFoundError, or RecordingError that names the file and what is wrong. Nothing is unpickled.
    """
    known = {field.name for field in fields(Recording)}
    with naming(path):
        content = zip_members(Path(path))
        if unknown := sorted(set(content) - known - {"format", "version"}):
            raise RecordingError(f"unknown field {unknown[0][:40]!r}")
        for name in ("format", "version", *sorted(known - {"kinds"})):  # files of earlier releases have no kinds
            if name not in content:
                raise RecordingError(f"field {name!r} is missing")
        if str(array_of(content["format"], "U")) != FORMAT:
            raise RecordingError(f"field 'format' does not say {FORMAT!r}")
        version = array_of(content["version"], "iu")
        if version.shape != () or version != VERSION:
            raise RecordingError(f"field 'version' is {version}; this release reads version {VERSION}")
        return Recording(**{name: _field_of(name, content[name]) for name in known if name in content})


def _field_of(name: str, content: bytes) -> Any:
    """The value of a field of `Recording` from the `content` of its array file."""
    kinds = "U" if name in _TEXTS else "iu" if name in _INTEGERS else "fiu"
    try:
        value = array_of(content, kinds)
    except ValueError as error:
        raise RecordingError(f"field {name!r} {error}") from None
    if name in _TEXTS or name in _NUMBERS:
        if value.shape != ():
            raise RecordingError(f"field {name!r} has shape {value.shape}, expected one text or number")
        return value.item() if name in _TEXTS else float(value)
    return value


def _as_stored(name: str, values: NDArray[Any]) -> NDArray[Any]:
    """A field as a contiguous array of its type. Raises RecordingError for values that are not of its kind."""
    whole = name in _INTEGERS
    if values.size and values.dtype.kind not in ("iu" if whole else "iuf"):
        raise RecordingError(f"field {name!r} has entries of type {values.dtype}")
    if whole and values.dtype == np.uint64 and values.size and values.max() > np.iinfo(np.int64).max:
        raise RecordingError(f"field {name!r} holds {values.max()}, which is above 2⁶³ − 1")
    return np.ascontiguousarray(values, dtype=np.int64 if whole else np.float64)


def write_tum(path: str | Path, times: ArrayLike, poses: ArrayLike) -> None:
    """Write poses (t, 3) [m, m, rad] at `times` (t,) [s] in lines `t x y z qx qy qz qw` (Sturm et al., IROS 2012).

    Raises ValueError where the shapes do not fit, or a number is not finite.
    """
    at, trajectory = np.asarray(times, np.float64), np.asarray(poses, np.float64)
    if at.ndim != 1 or trajectory.shape != (len(at), 3):
        raise ValueError(f"times, poses: shapes {at.shape} and {trajectory.shape}, expected (t,) and (t, 3)")
    if not (np.isfinite(at).all() and np.isfinite(trajectory).all()):
        raise ValueError("times, poses: not all of them are finite")
    half, zero = 0.5 * trajectory[:, 2], np.zeros(len(at))
    rows = np.column_stack([at, trajectory[:, :2], zero, zero, zero, np.sin(half), np.cos(half)])
    np.savetxt(path, rows, fmt=["%.9f"] + 7 * ["%.12g"], header="timestamp x y z qx qy qz qw")


def interpolate(times: Array, poses: Array, at: Array) -> Array:
    """(k, 3) poses at the times `at` (k,), by linear interpolation of `poses` (t, 3) at `times` (t,).

    All headings are NaN if any of `poses` has none. At the same times the result is `poses`, even where times repeat.
    """
    if np.array_equal(times, at):
        return poses.copy()
    headings = poses[:, 2] if np.isnan(poses[:, 2]).any() else np.unwrap(poses[:, 2])
    x, y, heading = (np.interp(at, times, column) for column in (poses[:, 0], poses[:, 1], headings))
    return np.column_stack([x, y, wrap_angles(heading)])


def _validate(log: Recording) -> None:
    T, M, G, L = len(log.times), len(log.points), len(log.reference_times), len(log.landmark_ids)
    shapes = {
        "times": (T,), "motions": (T, 3), "motion_covariances": (T, 3, 3), "starts": (T + 1,), "points": (M, 2),
        "covariances": (M, 2, 2), "sizes": (M,), "size_variances": (M,), "kinds": (M,), "sources": (M,),
        "reference_times": (G,), "reference_poses": (G, 3), "landmark_ids": (L,), "landmarks": (L, 2),
    }  # fmt: skip
    for name, shape in shapes.items():
        found = np.shape(getattr(log, name))
        if found != shape:
            raise RecordingError(f"field {name!r} has shape {found}, expected {shape}")
    for name in _TEXTS:
        if not isinstance(getattr(log, name), str):
            raise RecordingError(f"field {name!r} is {getattr(log, name)!r}, expected a text")
    for name in ("times", "motions", "motion_covariances", "points", "covariances", "reference_times", "landmarks"):
        _refuse(name, ~np.isfinite(getattr(log, name)), "is not finite")
    for name in ("motions", "points", "landmarks", "sizes"):
        _refuse(name, np.abs(getattr(log, name)) > LARGEST, f"is larger than {LARGEST:.0e}")
    for name in ("motion_covariances", "covariances", "size_variances"):
        _refuse(name, np.abs(getattr(log, name)) > LARGEST**2, f"is larger than {LARGEST**2:.0e}")
    for name in ("motion_covariances", "covariances"):
        _refuse(name, ~_are_covariances(getattr(log, name)), "is no covariance")
    try:
        check_measurements(log.points, log.covariances)
    except ValueError as error:
        raise RecordingError(str(error).replace("Scan: ", "field 'covariances': ")) from None
    for name in ("times", "reference_times"):
        times = getattr(log, name)
        _refuse(name, np.diff(times, prepend=times[:1]) < 0.0, "comes before the entry before it")
    starts = np.clip(log.starts, -1, M + 1)  # differences of numbers far outside could overflow
    _refuse("starts", np.diff(starts, prepend=0) < 0, "descends")
    if starts[0] != 0 or starts[-1] != M:
        raise RecordingError(f"field 'starts' goes from {log.starts[0]} to {log.starts[-1]}, expected 0 to {M}")
    _refuse("reference_poses", ~np.isfinite(log.reference_poses[:, :2]), "has no finite position")
    _refuse("reference_poses", np.isinf(log.reference_poses[:, 2]), "has an infinite heading")
    _refuse("size_variances", log.size_variances < 0.0, "is negative")
    _refuse("size_variances", np.isnan(log.sizes) != np.isnan(log.size_variances), "is NaN where the size is not")
    _refuse("kinds", (log.kinds < 0) & (log.kinds != UNKNOWN_KIND), f"is neither a class from 0 nor {UNKNOWN_KIND}")
    _refuse("sources", log.sources < UNLABELLED, f"is neither an identity nor {SPURIOUS} nor {UNLABELLED}")
    _refuse("landmark_ids", log.landmark_ids < 0, "is negative")
    if len(np.unique(log.landmark_ids)) != L:
        raise RecordingError("field 'landmark_ids' names a landmark twice")
    if not (0.0 < log.range < np.inf):
        raise RecordingError(f"field 'range' is {log.range}, expected a length > 0 [m]")
    if not (0.0 < log.field_of_view <= 2.0 * np.pi + 1e-9):
        raise RecordingError(f"field 'field_of_view' is {log.field_of_view}, expected an angle in (0, 2π]")


def _refuse(name: str, bad: BoolArray, what: str) -> None:
    """Raise RecordingError, naming the field, at its first entry where any of `bad` (n, …) is True."""
    if bad.any():
        raise RecordingError(f"field {name!r}: entry {int(np.nonzero(bad)[0][0])} {what}")


def _are_covariances(matrices: Array) -> BoolArray:
    scale = np.abs(matrices).max(axis=(1, 2), initial=np.finfo(float).tiny)
    symmetric = np.abs(matrices - matrices.transpose(0, 2, 1)).max(axis=(1, 2)) <= _TOLERANCE * scale
    good: BoolArray = symmetric & (np.linalg.eigvalsh(matrices).min(axis=1) >= -_TOLERANCE * scale)
    return good


# -- for the readers of logs -----------------------------------------------------------------------------------------


def published_file(folder: Path, name: str, source: str) -> Path:
    """The path of a published file, gzipped or not. Raises FileNotFoundError that names its `source`."""
    for path in (folder / name, folder / f"{name}.gz"):
        if path.is_file():
            return path
    raise FileNotFoundError(f"{folder / name}: not there, gzipped or not. {source}")


def starts_of(counts: ArrayLike) -> IntArray:
    """(T + 1,) rows at which the measurements of each step start, and the end; `counts` (T,) are their numbers."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


class Spans(NamedTuple):
    """The time between the scans of a log, divided into spans of constant command."""

    step: IntArray  # (s,) the scan that each span leads to
    command: IntArray  # (s,) the command during each span, −1 before the first command
    seconds: Array  # (s,) duration

    @classmethod
    def between(cls, looks: Array, commands: Array) -> Spans:
        """Spans for scans at the times `looks` (T,) and commands from the times `commands` (n,), both ascending [s]."""
        within = commands[(commands > looks[0]) & (commands < looks[-1])]
        edges = np.unique(np.concatenate([looks, within]))
        after = np.searchsorted(looks, edges[:-1], side="right")
        return cls(after, np.searchsorted(commands, edges[:-1], side="right") - 1, np.diff(edges))

    def headings(self, turns: Array) -> Array:
        """(s,) [rad] heading at the start of each span, relative to the scan before it; `turns` (s,) [rad]."""
        before = np.cumsum(turns) - turns
        return before - before[np.searchsorted(self.step, self.step)]

    def sums(self, values: Array, looks: int) -> Array:
        """(T,) sum of the `values` (s,) of the spans that lead to each of the T = `looks` scans."""
        return np.asarray(np.bincount(self.step, values, looks), np.float64)
