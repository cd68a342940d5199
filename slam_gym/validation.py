"""Refuse by name what would do harm further in: scans that would corrupt a map, hypotheses that do not fit it,
arguments that nobody knows."""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from slam_gym._jit import compiled
from slam_gym.types import UNPAIRED, Array, Hypothesis, IntArray, Odometry, Scan

_CONDITION = 1e12  # of a measurement's covariance, beyond which an update loses all its digits
_TOLERANCE = 1e-9  # of asymmetry, relative to the trace; of a negative determinant, to the variances' product


_MEASUREMENT_FAULTS = (
    "",
    "points are not finite",
    "covariance is not finite",
    "covariance is not symmetric",
    "covariance is not PSD",
    f"covariance has a condition number above {_CONDITION:.0e}",
)


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
    },
    "RecognitionSpec": {
        "node_limit": (1, 10**9), "every": (1, 10**9), "group": (3, 1000), "recent": (1, 10**9),
        "min_pairs": (3, 10**9), "above_mirror": (0, 10**9), "min_fraction": _SHARE, "confidence": _CONFIDENCE,
        "inflation": (1.0, 1e3),
    },
    "AtlasSpec": {"max_accidental_matches": (1e-9, math.inf), "patience": (0, 10**9), "rejoin": (1, 10**9)},
}  # fmt: skip
"""Least and greatest value of each number among the settings, by the name of their dataclass.

Beyond them a step takes minutes, or memory runs out. Who needs more raises a limit:
`slam_gym.validation.LIMITS["SensorSpec"]["clutter"] = (0.0, 1e4)`.
"""


def check_settings(settings: object) -> None:
    """Raise ValueError naming the first number of a dataclass of settings that is not within its `LIMITS`.

    None passes, where a setting may be None.
    """
    kind = type(settings).__name__
    for name, (least, greatest) in LIMITS[kind].items():
        value = getattr(settings, name)
        if value is not None and not least <= value <= greatest:
            raise ValueError(
                f"{kind}.{name}={value}: expected a number from {least:g} to {greatest:g} (slam_gym.validation.LIMITS)"
            )


_INTEGERS = np.dtype(np.int64)


@compiled
def first_bad_measurement(points: Array, covariances: Array) -> tuple[int, int]:
    """The first measurement with a fault, and the number of that fault; (−1, 0) if all is fine."""
    for i in range(points.shape[0]):
        if not (math.isfinite(points[i, 0]) and math.isfinite(points[i, 1])):
            return i, 1
        a, b, c, d = covariances[i, 0, 0], covariances[i, 0, 1], covariances[i, 1, 0], covariances[i, 1, 1]
        if not (math.isfinite(a) and math.isfinite(b) and math.isfinite(c) and math.isfinite(d)):
            return i, 2
        trace, determinant = a + d, a * d - b * b
        if abs(b - c) > _TOLERANCE * (abs(a) + abs(d)):
            return i, 3
        if a < 0.0 or d < 0.0 or determinant < -_TOLERANCE * a * d:
            return i, 4
        # λ_max / λ_min is about trace² / det where it is large; an exact measurement, all zeros, has none
        if trace * trace > _CONDITION * determinant:
            return i, 5
    return -1, 0


def check_inputs(odometry: Odometry, scan: Scan) -> None:
    """Raise ValueError where a step is handed something else than a motion and a scan, or the two in turn."""
    for name, given, expected, maker in (
        ("odometry", odometry, Odometry, "Odometry.from_motion"),
        ("scan", scan, Scan, "Scan.from_points"),
    ):
        if not isinstance(given, expected):
            raise ValueError(f"{name}: {type(given).__name__}, expected {expected.__name__} ({maker} makes one)")


def check_scan(scan: Scan) -> None:
    """Raise ValueError naming the field and the first bad measurement of a scan."""
    entry, fault = first_bad_measurement(scan.points, scan.covariances)
    if fault:
        raise ValueError(f"Scan: measurement {entry}: {_MEASUREMENT_FAULTS[fault]}")


@compiled
def _first_bad_decision(features: IntArray, n: int, exclusive: bool) -> tuple[int, int]:
    """The first decision that is out of range (1) or for a feature paired already (2), and which; else (−1, 0)."""
    for i in range(len(features)):
        if features[i] < UNPAIRED or features[i] >= n:
            return i, 1
        if exclusive and features[i] != UNPAIRED:
            for earlier in range(i):
                if features[earlier] == features[i]:
                    return i, 2
    return -1, 0


def check_hypothesis(hypothesis: Hypothesis, measurements: int, features: int) -> Hypothesis:
    """The hypothesis, its decisions as a plain array (m,), once they fit m `measurements` and a map of n `features`.

    Raises ValueError where it is none, where they are not m signed integers −1 … n−1, where a feature is paired twice
    by a hypothesis that is exclusive, and where a measurement is paired and called new.
    """
    if not isinstance(hypothesis, Hypothesis):
        raise ValueError(f"hypothesis: {type(hypothesis).__name__}, expected a Hypothesis")
    given = hypothesis.features
    plain = type(given) is np.ndarray and given.dtype == _INTEGERS and given.flags.carray
    if (not plain and (not isinstance(given, np.ndarray) or given.dtype.kind != "i")) or given.shape != (measurements,):
        told = f"{given.dtype} of shape {given.shape}" if isinstance(given, np.ndarray) else type(given).__name__
        raise ValueError(f"hypothesis.features: {told}, expected ({measurements},) signed integers")
    # what follows is compiled for plain arrays alone
    decisions = given if plain else np.array(given, dtype=np.int64, subok=False)
    entry, fault = _first_bad_decision(decisions, features, hypothesis.exclusive)
    if fault == 1:
        raise ValueError(f"hypothesis.features[{entry}]: {decisions[entry]}, expected −1 … {features - 1}")
    if fault == 2:
        raise ValueError(f"hypothesis.features[{entry}]: feature {decisions[entry]} is paired twice")
    if hypothesis.new is not None and not _fits(hypothesis.new, decisions):
        raise ValueError(f"hypothesis.new: expected ({measurements},) booleans, true for unpaired measurements only")
    return hypothesis if decisions is given else replace(hypothesis, features=decisions)


def _fits(new: Any, decisions: IntArray) -> bool:
    """Whether `new` are booleans, one for each decision and none of them for one that pairs."""
    right = isinstance(new, np.ndarray) and new.shape == decisions.shape and new.dtype == np.bool_
    return right and not bool((new & (decisions >= 0)).any())


def one_of(name: str, value: Any, known: Any) -> None:
    """Raise ValueError, listing the known values of an argument, where `value` is none of them."""
    if value not in known:
        raise ValueError(f"{name}={value!r}; {known_names(value, known)}")


def known_names(given: Any, known: Iterable[Any], further: str = "") -> str:
    """How an error about a name that nobody knows goes on: the one that was perhaps meant, and all that are known."""
    from difflib import get_close_matches  # errors alone need it

    names = [str(name) for name in known]
    lower = {name.lower().replace("-", "_"): name for name in names}
    close = get_close_matches(str(given).lower().replace("-", "_"), lower, n=1, cutoff=0.75)
    meant = f"did you mean {lower[close[0]]!r}? " if close else ""
    return f"{meant}known: {', '.join(names)}{further}"


def imported(what: str, given: str, table: Mapping[str, Any], further: str = "") -> Any:
    """What stands behind `"module:name"`: an attribute of the module, or what it enters in `table` as it is imported.

    Raises ValueError, listing the names of the table and those that are `further` known, where there is none;
    ModuleNotFoundError where the module is there but needs another that is not.
    """
    module, colon, name = given.partition(":")
    known = known_names(given, table, f"{further}, or 'module:name'")
    if not colon:
        raise ValueError(f"unknown {what} {given!r}; {known}")
    try:
        found = importlib.import_module(module)
        return table[name] if name in table and not hasattr(found, name) else getattr(found, name)
    except (ImportError, AttributeError, ValueError) as error:
        if isinstance(error, ModuleNotFoundError) and not module.startswith(error.name or ""):
            raise
        raise ValueError(f"{what} {given!r}: {error}; {known}") from error
