"""Checks of inputs where they enter: scans that would corrupt a map, hypotheses that do not fit it, unknown names, and
settings out of range."""

import functools
import importlib
import math
import sys
from collections.abc import Iterable, Mapping
from dataclasses import replace
from types import NoneType
from typing import Any, cast, get_args, get_type_hints

import numpy as np

from slam_gym._jit import compiled
from slam_gym.types import LARGEST, UNPAIRED, Array, Experience, Hypothesis, IntArray, Odometry, Scan
from slam_gym.types._fields import FLOAT, check_array

_CONDITION = 1e12  # of a measurement's covariance, above which an update loses all its digits
_ILL_CONDITIONED = f"covariance has a condition number above {_CONDITION:.0e}"
_TOLERANCE = 1e-9  # of asymmetry, relative to the trace; of a negative determinant, relative to the variances' product
_INTEGERS = np.dtype(np.int64)

Limits = tuple[float, float]

_LENGTH: Limits = (0.01, 1e3)  # [m]
_SIGMA: Limits = (0.0, 10.0)  # [m] or [rad], and per √m or √rad
_SHARE: Limits = (0.0, 1.0)
_CONFIDENCE: Limits = (1e-9, 1.0 - 1e-12)
_COUNT: Limits = (1, 10_000)
_ANGLE: Limits = (1e-3, 2.0 * math.pi)

LIMITS: dict[str, dict[str, Limits]] = {
    "SensorSpec": {
        "range": _LENGTH, "min_range": (1e-6, 1e3), "field_of_view": _ANGLE, "range_sigma": _SIGMA,
        "range_sigma_ratio": _SHARE, "bearing_sigma": (1e-9, math.pi), "size_sigma": (1e-9, 10.0), "detection": _SHARE,
        "clutter": (0.0, 1e3), "person_detection": _SHARE, "max_features": (0, 10_000),
    },
    "BeamSpec": {"count": _COUNT, "field_of_view": _ANGLE, "range": _LENGTH, "sigma": _SIGMA},
    "OdometrySpec": {
        "forward": _SIGMA, "lateral": _SIGMA, "turn_per_radian": _SIGMA, "turn_per_metre": _SIGMA, "floor": (1e-9, 1.0),
        "slip_forward": _SIGMA, "slip_lateral": _SIGMA, "slip_turn": _SIGMA, "slip_floor": _SIGMA,
    },
    "RobotSpec": {
        "radius": (0.02, 10.0), "mass": (1e-3, 1e5), "max_speed": (1e-3, 100.0), "max_turn": (1e-3, 100.0),
        "max_acceleration": (1e-3, 1e4), "max_angular_acceleration": (1e-3, 1e4), "traction": (1e-3, 100.0),
    },
    "DynamicsSpec": {
        "tick": (1e-3, 10.0), "substeps": (1, 1000), "friction": (0.0, 100.0), "furniture_density": (1e-3, 1e5),
        "furniture_friction": (0.0, 100.0), "people": (0, 10_000), "person_radius": (0.02, 10.0),
        "person_speed": (1e-3, 100.0),
    },
    "KidnappingSpec": {"at": _CONFIDENCE, "distance": (0.0, 1e6)},
    "Scenario": {"budget": (1, 10**9), "prior_sigma": (1e-3, 100.0), "grid_resolution": (0.01, 10.0)},
    "MapSpec": {
        "confidence": _CONFIDENCE, "iterations": (1, 100), "confirmations": _COUNT, "unconfirmed_age": (0, 10**9),
    },
    "SlamSpec": {
        "reach": (1e-3, 1e9), "new_confidence": _CONFIDENCE, "recent": _COUNT, "lost_fraction": _SHARE,
        "lost_scans": _COUNT, "min_expected": _COUNT, "max_chance_probability": _SHARE,
        "max_accidental_matches": (1e-9, math.inf), "outlier_factor": (1.0, 1e6),
        "error_length": (0.0, 1e3),
    },
    "RecognitionSpec": {
        "node_limit": (1, 10**9), "every": (1, 10**9), "group": (3, 1000), "recent": (1, 10**9),
        "min_pairs": (3, 10**9), "margin": (0, 10**9), "min_fraction": _SHARE, "confidence": _CONFIDENCE,
        "inflation": (1.0, 1e3), "min_loop_pairs": (3, 10**9), "max_accidental_loops": (1e-9, 1e9),
    },
    "AtlasSpec": {"patience": (0, 10**9), "rejoin": (1, 10**9)},
}  # fmt: skip
"""Least and greatest value of each numeric setting, by the name of its dataclass.

Beyond these limits a step takes minutes, or memory runs out. A limit can be raised:
`slam_gym.validation.LIMITS["SensorSpec"]["clutter"] = (0.0, 1e4)`.
"""


class Checked:
    """Base of settings dataclasses. Making one raises ValueError that names the first number outside its `LIMITS`, or
    the first number or bool of another type than its field.
    """

    def __post_init__(self) -> None:
        kind, types = type(self).__name__, types_of(cast(Any, type(self)))
        for name, (least, greatest) in LIMITS[kind].items():
            value, is_whole = getattr(self, name), int in types[name]
            if value is None and NoneType in types[name]:
                continue
            number: Any = (int, np.integer) if is_whole else (int, float, np.number)
            if isinstance(value, bool) or not isinstance(value, number) or not least <= value <= greatest:
                what = f"a {'whole ' * is_whole}number from {least:g} to {greatest:g}"
                raise ValueError(f"{kind}.{name}={value}: expected {what} (slam_gym.validation.LIMITS)")
            if isinstance(value, np.generic):  # for each of its types, loops would be compiled again
                object.__setattr__(self, name, value.item())
        for name in (name for name, kinds in types.items() if bool in kinds):
            if not isinstance(value := getattr(self, name), (bool, np.bool_)):
                raise ValueError(f"{kind}.{name}={value!r}: expected True or False")
            object.__setattr__(self, name, bool(value))


@functools.cache
def types_of(settings: type[Any]) -> dict[str, tuple[Any, ...]]:
    """The types that each field of a dataclass may have: two if one of them is None."""
    hints = get_type_hints(settings)
    return {name: get_args(hint) if NoneType in get_args(hint) else (hint,) for name, hint in hints.items()}


def check_number(name: str, value: Any, greatest: float = sys.float_info.max) -> None:
    """Raise ValueError, naming it, unless an argument is a number from 0 to `greatest`."""
    if not (isinstance(value, int | float | np.number) and 0.0 <= float(value) <= greatest):
        raise ValueError(f"{name}={value!r}: expected a finite number from 0{f' to {greatest:g}' * (greatest < 1e9)}")


def check_count(name: str, value: Any) -> None:
    """Raise ValueError, naming it, unless an argument is a whole number from 1 on."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 1:
        raise ValueError(f"{name}: expected a whole number >= 1, got {value!r}")


def indices(name: str, values: Any, count: int, lowest: int = 0) -> IntArray:
    """`values` (k,) as a plain array. Raises ValueError, naming them, unless they are integers from `lowest` to
    `count` − 1; a mask of booleans is none."""
    array = np.asarray(values)
    if array.ndim != 1 or (array.size and array.dtype.kind not in "iu"):
        raise ValueError(f"{name}: {array.dtype} of shape {array.shape}, expected indices (k,)")
    if ((array < lowest) | (array >= count)).any():
        raise ValueError(f"{name}: {array.tolist()} are not all from {lowest} to {count - 1}")
    return np.ascontiguousarray(array, np.int64)


@compiled
def check_measurements(points: Array, covariances: Array) -> None:
    """`check_scan` for its points (m, 2) and covariances (m, 2, 2)."""
    for i in range(points.shape[0]):
        if not (abs(points[i, 0]) <= LARGEST and abs(points[i, 1]) <= LARGEST):
            raise ValueError(f"Scan: measurement {i}: points are not finite, or beyond 1e9 m")
        a, b, c, d = covariances[i, 0, 0], covariances[i, 0, 1], covariances[i, 1, 0], covariances[i, 1, 1]
        if not (math.isfinite(a) and math.isfinite(b) and math.isfinite(c) and math.isfinite(d)):
            raise ValueError(f"Scan: measurement {i}: covariance is not finite")
        trace, determinant = a + d, a * d - b * b
        if abs(b - c) > _TOLERANCE * (abs(a) + abs(d)):
            raise ValueError(f"Scan: measurement {i}: covariance is not symmetric")
        if a < 0.0 or d < 0.0 or determinant < -_TOLERANCE * a * d:
            raise ValueError(f"Scan: measurement {i}: covariance is not PSD")
        # λ_max / λ_min is about trace² / det where it is large; an exact measurement, all zeros, passes
        if trace * trace > _CONDITION * determinant:
            raise ValueError(f"Scan: measurement {i}: {_ILL_CONDITIONED}")


def check_inputs(odometry: Odometry, scan: Scan) -> None:
    """Raise ValueError unless a step is given an `Odometry` and a `Scan`, in this order."""
    if not isinstance(odometry, Odometry):
        raise ValueError(f"odometry: {type(odometry).__name__}, expected Odometry (Odometry.from_motion makes one)")
    if not isinstance(scan, Scan):
        raise ValueError(f"scan: {type(scan).__name__}, expected Scan (Scan.from_points makes one)")


def check_scan(scan: Scan) -> None:
    """Raise ValueError naming the first faulty measurement of a scan and its fault."""
    points, covariances = scan.points, scan.covariances
    if not (points.flags.carray and covariances.flags.carray):
        points, covariances, *_ = scan.arrays
    check_measurements(points, covariances)


def check_hypothesis(hypothesis: Hypothesis, measurements: int, features: int) -> Hypothesis:
    """Return the hypothesis with its decisions as a plain array (m,), after checking that they fit m `measurements` and
    a map of n `features`.

    Raises ValueError where it is not a `Hypothesis`, where its features are not m signed integers −1 … n−1, where an
    exclusive hypothesis pairs a feature twice, where its D²_H and degrees of freedom are no numbers, where a
    measurement is both paired and new, and where its experience is none.
    """
    if not isinstance(hypothesis, Hypothesis):
        raise ValueError(f"hypothesis: {type(hypothesis).__name__}, expected a Hypothesis")
    array = hypothesis.features
    plain = type(array) is np.ndarray and array.dtype == _INTEGERS and array.flags.carray
    if (not plain and (not isinstance(array, np.ndarray) or array.dtype.kind != "i")) or array.shape != (measurements,):
        actual = f"{array.dtype} of shape {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
        raise ValueError(f"hypothesis.features: {actual}, expected ({measurements},) signed integers")
    # compiled functions take plain int64 arrays only
    decisions = array if plain else np.array(array, dtype=np.int64, subok=False)
    paired: set[int] = set()
    for entry, feature in enumerate(decisions.tolist()):
        if not UNPAIRED <= feature < features:
            raise ValueError(
                f"hypothesis.features[{entry}]: {feature}, expected −1{f' … {features - 1}' * (features > 0)}"
            )
        if hypothesis.exclusive and feature in paired:
            raise ValueError(
                f"hypothesis.features[{entry}]: feature {feature} is paired twice (exclusive=False allows it)"
            )
        if feature != UNPAIRED:
            paired.add(feature)
    _check_experience(hypothesis.experience)
    for name, value in (("joint_distance", hypothesis.joint_distance), ("dof", hypothesis.dof)):
        if not isinstance(value, int | float | np.number):
            raise ValueError(f"hypothesis.{name}: {value!r}, expected a number")
    new: Any = hypothesis.new
    is_mask = isinstance(new, np.ndarray) and new.shape == decisions.shape and new.dtype == np.bool_
    if new is not None and not (is_mask and not (new & (decisions >= 0)).any()):
        raise ValueError(f"hypothesis.new: expected ({measurements},) booleans, true for unpaired measurements only")
    return hypothesis if decisions is array else replace(hypothesis, features=decisions)


def _check_experience(experience: object) -> None:
    """Raise ValueError unless it is None or an `Experience` of finite numbers."""
    if experience is None:
        return
    if not isinstance(experience, Experience):
        raise ValueError(f"hypothesis.experience: {type(experience).__name__}, expected an Experience or None")
    detections = experience.detections
    check_array("hypothesis.experience.detections", detections, FLOAT, (np.size(detections),))
    if not np.isfinite(detections).all():
        raise ValueError("hypothesis.experience.detections: not finite")
    for name in ("unpaired", "area"):
        check_number(f"hypothesis.experience.{name}", getattr(experience, name))


def one_of(name: str, value: Any, known: Any) -> None:
    """Raise ValueError, listing the known values of an argument, unless `value` is one of them."""
    if value not in known:
        raise ValueError(f"{name}={value!r}; {known_names(value, known)}")


def known_names(unknown: Any, known: Iterable[Any], further: str = "") -> str:
    """The end of an error message about an unknown name: the name that was probably meant, and all known names."""
    from difflib import get_close_matches  # needed for errors only

    names = [str(name) for name in known]
    lower = {name.lower().replace("-", "_"): name for name in names}
    close = get_close_matches(str(unknown).lower().replace("-", "_"), lower, n=1, cutoff=0.75)
    meant = f"did you mean {lower[close[0]]!r}? " if close else ""
    return f"{meant}known: {', '.join(names)}{further}"


def imported(what: str, given: str, table: Mapping[str, Any], further: str = "") -> Any:
    """The object that `"module:name"` names: an attribute of the module, or an entry of `table` that importing it
    creates.

    Raises ValueError, listing the names of the table and the `further` ones, where there is no such object;
    ModuleNotFoundError where the module exists but a module that it imports is missing.
    """
    module, colon, name = given.partition(":")
    known = known_names(given, table, f"{further}, or 'module:name'")
    if not colon:
        raise ValueError(f"unknown {what} {given!r}; {known}")
    try:
        loaded = importlib.import_module(module)
        return table[name] if name in table and not hasattr(loaded, name) else getattr(loaded, name)
    except (ImportError, AttributeError, ValueError) as error:
        if isinstance(error, ModuleNotFoundError) and not module.startswith(error.name or ""):
            raise
        raise ValueError(f"{what} {given!r}: {error}; {known}") from error
