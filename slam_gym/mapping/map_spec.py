"""Settings of the stochastic map."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

Error = Literal["ordinary", "right-invariant"]


@dataclass(frozen=True)
class MapSpec:
    """Settings of the estimator."""

    confidence: float = 0.99  # of the χ² gates in data association: every prediction carries it
    iterations: int = 3  # of an update, at most: 1 linearises at the prior
    settled: float = 0.1  # [σ of the state] a pass that would move it by less than that is spared
    error: Error = "right-invariant"  # that the filter is linear in (see `mapping.update`)
    second_order: bool = True  # predictions allow for what a poorly known heading bends (see `mapping.measurement`)
    confirmations: int = 2  # sightings that confirm a feature; until then it is provisional
    unconfirmed_age: int | None = 2  # [steps] a provisional feature is dropped when older; None: never

    def __post_init__(self) -> None:
        if not 0.0 < self.confidence < 1.0:
            raise ValueError(f"MapSpec.confidence: {self.confidence} is not between 0 and 1")
        if self.iterations < 1:
            raise ValueError(f"MapSpec.iterations: {self.iterations} is less than 1")
        if not 0.0 <= self.settled < math.inf:
            raise ValueError(f"MapSpec.settled: {self.settled} is not finite or negative")
        if self.error not in ("ordinary", "right-invariant"):
            raise ValueError(f"MapSpec.error: {self.error!r} is neither 'ordinary' nor 'right-invariant'")
        if self.confirmations < 1:
            raise ValueError(f"MapSpec.confirmations: {self.confirmations} is less than 1")
        if self.unconfirmed_age is not None and self.unconfirmed_age < 0:
            raise ValueError(f"MapSpec.unconfirmed_age: {self.unconfirmed_age} is negative")

    @property
    def right_invariant(self) -> bool:
        """The error is the right-invariant one."""
        return self.error == "right-invariant"
