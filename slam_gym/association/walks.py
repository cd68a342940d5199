"""Walks of the interpretation tree, with a prior on the pose or without: policies, orders, and how measurements are
shown."""

import math
from collections.abc import Callable
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from slam_gym.types import BoolArray, IntArray, Scan

Float32Array = NDArray[np.float32]
Observation = dict[str, Float32Array]

Policy = Callable[[Observation, BoolArray], int]
"""Observation of a walk and mask -> a legal action. Action a < K pairs the measurement with candidate a, action K is
`*`. Without a prior, `*` stops at a leaf, and action K + 1 restarts."""

Order = Literal["as_scanned", "nearest_first", "fewest_candidates"]
"""The order in which measurements are decided: as in the scan, by distance from the robot, or by ascending number of
candidate features, so that clear measurements are decided before ambiguous ones."""

ORDERS: tuple[str, ...] = get_args(Order)

POSITION_SCALE, SIGMA_SCALE, SIZE_SCALE = 6.0, 0.1, 1.0  # [m]

MEASURED_FIELDS = ("x", "y", "sigma_x", "correlation", "sigma_y", "size")
"""Fields of a measurement, in R. An unknown size is 0."""


def in_order(scan: Scan, order: str, candidates: Callable[[], IntArray]) -> IntArray:
    """The measurements (m,) in an `Order`; `candidates` counts the candidate features of each, (m,)."""
    if order == "as_scanned":
        return np.arange(len(scan))
    key = np.hypot(scan.points[:, 0], scan.points[:, 1]) if order == "nearest_first" else candidates()
    return np.argsort(key, kind="stable")


def squash(value: Any, scale: float) -> Any:
    """v / (|v| + scale): a monotone map into (−1, 1), 0 at 0 and ±½ at ±scale."""
    return value / (abs(value) + scale)


def measurement_shown(scan: Scan, i: int) -> list[float]:
    """The `MEASURED_FIELDS` of a measurement, scaled to [−1, 1]."""
    (x, y), size = scan.points[i].tolist(), float(scan.sizes[i])
    (xx, xy), (_, yy) = scan.covariances[i].tolist()
    sx, sy = math.sqrt(max(xx, 0.0)), math.sqrt(max(yy, 0.0))
    correlation = min(max(xy / (sx * sy), -1.0), 1.0) if sx * sy > 0.0 else 0.0
    scaled: list[float] = [squash(x, POSITION_SCALE), squash(y, POSITION_SCALE), squash(sx, SIGMA_SCALE)]
    return [*scaled, correlation, squash(sy, SIGMA_SCALE), 0.0 if math.isnan(size) else squash(size, SIZE_SCALE)]
