"""What the stochastic map expects of a scan: arrays only, and compiled functions that compute more from them.

With the measurement function h_j(x) = (⊖R) ⊕ F_j and its Jacobian H_j, feature j is predicted at h_j(x) with covariance
H_j P H_jᵀ, without the sensor noise. Expensive quantities are computed only for the features that a search asks for:
the joint covariance H P Hᵀ of several features, which of them are local to each other, and the probability that they
are in view.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from slam_gym._jit import compiled
from slam_gym.mapping.covisibility import Counts, CovisibilityGraph, among
from slam_gym.mapping.linear_algebra import padded
from slam_gym.mapping.measurement import foresee, joint_covariance, rows_for
from slam_gym.mapping.stochastic_map import Estimate, StochasticMap
from slam_gym.navigation.visibility import SightArrays, ViewsFrom, probabilities_in_view
from slam_gym.types import Array, BoolArray, Experience, Hypothesis, IntArray, Odometry, Scan
from slam_gym.types._fields import floats, kinds_of, locked, sizes_of

PredictionArrays = tuple[Any, ...]
"""The fields of `Expected` as compiled functions take them: plain tuples pass from Python faster than named ones."""

_NO_SENSOR: SightArrays = ((0.0, 0.0, 0.0, 0.0), (np.empty((0, 0), np.uint8), np.zeros(2), 1.0))
_NOTHING = np.empty(0)
_ALL_LOCAL, _NO_FEATURES = np.empty((0, 0), np.int32), np.empty(0, np.int64)
_STILL, _CERTAIN, _NOT_MEASURED = np.empty(0), np.zeros((3, 3)), (np.empty((0, 2)), np.empty((0, 2, 2)))


class Expected(NamedTuple):
    """A prediction: the k features in reach, and the arrays for further queries."""

    features: IntArray  # (k,) as in `Prediction`, up to `across`
    kinds: IntArray
    ages: IntArray
    sightings: IntArray
    sizes: Array
    size_variances: Array
    facing: Array
    near: BoolArray
    positions: Array
    covariances: Array
    across: Array  # (k, 2) H_j P e_θ
    pose: Array  # (4,) predicted pose and variance of its heading
    state: Array  # x of the map
    covariance: Array  # P of the map (upper triangle)
    counts: Counts  # of its covisibility graph, empty where all features are local to each other
    sight: SightArrays  # field of view and explored space
    visible: Array  # (k,) a fixed visibility, or (0,)
    n: int  # number of features of the map
    second_order: bool  # whether joint covariances are of second order
    view_moves: bool  # whether visibility may be computed for other poses than the predicted one


@compiled
def joint(expected: Expected, rows: IntArray) -> Array:
    """Joint covariance H P Hᵀ (2j, 2j) [m²] of the features at `rows` (j,), with all cross-covariances."""
    return joint_covariance(expected.state, expected.covariance, expected.features[rows], expected.second_order)


@compiled
def in_view_and_facing(expected: Expected, positions: Array, covariances: Array) -> Array:
    """Probability (k,) that the features, at `positions` (k, 2) [m] in R, are in view and face the robot.

    It is a fixed visibility where there is one, and (0,) where it is unknown.
    """
    if len(expected.visible) > 0 or expected.sight[0][2] <= 0.0:
        return expected.visible
    return expected.facing * probabilities_in_view(positions, covariances, expected.sight, expected.pose[:3])


@dataclass(frozen=True, slots=True)
class Prediction:
    """What the stochastic map expects to measure from the predicted pose: the k features in reach, one per row.

    Its arrays are read-only. `joint`, `local` and `visibility` read the map: they, and associators, may use a
    prediction until the map next changes.
    """

    expected: Expected  # do not write to its arrays
    confidence: float  # of the χ² gates
    confirmations: int = 0  # number of sightings that confirm a feature
    experience: Experience | None = None  # of the associator, from its last hypothesis of this run that had one
    estimate: Estimate = field(default_factory=Estimate)  # the estimate of the map at the time of prediction

    @property
    def arrays(self) -> PredictionArrays:
        """The arrays for compiled functions; do not write to them. Raises RuntimeError once the map has changed."""
        self.check()
        return self.expected[:]

    @property
    def counted(self) -> tuple[IntArray, IntArray]:
        """`features` and `sightings`; do not write to them."""
        return self.expected.features, self.expected.sightings

    @property
    def features(self) -> IntArray:
        """(k,) index of each feature in the map."""
        return locked(self.expected.features)

    @property
    def kinds(self) -> IntArray:
        """(k,) class of each feature, UNKNOWN_KIND where unknown."""
        return locked(self.expected.kinds)

    @property
    def ages(self) -> IntArray:
        """(k,) [steps] since each feature was first seen."""
        return locked(self.expected.ages)

    @property
    def sightings(self) -> IntArray:
        """(k,) number of scans that updated or started each feature; 0 where the map does not count."""
        return locked(self.expected.sightings)

    @property
    def sizes(self) -> Array:
        """(k,) [m] mapped intrinsic attribute, NaN where unknown."""
        return locked(self.expected.sizes)

    @property
    def size_variances(self) -> Array:
        """(k,) [m²] variance of each size."""
        return locked(self.expected.size_variances)

    @property
    def facing(self) -> Array:
        """(k,) probability that each feature, if in view, is visible from the direction in which the robot is, given
        the directions from which it was seen (see `mapping.measurement`)."""
        return locked(self.expected.facing)

    @property
    def near(self) -> BoolArray:
        """(k,) paired in a recent scan, or local to a feature that was; all true without localities."""
        return locked(self.expected.near)

    @property
    def positions(self) -> Array:
        """(k, 2) [m] h_j(x) in R."""
        return locked(self.expected.positions)

    @property
    def covariances(self) -> Array:
        """(k, 2, 2) [m²] H_j P H_jᵀ."""
        return locked(self.expected.covariances)

    @property
    def heading_covariances(self) -> Array:
        """(k, 2) [m·rad] Cov(h_j, θ) = H_j P e_θ."""
        return locked(self.expected.across)

    @property
    def heading_variance(self) -> float:
        """[rad²] of the robot's heading θ."""
        return self.expected.pose.item(3)

    @property
    def provisional(self) -> BoolArray:
        """(k,) whether each feature has fewer sightings than confirm it."""
        return locked(self.sightings < self.confirmations)

    @property
    def has_localities(self) -> bool:
        """Whether a covisibility graph defines which features are local to each other; otherwise all are."""
        return len(self.expected.counts) > 0

    @property
    def has_view(self) -> bool:
        """Whether the probability that features are in view is known."""
        return bool(self.expected.sight[0][2] > 0.0 or len(self.expected.visible))

    def __len__(self) -> int:
        return len(self.expected.features)

    def __repr__(self) -> str:
        return f"Prediction of {len(self)} features at confidence {self.confidence}"

    def check(self) -> None:
        """Raise RuntimeError if the map has changed since this prediction was made."""
        if not self.estimate.stands:
            raise RuntimeError("the map has changed since this prediction was made")

    def joint(self, rows: IntArray) -> Array:
        """H P Hᵀ (2j, 2j) [m²] of the features at `rows` (j,). Raises RuntimeError once the map has changed."""
        self.check()
        known = self.expected
        return joint_covariance(known.state, known.covariance, known.features[rows], known.second_order)

    def local(self, rows: IntArray) -> BoolArray:
        """(j, j) which of the features at `rows` (j,) are local to each other; symmetric, true on its diagonal.

        Raises RuntimeError once the map has changed.
        """
        self.check()
        if not self.has_localities:
            return np.ones((len(rows), len(rows)), np.bool_)
        return among(self.expected.counts, self.expected.features[rows])

    def visibility(self, rows: IntArray | None = None) -> Array | None:
        """Probability (j,) that the features at `rows` (j,), by default all, are in view of the sensor, walls
        considered; None where unknown. Whether they face the robot is not considered (`facing`)."""
        known, chosen = self.expected, slice(None) if rows is None else rows
        if not self.has_view:
            return None
        if len(known.visible):
            return known.visible[chosen].copy()
        return probabilities_in_view(known.positions[chosen], known.covariances[chosen], known.sight, known.pose[:3])

    def with_visibility(self, visibility: ArrayLike | None) -> Prediction:
        """A copy with probabilities (k,) of being in view, for any pose, in place of `facing`, too; None: unknown.

        Raises ValueError for values that are not probabilities.
        """
        visible = _NOTHING if visibility is None else floats("visibility", visibility, (len(self),))
        if not ((visible >= 0.0) & (visible <= 1.0)).all():
            raise ValueError(f"visibility: expected probabilities, got {visible.tolist()}")
        return replace(self, expected=self.expected._replace(sight=_NO_SENSOR, visible=visible))

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
        """Prediction of features 0 … k−1 at `mean` (k, 2) [m] in R with their full covariance (2k, 2k) [m²].

        The robot's pose is assumed known, and the features are those of a map with that covariance. Other arguments and
        errors are those of `Scan.from_points`.
        """
        means = floats("mean", mean, (-1, 2))
        k = len(means)
        P = floats("covariance", covariance, (2 * k, 2 * k))
        side = padded(3 + 2 * k)
        x, padded_P = np.zeros(side), np.zeros((side, side))
        x[3 : 3 + 2 * k], padded_P[3 : 3 + 2 * k, 3 : 3 + 2 * k] = means.ravel(), P
        blocks = np.ascontiguousarray(P.reshape(k, 2, k, 2)[np.arange(k), :, np.arange(k), :])
        known = np.arange(k), kinds_of(kinds, k), np.zeros(k, np.int64), np.zeros(k, np.int64)
        near, across, pose = np.ones(k, np.bool_), np.zeros((k, 2)), np.zeros(4)
        rows = *known, *sizes_of(sizes, size_sigma, k), np.ones(k), near, means, blocks, across
        source = pose, x, padded_P, _ALL_LOCAL, _NO_SENSOR, _NOTHING
        return cls(Expected(*rows, *source, k, second_order=False, view_moves=False), confidence)


Associator = Callable[[Scan, Prediction], Hypothesis]
"""The interface of all associators: a function that decides which feature each measurement comes from."""


class StartRule(Enum):
    """The rule by which measurements of a scan start features. One rule applies to the whole scan."""

    FITS_NOTHING = "unpaired, and compatible with nothing that was expected"
    ASSOCIATOR = "the associator says that they are new"


@dataclass(frozen=True, slots=True)
class SlamStep:
    """What one SLAM step decided, in terms that remain valid after later steps.

    Its prediction refers to the covariance of the whole map, which a pickle or a copy of a step contains.
    A map feature has an index 0..n−1, which shifts when features are removed, and an id, which never changes and is
    never reused.
    """

    prediction: Prediction  # before the scan
    hypothesis: Hypothesis
    ids: IntArray  # (m,) id of the map feature that each measurement updated or started; NO_ID = discarded
    created: BoolArray  # (m,) the measurement started a feature, by `rule`
    removed: IntArray  # ids of the features that were removed from the map during the step
    returned: IntArray = field(default_factory=lambda: _NO_FEATURES)
    # ids of features that were removed when another map was started, and are back since the two maps were joined

    @property
    def rule(self) -> StartRule:
        """The rule by which measurements started features."""
        return StartRule.FITS_NOTHING if self.hypothesis.new is None else StartRule.ASSOCIATOR


def predict(
    m: StochasticMap,
    reach: float,
    *,
    odometry: Odometry | None = None,
    scan: Scan | None = None,
    graph: CovisibilityGraph | None = None,
    since: int = 1 << 62,
    accidental: tuple[float, float] = (0.0, math.inf),
    sight: ViewsFrom | None = None,
    view_moves: bool = True,
    experience: Experience | None = None,
) -> Prediction:
    """Move the robot by `odometry`, and predict what a scan should show: the features within `reach` [m] + 3σ.

    Arguments:
        scan: checked before the robot moves.
        graph: covisibility graph that defines the localities; None: all features are local to each other.
        since: step from which a scan is recent: features updated or started since then, and features local to them, are
            near. By default no scan is recent.
        accidental: χ² gate of a pairing; and the number of accidental matches expected in the gate of a feature that is
            not near above which it is left out.
        sight: computes what the sensor has in view from a pose.
        view_moves: whether a hypothesis may compute visibility from the pose that it implies; False where the pose is
            poorly known.
        experience: of the associator.

    Raises ValueError where the odometry is not finite or its covariance is not positive semi-definite, and as
    `check_scan`.
    """
    motion = (_STILL, _CERTAIN) if odometry is None else odometry.arrays
    measured = _NOT_MEASURED if scan is None else scan.arrays[:2]
    counts = _ALL_LOCAL if graph is None else graph.counts
    spec, rows, pose, rule = m.spec, rows_for(m.n), np.empty(4), (float(reach), m.spec.second_order, *accidental)
    k = foresee(m.arrays, (m.n, m.step), motion, measured, rule, (counts, since), pose, rows)
    if odometry is not None:
        m.moved()
    (counted, sized, near, positions, covariances, across), (x, P, _, _) = rows, m.arrays
    view = _NO_SENSOR if sight is None else sight.arrays
    expected = Expected(
        counted[0, :k], counted[1, :k], counted[2, :k], counted[3, :k], sized[0, :k], sized[1, :k], sized[2, :k],
        near[:k], positions[:k], covariances[:k], across[:k], pose, x, P, counts, view, _NOTHING, m.n,
        spec.second_order, view_moves,
    )  # fmt: skip
    return Prediction(expected, spec.confidence, spec.confirmations, experience, m.estimate)
