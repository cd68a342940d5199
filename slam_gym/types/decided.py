"""What is decided: hypotheses, relocations, whole steps, and whatever decides."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from slam_gym.types._arguments import Array, BoolArray, IntArray
from slam_gym.types._records import quick
from slam_gym.types.mapped import Landmarks, Locality
from slam_gym.types.measured import Scan

UNPAIRED = -1
"""What a hypothesis decides for a measurement that it pairs with nothing: the branch `*` of the interpretation tree."""

NO_ID = -1
"""In `SlamStep.ids`: the measurement was discarded."""


@quick
@dataclass(frozen=True, slots=True)
class Experience:
    """What an associator has learned of the scans of a run: it says so in its `Hypothesis`, and the next `Prediction`
    reminds it. Associators stay functions, and what they learn goes with the run. Counts fade from scan to scan."""

    unpaired: float  # measurements of what is not in the map
    area: float  # [m²] that the scans showed
    detections: Array  # (d,) log weights of the values that P_D may have


@quick
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


@quick
@dataclass(frozen=True, slots=True)
class Posterior:
    """How probable a hypothesis is, among those that the search came across."""

    log_density: float  # unnormalised, of the hypothesis
    probability: float  # of the hypothesis
    runner_up: IntArray  # (m,) map features of the next most probable one, UNPAIRED for `*`
    runner_up_probability: float
    marginals: Array | None = None  # (m,) probability of each decision by itself, over all hypotheses; None: not asked
    unpaired: Array | None = None  # (m,) probability that each measurement is of nothing in the map; None: likewise


@quick
@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A path of the interpretation tree: one decision per measurement."""

    features: IntArray  # (m,) map feature paired with each measurement, UNPAIRED for `*`
    joint_distance: float  # D²_H of all its pairings together
    dof: int  # degrees of freedom of that distance: 2 per pairing
    effort: Effort = Effort()  # what it took to find it
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
    ambiguous: bool  # another pose explains as many measurements: the scan does not decide
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


Relocator = Callable[[Scan, Landmarks, Locality | None], Relocation]
"""Whatever finds the robot in a map without a prior. Locality None: all features are local to all."""
