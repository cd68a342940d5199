"""The data that flows through slam_gym: frozen, with shape, unit and frame beside every field.

Frames: **W** world (truth side only), **B** base of the map (the robot's first pose), **R** robot (x forward, y left).
A pose is an array (3,) `[x m, y m, θ rad]`, its heading wrapped to (−π, π].
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

NONE = -1
"""The branch `*` of the interpretation tree: paired with nothing; as the source of a measurement: spurious."""

UNKNOWN = -2
"""The source of a measurement that nobody has labelled (recordings only)."""


@dataclass(frozen=True, slots=True)
class Odometry:
    """The motion of one tick, as the wheels report it."""

    motion: Array  # (3,) [m, m, rad] pose at the end of the tick in the robot frame at its start
    covariance: Array  # (3, 3) [m², m·rad, rad²] of `motion`


@dataclass(frozen=True, slots=True)
class Scan:
    """Point features seen at one instant. Cartesian in R; angles are the sensor's business only."""

    points: Array  # (m, 2) [m] in R
    covariances: Array  # (m, 2, 2) [m²] in R
    sizes: Array  # (m,) [m] measured intrinsic attribute, NaN where unknown
    size_variances: Array  # (m,) [m²], NaN where unknown

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True, slots=True)
class Beams:
    """One sweep of the range finder: the only source of free space and walls."""

    bearings: Array  # (b,) [rad] in R
    ranges: Array  # (b,) [m]; `max_range` where nothing was hit
    max_range: float  # [m]


@dataclass(frozen=True, slots=True)
class Truth:
    """What only the simulator (or a label file) knows about a scan."""

    pose: Array  # (3,) [m, m, rad] of the robot in W
    sources: IntArray  # (m,) true feature behind each measurement; NONE = spurious, UNKNOWN = unlabelled

    def __len__(self) -> int:
        return len(self.sources)


@dataclass(frozen=True, slots=True)
class Locality:
    """Which of the predicted features are worth looking at, for a search that starts from what was just seen.

    Rows are rows of the `Prediction` that carries it.
    """

    near: BoolArray  # (k,) the feature was paired in a recent scan or is local to one that was
    among: Callable[[IntArray], BoolArray]  # rows (j,) -> (j, j) "local to each other", symmetric, true on its diagonal


@dataclass(frozen=True, slots=True)
class Prediction:
    """What the stochastic map expects to measure from the predicted pose: the features in reach.

    With the measurement function h_j(x) = (⊖R) ⊕ F_j and its Jacobian H_j, `covariances[j]` is H_j P H_jᵀ, without the
    sensor's own noise. `joint` computes full cross-covariances only for the rows asked for, since those of all
    features would cost more than everything else together.
    """

    features: IntArray  # (k,) index of each feature in the map
    positions: Array  # (k, 2) [m] h_j(x) in R
    covariances: Array  # (k, 2, 2) [m²] H_j P H_jᵀ
    sizes: Array  # (k,) [m] mapped intrinsic attribute, NaN where unknown
    size_variances: Array  # (k,) [m²]
    joint: Callable[[IntArray], Array]  # rows (j,) -> (2j, 2j) [m²] H P Hᵀ of those features together
    locality: Locality | None = None

    def __len__(self) -> int:
        return len(self.features)


@dataclass(frozen=True, slots=True)
class Effort:
    """What a search spent."""

    nodes: int = 0  # hypotheses visited in the interpretation tree
    individual_tests: int = 0  # pairings tested for individual compatibility
    joint_tests: int = 0  # joint compatibility tests
    limit_hit: bool = False  # the node limit ended the search: the hypothesis may not be the best


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A path of the interpretation tree: one decision per measurement."""

    features: IntArray  # (m,) map feature paired with each measurement, NONE for `*`
    joint_distance: float  # D²_H of all its pairings together
    dof: int  # degrees of freedom of that distance: 2 per pairing
    effort: Effort


Associator = Callable[[Scan, Prediction], Hypothesis]
"""The narrow waist: whatever decides where measurements come from."""


@dataclass(frozen=True, slots=True)
class SlamStep:
    """What one SLAM step decided, in terms that outlive it.

    A map feature is addressed by its index 0..n−1, which shifts when features are removed, and known by its id, which
    never changes and is never given twice.
    """

    prediction: Prediction
    hypothesis: Hypothesis
    ids: IntArray  # (m,) id of the map feature that each measurement updated or created; NONE = discarded
    created: BoolArray  # (m,) the measurement started a feature
    removed: IntArray  # ids of the features dropped by maintenance at the end of the step
