"""The data that flows through slam_gym: frozen, with shape, unit and frame beside every field.

Frames: **W** world (truth side only), **B** base of the map (the robot's first pose), **R** robot (x forward, y left).
A pose is an array (3,) `[x m, y m, θ rad]`, its heading wrapped to (−π, π].
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from slam_gym._arguments import UNKNOWN_KIND as UNKNOWN_KIND
from slam_gym._arguments import Array as Array
from slam_gym._arguments import BoolArray as BoolArray
from slam_gym._arguments import IntArray as IntArray
from slam_gym._arguments import covariances_of, floats, kinds_of, points_of, sizes_of

_LEFT_OUT: IntArray = np.empty(0, np.int64)

UNPAIRED = -1
"""What a hypothesis decides for a measurement that it pairs with nothing: the branch `*` of the interpretation tree."""

SPURIOUS = -1
"""The source of a measurement that comes from no feature."""

UNLABELLED = -2
"""The source of a measurement that nobody has labelled (recordings only)."""

NO_ID = -1
"""In `SlamStep.ids`: the measurement was discarded."""


@dataclass(frozen=True, slots=True)
class Odometry:
    """The motion of one tick, as the wheels report it."""

    motion: Array  # (3,) [m, m, rad] pose at the end of the tick in the robot frame at its start
    covariance: Array  # (3, 3) [m², m·rad, rad²] of `motion`

    @classmethod
    def from_motion(cls, motion: ArrayLike, sigmas: ArrayLike) -> Odometry:
        """From a motion (3,) [m, m, rad] and its independent standard deviations (3,), or one number for all three.

        Raises ValueError naming the argument whose shape does not fit.
        """
        moved, sigma = floats("motion", motion, (3,)), np.asarray(sigmas, np.float64)
        if sigma.shape not in ((), (3,)):
            raise ValueError(f"sigmas: shape {sigma.shape}, expected (3,) or one number")
        return cls(moved, np.diag(np.broadcast_to(sigma, (3,)) ** 2))


@dataclass(frozen=True, slots=True)
class Scan:
    """Point features seen at one instant. Cartesian in R; angles are the sensor's business only."""

    points: Array  # (m, 2) [m] in R
    covariances: Array  # (m, 2, 2) [m²] in R
    sizes: Array  # (m,) [m] measured intrinsic attribute, NaN where unknown
    size_variances: Array  # (m,) [m²], NaN where unknown
    # (m,) class that the detector reports, UNKNOWN_KIND where it cannot tell; left out: it never can
    kinds: IntArray = field(default_factory=lambda: _LEFT_OUT)

    def __post_init__(self) -> None:
        if self.kinds is _LEFT_OUT:
            object.__setattr__(self, "kinds", np.full(len(self.points), UNKNOWN_KIND))

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        return f"Scan of {len(self)} measurements"

    @classmethod
    def from_points(
        cls,
        points: ArrayLike,
        covariances: ArrayLike | None = None,
        *,
        sigma: ArrayLike | None = None,
        sizes: ArrayLike | None = None,
        size_sigma: ArrayLike | None = None,
        kinds: ArrayLike | None = None,
    ) -> Scan:
        """From points (m, 2) [m] in R and either covariances or `sigma`.

        Arguments:
            covariances: (m, 2, 2) [m²], or (2, 2) for all measurements.
            sigma: [m] standard deviation in both directions, one number or (m,).
            sizes: (m,) [m] intrinsic attribute, NaN where unknown; with `size_sigma` [m], one number or (m,).
            kinds: (m,) class of each, UNKNOWN_KIND where it has none.

        Raises ValueError naming the argument whose shape does not fit, or where not exactly one of covariances and
        sigma is given.
        """
        at = points_of("points", points)
        marginals = covariances_of("covariances", covariances, sigma, len(at))
        return cls(at, marginals, *sizes_of(sizes, size_sigma, len(at)), kinds_of(kinds, len(at)))

    @classmethod
    def from_polar(
        cls,
        ranges: ArrayLike,
        bearings: ArrayLike,
        range_sigma: ArrayLike,
        bearing_sigma: ArrayLike,
        *,
        sizes: ArrayLike | None = None,
        size_sigma: ArrayLike | None = None,
        kinds: ArrayLike | None = None,
    ) -> Scan:
        """From ranges (m,) [m] and bearings (m,) [rad, 0 ahead, left positive] with independent standard deviations.

        With c, s = cos β, sin β a measurement lies at r (c, s), and its covariance is σ_r² along the line of sight and
        (r σ_β)² across it. Other arguments and errors are those of `from_points`.
        """
        r = floats("ranges", ranges, (-1,))
        beta = floats("bearings", bearings, (len(r),))
        c, s = np.cos(beta), np.sin(beta)
        along = np.broadcast_to(np.asarray(range_sigma, np.float64), r.shape) ** 2
        across = (r * np.broadcast_to(np.asarray(bearing_sigma, np.float64), r.shape)) ** 2
        covariances = np.empty((len(r), 2, 2))
        covariances[:, 0, 0] = c * c * along + s * s * across
        covariances[:, 1, 1] = s * s * along + c * c * across
        covariances[:, 0, 1] = covariances[:, 1, 0] = c * s * (along - across)
        points = np.column_stack([r * c, r * s])
        return cls.from_points(points, covariances, sizes=sizes, size_sigma=size_sigma, kinds=kinds)


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
    sources: IntArray  # (m,) true feature behind each measurement, SPURIOUS or UNLABELLED

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


View = Callable[[Array, Array], Array]
"""From positions (k, 2) [m] in R and covariances (k, 2, 2) to the probability (k,) that the sensor has each in view."""


@dataclass(frozen=True, slots=True)
class Experience:
    """What an associator has learned of the scans of a run: it says so in its `Hypothesis`, and the next `Prediction`
    reminds it. Associators stay functions, and what they learn goes with the run. Counts fade from scan to scan."""

    unpaired: float  # measurements of what is not in the map
    area: float  # [m²] that the scans showed
    detections: Array  # (d,) log weights of the values that P_D may have


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
    kinds: IntArray  # (n,) class, UNKNOWN_KIND where there is none
    covariance: Array  # (2n, 2n) [m²] of all features together, or (0, 0)
    block_starts: IntArray  # (n + 1,) the pairs (j, l) of j are entries block_starts[j]:block_starts[j + 1]; or (0,)
    block_columns: IntArray  # (e,) l, ascending for each j; both (j, l) and (l, j) are there
    blocks: Array  # (e, 2, 2) [m²] P_jl

    def __len__(self) -> int:
        return len(self.positions)

    def __repr__(self) -> str:
        return f"Landmarks: {len(self)} features"

    @classmethod
    def from_points(
        cls,
        points: ArrayLike,
        covariances: ArrayLike | None = None,
        *,
        sigma: ArrayLike | None = None,
        covariance: ArrayLike | None = None,
        sizes: ArrayLike | None = None,
        size_sigma: ArrayLike | None = None,
        kinds: ArrayLike | None = None,
    ) -> Landmarks:
        """From positions (n, 2) [m] in B with exactly one of three: marginal `covariances`, `sigma`, or `covariance`.

        `covariance` (2n, 2n) [m²] is that of all features together; the other two say that they are independent.
        Arguments and errors are those of `Scan.from_points`.
        """
        at = points_of("points", points)
        n, whole = len(at), np.empty((0, 0))
        if covariance is None:
            marginals = covariances_of("covariances", covariances, sigma, n)
        elif covariances is not None or sigma is not None:
            raise ValueError("covariance: given beside covariances or sigma; expected exactly one of the three")
        else:
            whole = floats("covariance", covariance, (2 * n, 2 * n))
            marginals = np.ascontiguousarray(whole.reshape(n, 2, n, 2)[np.arange(n), :, np.arange(n), :])
        none = np.empty(0, np.int64)
        return cls(
            at, marginals, *sizes_of(sizes, size_sigma, n), kinds_of(kinds, n), whole, none, none.copy(),
            np.empty((0, 2, 2)),
        )  # fmt: skip


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
    runner_up: IntArray  # (m,) map features of the next most probable one, UNPAIRED for `*`
    runner_up_probability: float
    marginals: Array | None = None  # (m,) probability of each decision by itself, over all hypotheses; None: not asked
    unpaired: Array | None = None  # (m,) probability that each measurement is of nothing in the map; None: likewise


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A path of the interpretation tree: one decision per measurement."""

    features: IntArray  # (m,) map feature paired with each measurement, UNPAIRED for `*`
    joint_distance: float  # D²_H of all its pairings together
    dof: int  # degrees of freedom of that distance: 2 per pairing
    effort: Effort
    posterior: Posterior | None = None
    new: BoolArray | None = None  # (m,) which measurements start a feature; None: by the rule of `Slam`
    exclusive: bool = True  # no feature is paired twice; False: decided one by one, as nearest neighbour does
    experience: Experience | None = None  # for the next prediction

    @property
    def pairings(self) -> int:
        """Number of measurements that are paired."""
        return int((self.features != UNPAIRED).sum())

    def __repr__(self) -> str:
        return f"Hypothesis of {self.pairings} pairings among {len(self.features)} measurements: {self.features}"


@dataclass(frozen=True, slots=True)
class Relocation:
    """The answer of a search without a prior: a hypothesis and the pose that it puts the robot at."""

    features: IntArray  # (m,) map feature paired with each measurement, UNPAIRED for `*`
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
        return int((self.features != UNPAIRED).sum())

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
    ids: IntArray  # (m,) id of the map feature that each measurement updated or created; NO_ID = discarded
    created: BoolArray  # (m,) the measurement started a feature
    removed: IntArray  # ids of the features that the map has no longer at the end of the step
    returned: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    # ids of features that were removed before, as another map was begun, and are back, as it was joined
