"""What the map expects to measure: all that an associator is told of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from slam_gym.types._arguments import Array, BoolArray, IntArray, floats, kinds_of, points_of, sizes_of
from slam_gym.types._records import quick

View = Callable[[Array, Array], Array]
"""From positions (k, 2) [m] in R and covariances (k, 2, 2) to the probability (k,) that the sensor has each in view."""


@quick
@dataclass(frozen=True, slots=True)
class Experience:
    """What an associator has learned of the scans of a run: it says so in its `Hypothesis`, and the next `Prediction`
    reminds it. Associators stay functions, and what they learn goes with the run. Counts fade from scan to scan."""

    unpaired: float  # measurements of what is not in the map
    area: float  # [m²] that the scans showed
    detections: Array  # (d,) log weights of the values that P_D may have


class Expectation(Protocol):
    """A prediction, or what one is put together from once somebody asks for it."""

    @property
    def positions(self) -> Array: ...

    @property
    def covariances(self) -> Array: ...

    @property
    def sizes(self) -> Array: ...

    @property
    def prediction(self) -> Prediction: ...


@quick
@dataclass(frozen=True, slots=True)
class Prediction:
    """What the stochastic map expects to measure from the predicted pose: the features in reach, one a row.

    With the measurement function h_j(x) = (⊖R) ⊕ F_j and its Jacobian H_j, `covariances[j]` is H_j P H_jᵀ, without the
    sensor's own noise. What would cost more than everything else together is computed only when asked for, and only
    for the rows asked for; it is looked up in the map, and so valid until that next changes.
    """

    features: IntArray  # (k,) index of each feature in the map
    positions: Array  # (k, 2) [m] h_j(x) in R
    covariances: Array  # (k, 2, 2) [m²] H_j P H_jᵀ
    sizes: Array  # (k,) [m] mapped intrinsic attribute, NaN where unknown
    size_variances: Array  # (k,) [m²]
    kinds: IntArray  # (k,) class of each feature, UNKNOWN_KIND where it has none
    ages: IntArray  # (k,) [steps] since each feature was first seen
    near: BoolArray  # (k,) paired in a recent scan, or local to a feature that was; all, without localities
    heading_variance: float  # [rad²] of the robot's heading θ
    heading_covariances: Array  # (k, 2) [m·rad] Cov(h_j, θ) = H_j P e_θ
    confidence: float  # of the χ² gates
    joint: Callable[[IntArray], Array]  # rows (j,) -> (2j, 2j) [m²] H P Hᵀ of those features together
    local: Callable[[IntArray], BoolArray] | None = None
    # rows (j,) -> (j, j) which are local to each other, symmetric, true on its diagonal; None: all are to all
    view: View | None = None
    view_moves: bool = True  # `view` holds for other positions, too; False where the predicted pose is poorly known
    experience: Experience | None = None  # of the associator, from its last hypothesis of this run that had any
    sightings: IntArray | None = None  # (k,) number of scans that updated or started each feature; None: nobody counts
    provisional: BoolArray | None = None  # (k,) seen too seldom for the map to believe in it; None: nobody tells

    def __len__(self) -> int:
        return len(self.features)

    @property
    def prediction(self) -> Prediction:
        """This one: see `Expectation`."""
        return self

    def __repr__(self) -> str:
        return f"Prediction of {len(self)} features at confidence {self.confidence}"

    def visibility(self, positions: Array | None = None, covariances: Array | None = None) -> Array | None:
        """(k,) probability that the sensor has each feature in view, walls considered; None where nobody can tell.

        With `positions` (k, 2) [m] in R and `covariances` (k, 2, 2) [m²], as if that were where the features are.
        """
        if self.view is None:
            return None
        return self.view(
            self.positions if positions is None else positions, self.covariances if covariances is None else covariances
        )

    def rows(self, kept: IntArray) -> Prediction:
        """Of the features in the rows `kept` (j,) alone."""
        local = None if self.local is None else _ChosenRows(self.local, kept)
        chosen = {name: getattr(self, name).take(kept, axis=0) for name in _BY_ROW}
        for name in _BY_ROW_IF_ANY:
            if getattr(self, name) is not None:
                chosen[name] = getattr(self, name)[kept]
        return replace(self, **chosen, joint=_ChosenRows(self.joint, kept), local=local)

    @classmethod
    def from_gaussian(
        cls,
        mean: ArrayLike,
        covariance: ArrayLike,
        *,
        confidence: float = 0.99,
        sizes: ArrayLike | None = None,
        size_sigma: ArrayLike | None = None,
        kinds: ArrayLike | None = None,
    ) -> Prediction:
        """Features 0 … k−1 of predicted positions `mean` (k, 2) [m] in R with their full covariance (2k, 2k) [m²].

        The robot's heading is taken for known: the prediction is linear. Other arguments and errors are those of
        `Scan.from_points`.
        """
        at = points_of("mean", mean)
        k = len(at)
        P = floats("covariance", covariance, (2 * k, 2 * k))
        blocks = P.reshape(k, 2, k, 2)[np.arange(k), :, np.arange(k), :]
        return cls(
            np.arange(k), at, np.ascontiguousarray(blocks), *sizes_of(sizes, size_sigma, k), kinds_of(kinds, k),
            ages=np.zeros(k, np.int64), near=np.ones(k, np.bool_), heading_variance=0.0,
            heading_covariances=np.zeros((k, 2)), confidence=confidence, joint=DenseCovariance(P),
        )  # fmt: skip


_BY_ROW = (
    "features",
    "positions",
    "covariances",
    "sizes",
    "size_variances",
    "kinds",
    "ages",
    "near",
    "heading_covariances",
)  # fields of a prediction with a row for each feature
_BY_ROW_IF_ANY = ("sightings", "provisional")  # … where they are there


@dataclass(frozen=True, slots=True)
class _ChosenRows:
    """What is asked by rows, of some of them."""

    of_all: Callable[[IntArray], Any]
    kept: IntArray  # (j,)

    def __call__(self, rows: IntArray) -> Any:
        return self.of_all(self.kept[rows])


@dataclass(frozen=True, slots=True)
class DenseCovariance:
    """`Prediction.joint` of a covariance that is given in full."""

    covariance: Array  # (2k, 2k) [m²]

    def __call__(self, rows: IntArray) -> Array:
        both = np.stack([2 * rows, 2 * rows + 1], axis=1).ravel()
        return np.ascontiguousarray(self.covariance[np.ix_(both, both)])
