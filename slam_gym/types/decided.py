"""What associators and relocators decide: hypotheses and relocations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from slam_gym.types._fields import Array, BoolArray, IntArray, quick
from slam_gym.types.mapped import Landmarks, Locality
from slam_gym.types.measured import Scan

UNPAIRED = -1
"""The decision for a measurement that is paired with no feature: the branch `*` of the interpretation tree."""

NO_ID = -1
"""In `SlamStep.ids`: the measurement was discarded."""


@quick
@dataclass(frozen=True, slots=True)
class Experience:
    """What an associator has learned from the scans of a run. It returns this in its `Hypothesis` and receives it in
    the next `Prediction`, so that associators remain functions without state. Counts decay from scan to scan."""

    unpaired: float  # measurements of objects that are not in the map
    area: float  # [m²] covered by the scans
    detections: Array  # (d,) log weights of the candidate values of the detection probability P_D


@quick
@dataclass(frozen=True, slots=True)
class Effort:
    """The work that a search did."""

    nodes: int = 0  # hypotheses visited in the interpretation tree
    individual_tests: int = 0  # pairings tested for individual compatibility
    joint_tests: int = 0  # joint compatibility tests
    limit_hit: bool = False  # the node limit ended the search: the hypothesis may not be the best
    unary_tests: int = 0  # pairings tested by size and kind, whatever the pose
    binary_tests: int = 0  # pairs of pairings tested by their distances
    leaves: int = 0  # hypotheses complete enough to be located
    tries: int = 0  # random samples drawn
    seconds: float = 0.0  # wall time, where the search measures it
    orientation_tests: int = 0  # triples of pairings tested for their sense of rotation


@quick
@dataclass(frozen=True, slots=True)
class Posterior:
    """How probable a hypothesis is among those that the search found."""

    log_density: float  # of the hypothesis, unnormalised
    probability: float  # of the hypothesis
    runner_up: IntArray  # (m,) map features of the second most probable hypothesis, UNPAIRED for `*`
    runner_up_probability: float
    marginals: Array | None = None  # (m,) marginal probability of each decision; None: not computed
    unpaired: Array | None = None  # (m,) probability that each measurement is of nothing in the map; None: not computed


@quick
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
