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
"""The source of a measurement that nobody has labelled (recordings only); the kind of what could not be classified."""


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
    kinds: IntArray | None = None  # (m,) class that the detector reports, UNKNOWN where it cannot tell; None: never

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
    """Which features of a map are local to which: L(j) for every feature j, in compressed rows.

    It is symmetric, and every feature is local to itself. Where all features are local to all, there is no `Locality`
    but None: n² of them would have to be written down.
    """

    starts: IntArray  # (n + 1,) L(j) is members[starts[j]:starts[j + 1]]
    members: IntArray  # (e,) ascending within each row

    def __len__(self) -> int:
        return len(self.starts) - 1

    def of(self, feature: int) -> IntArray:
        """L(feature), ascending."""
        return self.members[self.starts[feature] : self.starts[feature + 1]]


@dataclass(frozen=True, slots=True)
class Nearby:
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
    locality: Nearby | None = None
    ages: IntArray | None = None  # (k,) [steps] since each feature was first seen
    visibility: Array | None = None  # (k,) probability that the sensor has each in its view, walls considered
    kinds: IntArray | None = None  # (k,) class of each feature, UNKNOWN where it has none; None: no feature has one
    heading: Callable[[IntArray], tuple[float, Array]] | None = None
    # rows (j,) -> [rad²] variance of the robot's heading θ, and (j, 2) [m·rad] Cov(h_j, θ) = H_j P e_θ
    view: Callable[[Array, Array], Array] | None = None
    # positions (k, 2) and covariances (k, 2, 2) -> (k,) `visibility`, if that were where the features are

    def __len__(self) -> int:
        return len(self.features)


@dataclass(frozen=True, slots=True)
class Landmarks:
    """The features of a map, for searches without a prior on the robot's pose. In B.

    Cross-covariances come in one of three ways: all of them (`covariance`), those of some pairs (`block_…`, as large
    maps keep them), or none. Features without one are taken for independent.
    """

    positions: Array  # (n, 2) [m]
    covariances: Array  # (n, 2, 2) [m²] marginals
    sizes: Array  # (n,) [m] mapped intrinsic attribute, NaN where unknown
    size_variances: Array  # (n,) [m²]
    kinds: IntArray  # (n,) class, UNKNOWN where there is none
    covariance: Array  # (2n, 2n) [m²] of all features together, or (0, 0)
    block_starts: IntArray  # (n + 1,) the pairs (j, l) of j are entries block_starts[j]:block_starts[j + 1]; or (0,)
    block_columns: IntArray  # (e,) l, ascending for each j; both (j, l) and (l, j) are there
    blocks: Array  # (e, 2, 2) [m²] P_jl

    def __len__(self) -> int:
        return len(self.positions)


@dataclass(frozen=True, slots=True)
class Effort:
    """What a search spent."""

    nodes: int = 0  # hypotheses visited in the interpretation tree
    individual_tests: int = 0  # pairings tested for individual compatibility
    joint_tests: int = 0  # joint compatibility tests
    limit_hit: bool = False  # the node limit ended the search: the hypothesis may not be the best
    unary_tests: int = 0  # pairings tested by what the features are, wherever they are
    binary_tests: int = 0  # pairs of pairings tested by their relation
    leaves: int = 0  # hypotheses complete enough to be located
    tries: int = 0  # random samples drawn
    seconds: float = 0.0  # wall time, where the search takes it
    orientation_tests: int = 0  # triples of pairings tested for their sense


@dataclass(frozen=True, slots=True)
class Posterior:
    """How probable a hypothesis is, among those that the search came across."""

    log_density: float  # unnormalised, of the hypothesis
    probability: float  # of the hypothesis
    runner_up: IntArray  # (m,) map features of the next most probable one
    runner_up_probability: float


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A path of the interpretation tree: one decision per measurement."""

    features: IntArray  # (m,) map feature paired with each measurement, NONE for `*`
    joint_distance: float  # D²_H of all its pairings together
    dof: int  # degrees of freedom of that distance: 2 per pairing
    effort: Effort
    posterior: Posterior | None = None


@dataclass(frozen=True, slots=True)
class Relocation:
    """The answer of a search without a prior: a hypothesis and the pose that it puts the robot at."""

    features: IntArray  # (m,) map feature paired with each measurement, NONE for `*`
    pose: Array  # (3,) [m, m, rad] of the robot in B; NaN with fewer than two pairings
    covariance: Array  # (3, 3) [m², m·rad, rad²] of that pose; NaN likewise
    joint_distance: float  # D²_H at that pose
    dof: int  # 2k − 3 for k pairings, since the pose was fitted from them
    min_pairings: int  # what the rule asks for, given scan and map
    ambiguous: bool  # another pose explains as many measurements, or nearly: the scan does not decide
    ties: int  # hypotheses at other poses with as many pairings
    effort: Effort

    @property
    def pairings(self) -> int:
        """Number of measurements that are paired."""
        return int((self.features != NONE).sum())

    @property
    def accepted(self) -> bool:
        """Enough pairings, at one pose only."""
        return self.pairings >= self.min_pairings and not self.ambiguous


Associator = Callable[[Scan, Prediction], Hypothesis]
"""The narrow waist: whatever decides where measurements come from."""

Relocator = Callable[[Scan, Landmarks, Locality | None], Relocation]
"""Whatever finds the robot in a map without a prior. Locality None: all features are local to all."""


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
