"""SLAM whose decisions are judged by the truth, scan by scan: used by all logs, episodes, the suite and benchmarks."""

from __future__ import annotations

from slam_gym.association import resolve_associator, true_association
from slam_gym.association.prediction import Associator, Prediction, SlamStep
from slam_gym.metrics.association import Identities, Tally
from slam_gym.slam.local_maps import LocalMapSlam
from slam_gym.slam.slam import Slam
from slam_gym.types import Hypothesis, Odometry, Scan, Truth

CEILING = "true_association"
"""The associator that receives the truth. It must be given by this name: no callable ever receives the truth."""


class JudgedSlam:
    """A SLAM run with the judgement of its associations.

    Arguments:
        slam: runs the steps.
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
