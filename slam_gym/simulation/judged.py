"""Decisions judged by the truth: those of a SLAM run, scan by scan, and those of a walk, measurement by measurement."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from slam_gym.association import resolve_associator, true_association
from slam_gym.association.prediction import Associator, Prediction, SlamStep
from slam_gym.association.tracking.walk import Walk
from slam_gym.metrics.association import Decision, Identities, Tally
from slam_gym.slam.local_maps import LocalMapSlam
from slam_gym.slam.slam import Slam
from slam_gym.types import UNLABELLED, UNPAIRED, Hypothesis, IntArray, Odometry, Scan, Truth

CEILING = "true_association"
"""The associator that receives the truth. It must be given by this name: no callable ever receives the truth."""

NOT_OFFERED = -1
"""In place of an action: the right action is not offered, or unknown."""

UNDECIDED = -1
"""In place of a `Decision`: the measurement is not decided yet."""


class JudgedSlam:
    """A SLAM run with the judgement of its associations: used by logs, episodes, the suite and benchmarks.

    Arguments:
        slam: runs the steps. `CEILING` switches its rules against accidental pairings off, for good.
        associator: a name, `"module:function"` or a callable. `CEILING`, by name, receives the truth of every scan.
        informed: `CEILING` also decides which measurements start features: each labelled feature when it is first
            seen, whatever it is compatible with, and nothing else.

    Raises ValueError for an unknown associator.
    """

    def __init__(
        self, slam: Slam | LocalMapSlam, associator: str | Associator = "jcbb", *, informed: bool = False
    ) -> None:
        self.slam = slam
        self.identities = Identities()
        self._knows_truth = isinstance(associator, str) and associator == CEILING
        self._associate = resolve_associator(associator)
        self._informed = informed
        if self._knows_truth and isinstance(slam, Slam):
            slam.spec = replace(
                slam.spec, max_accidental_matches=math.inf, max_chance_probability=1.0, trust_marginals=True
            )

    @property
    def tally(self) -> Tally:
        """The tally of the decisions so far."""
        return self.identities.total

    def step(self, odometry: Odometry, scan: Scan, truth: Truth) -> SlamStep:
        """Run one SLAM step and judge it. Raises as `Slam.step`."""
        prediction = self.slam.predict(odometry, scan)
        return self.learn(scan, prediction, self.associate(scan, prediction, truth), truth)

    def associate(self, scan: Scan, prediction: Prediction, truth: Truth) -> Hypothesis:
        """The hypothesis of the associator. Only `CEILING` receives the truth."""
        if not self._knows_truth:
            return self._associate(scan, prediction)
        known = self.identities.source_of(self.slam.map.ids)
        return true_association(scan, prediction, sources=truth.sources, identities=known, new_features=self._informed)

    def learn(self, scan: Scan, prediction: Prediction, hypothesis: Hypothesis, truth: Truth) -> SlamStep:
        """Complete the step with a hypothesis from any source, and judge it. Raises as `Slam.learn`."""
        step = self.slam.learn(scan, prediction, hypothesis)
        self.identities.judge(step, truth)
        return step


@dataclass(frozen=True, slots=True)
class RightAnswers:
    """The truth about a scan, relative to the map before it."""

    sources: IntArray  # (m,) true feature behind each measurement
    identities: IntArray  # (n,) true feature behind each feature of the map
    right: IntArray  # (m,) map feature of each measurement, the oldest of duplicates; UNPAIRED: not in the map

    @classmethod
    def of(cls, truth: Truth, identities: IntArray) -> RightAnswers:
        """For the scan of `truth`, and a map whose features (n,) come from the true features `identities`."""
        oldest: dict[int, int] = {}
        for feature, source in enumerate(identities.tolist()):
            oldest.setdefault(source, feature)
        sources = truth.sources.tolist()
        right = [oldest.get(source, UNPAIRED) if source >= 0 else UNPAIRED for source in sources]
        return cls(truth.sources, identities, np.array(right, np.int64))

    @property
    def known(self) -> int:
        """Number of measurements of features that the map has."""
        return int(np.count_nonzero(self.right != UNPAIRED))

    def judge(self, measurement: int, feature: int) -> tuple[int, int]:
        """(right, wrong) of a pairing: (1, 0), (0, 1), or (0, 0) where a label is missing."""
        if self.sources[measurement] == UNLABELLED or self.identities[feature] == UNLABELLED:
            return 0, 0
        right = int(self.right[measurement] == feature)
        return right, 1 - right

    def right_action(self, walk: Walk) -> int:
        """The right action of the walk; NOT_OFFERED if it is not offered, or unknown."""
        i = walk.measurement
        action = None if self.sources[i] == UNLABELLED else walk.action_of(int(self.right[i]))
        return NOT_OFFERED if action is None else action


def decisions(walk: Walk, answers: RightAnswers) -> IntArray:
    """(m,) `Decision` on each measurement of a walk so far, UNDECIDED for later measurements."""
    rows, out = walk.decided, np.full(len(walk.tree.scan), UNDECIDED)
    for i in walk.candidates.measurements[: walk.level].tolist():
        if rows[i] == UNPAIRED:
            out[i] = Decision.DISCARDED
            continue
        right, wrong = answers.judge(i, int(walk.tree.prediction.features[rows[i]]))
        out[i] = Decision.RIGHT if right else Decision.WRONG if wrong else Decision.UNJUDGED
    return out
