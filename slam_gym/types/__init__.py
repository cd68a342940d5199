"""The data that flows through slam_gym: frozen, with shape, unit and frame beside every field.

Frames: **W** world (truth side only), **B** base of the map (the robot's first pose), **R** robot (x forward, y left).
A pose is an array (3,) `[x m, y m, θ rad]`, its heading wrapped to (−π, π]. A constructor raises ValueError where an
array does not have the type and shape that compiled functions read.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from slam_gym.types._fields import (
    FLOAT,
    INTEGER,
    check_array,
    compact,
    covariances_of,
    deviations,
    floats,
    in_radians,
    kinds_of,
    locked,
    sizes_of,
)
from slam_gym.types._fields import UNKNOWN_KIND as UNKNOWN_KIND  # `as`: also for modules that import from here
from slam_gym.types._fields import Array as Array
from slam_gym.types._fields import BoolArray as BoolArray
from slam_gym.types._fields import IntArray as IntArray

SPURIOUS = -1
"""The source of a measurement that comes from no true feature."""

UNLABELLED = -2
"""The source of a measurement without a label (recordings only)."""

LARGEST = 1e9
"""[m] The greatest coordinate, motion or standard deviation: squares of larger ones may overflow later."""

_EXACT = 1e-12  # [m²] variance of an exact measurement

ScanArrays = tuple[Array, Array, Array, Array, IntArray]
"""Points, covariances, sizes, size variances and kinds of a scan, as compiled functions take them."""


@dataclass(frozen=True, slots=True)
class Odometry:
    """The motion of one tick, as measured by the wheels."""

    motion: Array  # (3,) [m, m, rad] pose at the end of the tick in the robot frame at its start
    covariance: Array  # (3, 3) [m², m·rad, rad²] of `motion`

    def __post_init__(self) -> None:
        check_array("Odometry.motion", self.motion, FLOAT, (3,))
        check_array("Odometry.covariance", self.covariance, FLOAT, (3, 3))

    @property
    def arrays(self) -> tuple[Array, Array]:
        """Motion and covariance in the layout for which loops are compiled, as `Scan.arrays`."""
        motion, covariance = self.motion, self.covariance
        fit = motion.flags.carray and covariance.flags.carray
        return (motion, covariance) if fit else (compact(motion), compact(covariance))

    @classmethod
    def from_motion(cls, motion: ArrayLike, sigmas: ArrayLike) -> Odometry:
        """Odometry of a motion (3,) [m, m, rad] with independent standard deviations (3,), or one number for all three.

        Raises ValueError naming the argument: for a shape that does not fit, a negative deviation, or an angle in
        degrees.
        """
        pose = floats("motion", motion, (3,))
        in_radians("motion[2]", pose[2:])
        return cls(pose, np.diag(deviations("sigmas", sigmas, (3,)) ** 2))


@dataclass(frozen=True, slots=True)
class Scan:
    """Point features measured at one instant, in Cartesian coordinates of R. Angles occur in the sensor only."""

    points: Array  # (m, 2) [m] in R
    covariances: Array  # (m, 2, 2) [m²] in R
    sizes: Array  # (m,) [m] measured intrinsic attribute, NaN where unknown
    size_variances: Array  # (m,) [m²], NaN where unknown
    kinds: IntArray = None  # type: ignore[assignment]  # (m,) class by the detector, UNKNOWN_KIND where it has none

    def __post_init__(self) -> None:
        m = len(self.points)
        if self.kinds is None:
            object.__setattr__(self, "kinds", np.full(m, UNKNOWN_KIND))
        check_array("Scan.points", self.points, FLOAT, (m, 2))
        check_array("Scan.covariances", self.covariances, FLOAT, (m, 2, 2))
        check_array("Scan.sizes", self.sizes, FLOAT, (m,))
        check_array("Scan.size_variances", self.size_variances, FLOAT, (m,))
        check_array("Scan.kinds", self.kinds, INTEGER, (m,))

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        return f"Scan of {len(self)} measurements"

    @property
    def arrays(self) -> ScanArrays:
        """The arrays in the layout for which loops are compiled: C-contiguous, and marked writeable. They write to none
        of them; other layouts would compile everything again."""
        arrays = self.points, self.covariances, self.sizes, self.size_variances, self.kinds
        fit = all(array.flags.carray for array in arrays)
        return arrays if fit else tuple(map(compact, arrays))  # type: ignore[return-value]

    def read_only(self) -> Scan:
        """The same measurements in arrays that cannot be written to."""
        return Scan(*map(locked, self.arrays))  # type: ignore[arg-type]

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
        """Scan of points (m, 2) [m] in R with either covariances or `sigma`.

        Arguments:
            covariances: (m, 2, 2) [m²], or (2, 2) for all measurements.
            sigma: [m] standard deviation in both directions, one number or (m,). For 0 a micrometre is taken: the
                innovations of several exact measurements would have a singular covariance.
            sizes: (m,) [m] intrinsic attribute, NaN where unknown; requires `size_sigma` [m], one number or (m,).
            kinds: (m,) class of each measurement, UNKNOWN_KIND where unknown.

        Raises ValueError naming the argument for a shape that does not fit or a negative value, and unless exactly one
        of covariances and sigma is given.
        """
        positions = floats("points", points, (-1, 2))
        marginals = covariances_of("covariances", covariances, sigma, len(positions))
        marginals[~marginals.any(axis=(1, 2))] = _EXACT * np.eye(2)
        return cls(positions, marginals, *sizes_of(sizes, size_sigma, len(positions)), kinds_of(kinds, len(positions)))

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
        """Scan of ranges (m,) [m] and bearings (m,) [rad, 0 ahead, left positive] with independent standard deviations.

        With c, s = cos β, sin β a measurement lies at r (c, s); its covariance is σ_r² along the line of sight and (r
        σ_β)² across it. Both are of first order in σ_β, with which maps are consistent up to about 0.05 rad. Other
        arguments and errors are those of `from_points`. Raises ValueError for bearings in degrees.
        """
        r = floats("ranges", ranges, (-1,))
        if (r < 0.0).any():
            raise ValueError(f"ranges: {r.min():g} m is negative")
        beta = in_radians("bearings", floats("bearings", bearings, (len(r),)))
        c, s = np.cos(beta), np.sin(beta)
        along = deviations("range_sigma", range_sigma, r.shape) ** 2
        across = (r * deviations("bearing_sigma", bearing_sigma, r.shape)) ** 2
        covariances = np.empty((len(r), 2, 2))
        covariances[:, 0, 0] = c * c * along + s * s * across
        covariances[:, 1, 1] = s * s * along + c * c * across
        covariances[:, 0, 1] = covariances[:, 1, 0] = c * s * (along - across)
        points = np.column_stack([r * c, r * s])
        return cls.from_points(points, covariances, sizes=sizes, size_sigma=size_sigma, kinds=kinds)


@dataclass(frozen=True, slots=True)
class Beams:
    """One sweep of the range finder: the only source of information on free space and walls."""

    bearings: Array  # (b,) [rad] in R
    ranges: Array  # (b,) [m], or (k, b) for k sweeps; `max_range` where nothing was hit
    max_range: float  # [m]

    def __post_init__(self) -> None:
        b = len(self.bearings)
        check_array("Beams.bearings", self.bearings, FLOAT, (b,))
        check_array("Beams.ranges", self.ranges, FLOAT, (*self.ranges.shape[:-1], b))


@dataclass(frozen=True, slots=True)
class Truth:
    """Ground truth of a scan, known to the simulator or a label file only."""

    pose: Array  # (3,) [m, m, rad] of the robot in W
    sources: IntArray  # (m,) true feature behind each measurement, SPURIOUS or UNLABELLED

    def __len__(self) -> int:
        return len(self.sources)


@dataclass(frozen=True, slots=True)
class Locality:
    """Which features of a map are local to which: L(j) for every feature j, in compressed rows.

    The relation is symmetric, and every feature is local to itself. Where all features are local to each other, use
    None instead: a `Locality` would have n² entries.
    """

    starts: IntArray  # (n + 1,) L(j) is members[starts[j]:starts[j + 1]]
    members: IntArray  # (e,) ascending within each row

    def __post_init__(self) -> None:
        check_array("Locality.starts", self.starts, INTEGER, (len(self.starts),))
        check_array("Locality.members", self.members, INTEGER, (len(self.members),))

    def __len__(self) -> int:
        return len(self.starts) - 1

    def of(self, feature: int) -> IntArray:
        """L(feature), ascending."""
        return self.members[self.starts[feature] : self.starts[feature + 1]]


@dataclass(frozen=True, slots=True)
class Landmarks:
    """The features of a map in B, for searches without a prior on the robot's pose.

    Cross-covariances are given in one of three ways: all of them (`covariance`), those of some pairs (`block_…`, as
    large maps store them), or none. Pairs without one are assumed independent.
    """

    positions: Array  # (n, 2) [m]
    covariances: Array  # (n, 2, 2) [m²] marginals
    sizes: Array  # (n,) [m] mapped intrinsic attribute, NaN where unknown
    size_variances: Array  # (n,) [m²]
    kinds: IntArray  # (n,) class, UNKNOWN_KIND where unknown
    covariance: Array  # (2n, 2n) [m²] of all features together, or (0, 0)
    block_starts: IntArray  # (n + 1,) the pairs (j, l) of j are entries block_starts[j]:block_starts[j + 1]; or (0,)
    block_columns: IntArray  # (e,) l, ascending for each j; both (j, l) and (l, j) are stored
    blocks: Array  # (e, 2, 2) [m²] P_jl

    def __len__(self) -> int:
        return len(self.positions)

    def __repr__(self) -> str:
        return f"Landmarks: {len(self)} features"

    def read_only(self) -> Landmarks:
        """The same features in arrays that cannot be written to."""
        return Landmarks(*(locked(getattr(self, field.name)) for field in fields(self)))

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
        """Landmarks at positions (n, 2) [m] in B, with exactly one of marginal `covariances`, `sigma` and `covariance`.

        `covariance` (2n, 2n) [m²] is the joint covariance of all features; with the other two, features are
        independent. The other arguments and the errors are those of `Scan.from_points`.
        """
        positions = floats("points", points, (-1, 2))
        n, joint = len(positions), np.empty((0, 0))
        if covariance is None:
            marginals = covariances_of("covariances", covariances, sigma, n)
        elif covariances is not None or sigma is not None:
            raise ValueError("covariance: given together with covariances or sigma; expected exactly one of the three")
        else:
            joint = floats("covariance", covariance, (2 * n, 2 * n))
            marginals = np.ascontiguousarray(joint.reshape(n, 2, n, 2)[np.arange(n), :, np.arange(n), :])
        empty = np.empty(0, np.int64)
        return cls(
            positions, marginals, *sizes_of(sizes, size_sigma, n), kinds_of(kinds, n), joint, empty, empty.copy(),
            np.empty((0, 2, 2)),
        )  # fmt: skip


UNPAIRED = -1
"""The decision for a measurement that is paired with no feature: the branch `*` of the interpretation tree."""

NO_ID = -1
"""In `SlamStep.ids`: the measurement was discarded."""


@dataclass(frozen=True, slots=True)
class Experience:
    """What an associator has learned from the scans of a run. It returns this in its `Hypothesis` and receives it in
    the next `Prediction`, so that associators remain functions without state. Counts decay from scan to scan."""

    unpaired: float  # measurements of objects that are not in the map
    area: float  # [m²] covered by the scans
    detections: Array  # (d,) log weights of the candidate values of the detection probability P_D


@dataclass(frozen=True, slots=True)
class Effort:
    """The work that a search did."""

    nodes: int = 0  # hypotheses visited in the interpretation tree
    individual_tests: int = 0  # pairings tested for individual compatibility
    joint_tests: int = 0  # joint compatibility tests
    limit_hit: bool = False  # a limit of the search was reached: the hypothesis may not be the best
    unary_tests: int = 0  # pairings tested by size and kind, whatever the pose
    binary_tests: int = 0  # pairs of pairings tested by their distances
    leaves: int = 0  # hypotheses complete enough to be located
    tries: int = 0  # random samples drawn
    seconds: float = 0.0  # wall time, where the search measures it
    orientation_tests: int = 0  # triples of pairings tested for their sense of rotation


@dataclass(frozen=True, slots=True)
class Posterior:
    """How probable a hypothesis is among those that the search found."""

    log_density: float  # of the hypothesis, unnormalised
    probability: float  # of the hypothesis
    runner_up: IntArray  # (m,) map features of the second most probable hypothesis, UNPAIRED for `*`
    runner_up_probability: float
    marginals: Array | None = None  # (m,) marginal probability of each decision; None: not computed
    unpaired: Array | None = None  # (m,) probability that each measurement is of nothing in the map; None: not computed


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A path of the interpretation tree: one decision per measurement."""

    features: IntArray  # (m,) map feature paired with each measurement, UNPAIRED for `*`
    joint_distance: float  # D²_H of all its pairings together
    dof: int  # degrees of freedom of that distance: 2 per pairing
    effort: Effort = Effort()  # work done to find it
    posterior: Posterior | None = None
    new: BoolArray | None = None  # (m,) which measurements start a feature; None: by the rule of `Slam`
    exclusive: bool = True  # no feature is paired twice; False: measurements were decided independently
    experience: Experience | None = None  # for the next prediction of the run

    @property
    def pairings(self) -> int:
        """Number of measurements that are paired."""
        return int((self.features != UNPAIRED).sum())

    def __repr__(self) -> str:
        return f"Hypothesis of {self.pairings} pairings among {len(self.features)} measurements: {self.features}"


@dataclass(frozen=True, slots=True)
class Relocation:
    """The answer of a search without a prior: a hypothesis and the robot pose that it implies."""

    features: IntArray  # (m,) map feature paired with each measurement, UNPAIRED for `*`
    pose: Array  # (3,) [m, m, rad] of the robot in B; NaN with fewer than two pairings
    covariance: Array  # (3, 3) [m², m·rad, rad²] of that pose; NaN likewise
    joint_distance: float  # D²_H at that pose
    dof: int  # 2k − 3 for k pairings, since the pose was fitted from them
    min_pairings: int  # number of pairings required for acceptance, for this scan and map
    ambiguous: bool  # another pose explains as many measurements, so the scan does not decide between them
    ties: int  # hypotheses at other poses with equally many pairings
    effort: Effort

    @property
    def pairings(self) -> int:
        """Number of measurements that are paired."""
        return int((self.features != UNPAIRED).sum())

    @property
    def accepted(self) -> bool:
        """Whether there are enough pairings, and at one pose only."""
        return self.pairings >= self.min_pairings and not self.ambiguous


Relocator = Callable[[Scan, Landmarks, Locality | None], Relocation]
"""A function that finds the robot in a map without a prior. Locality None: all features are local to each other."""
