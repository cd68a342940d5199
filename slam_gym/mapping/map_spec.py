"""Settings of the stochastic map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True)
class MapSpec:
    """Settings of the estimator."""

    confidence: float = 0.99  # of the χ² gates in data association: every prediction carries it
    iterations: int = 3  # of an update, at most: 1 linearises at the prior
    right_invariant: bool = True  # the error that the filter is linear in (see `mapping.update`); False: x itself
    second_order: bool = True  # predictions allow for what a poorly known heading bends (see `mapping.measurement`)
    confirmations: int = 2  # sightings that confirm a feature; until then it is provisional
    unconfirmed_age: int | None = 2  # [steps] a provisional feature is dropped when older; None: never
    settled: ClassVar[float] = 0.1  # [σ of the state] a pass that would move it by less than that is spared

    def __post_init__(self) -> None:
        if not 0.0 < self.confidence < 1.0:
            raise ValueError(f"MapSpec.confidence: {self.confidence} is not between 0 and 1")
        if self.iterations < 1:
            raise ValueError(f"MapSpec.iterations: {self.iterations} is less than 1")
        if self.confirmations < 1:
            raise ValueError(f"MapSpec.confirmations: {self.confirmations} is less than 1")
        if self.unconfirmed_age is not None and self.unconfirmed_age < 0:
            raise ValueError(f"MapSpec.unconfirmed_age: {self.unconfirmed_age} is negative")
