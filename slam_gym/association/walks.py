"""What walks of the interpretation tree share, with a prior on the pose and without: policies, measurements."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from slam_gym.types import BoolArray, Scan

Float32Array = NDArray[np.float32]
Observation = dict[str, Float32Array]

Policy = Callable[[Observation, BoolArray], int]
"""Observation of a walk and mask -> a legal action: a < K pairs with the a-th candidate on offer, K is `*`. Without a
prior, `*` stops at a leaf, and K + 1 restarts."""

Order = Literal["as_scanned", "nearest_first", "fewest_candidates"]
"""In which order measurements are decided: as the scan has them; by distance from the robot; those first that have the
fewest features to choose from, which decides what is plain before what is ambiguous."""

ORDERS: tuple[str, ...] = get_args(Order)

POSITION_SCALE, SIGMA_SCALE, SIZE_SCALE = 6.0, 0.1, 1.0  # [m]

MEASURED_FIELDS = ("x", "y", "sigma_x", "correlation", "sigma_y", "size")
"""Of a measurement, in R. An unknown size is 0."""


class Walk(Protocol):
    """A walk of either tree, decision by decision."""

    @property
    def mask(self) -> BoolArray:
        """The legal actions."""

    @property
    def done(self) -> bool:
        """Nothing is left to decide."""

    def take(self, action: int) -> None:
        """Raises ValueError for an action that is not legal."""


def play(walk: Walk, policy: Policy, observe: Callable[[], Observation]) -> None:
    """Have a policy take all decisions of a walk."""
    while not walk.done:
        walk.take(int(policy(observe(), walk.mask.copy())))


def squash(value: Any, scale: float) -> Any:
    """v / (|v| + scale): monotone, 0 at 0 and ±½ at ±scale, into (−1, 1)."""
    return value / (abs(value) + scale)


def measurement_shown(scan: Scan, i: int) -> list[float]:
    """`MEASURED_FIELDS` of a measurement, scaled into [−1, 1]."""
    (x, y), size = scan.points[i].tolist(), float(scan.sizes[i])
    (xx, xy), (_, yy) = scan.covariances[i].tolist()
    sx, sy = math.sqrt(max(xx, 0.0)), math.sqrt(max(yy, 0.0))
    correlation = min(max(xy / (sx * sy), -1.0), 1.0) if sx * sy > 0.0 else 0.0
    place: list[float] = [squash(x, POSITION_SCALE), squash(y, POSITION_SCALE), squash(sx, SIGMA_SCALE)]
    return [*place, correlation, squash(sy, SIGMA_SCALE), 0.0 if math.isnan(size) else squash(size, SIZE_SCALE)]
