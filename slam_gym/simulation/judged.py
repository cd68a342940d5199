"""SLAM whose decisions are held against the truth, scan by scan: what every log, episode, suite and benchmark runs."""

from __future__ import annotations

import functools
from typing import Protocol

from slam_gym.association import true_association
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.metrics.association import Identities, Tally
from slam_gym.slam.asked import asked
from slam_gym.slam.slam import AskingStep, send
from slam_gym.types import Associator, Hypothesis, Odometry, Prediction, Scan, SlamStep, Truth

CEILING = "true_association"
"""The associator that is handed the truth. It is known by this name alone: no callable ever gets to see the truth."""


class Steps(Protocol):
    """What takes a SLAM step: `Slam` and its like."""

    @property
    def map(self) -> StochasticMap: ...

    def step(
        self, odometry: Odometry, scan: Scan, associator: str | Associator = ..., *, plain: bool = ...
    ) -> SlamStep: ...

    def asking_step(self, odometry: Odometry, scan: Scan) -> AskingStep: ...


class JudgedSlam:
    """A SLAM run with the judgement of its associations.

    Arguments:
        slam: what takes the steps.
        associator: a name, `"module:function"` or a callable. `CEILING`, by name, is told the truth of every scan.
        informed: the map of `CEILING` is told as well: every labelled feature goes in when it is first seen, whatever
            it is compatible with, and nothing else does.
        identities: to go on from; by default nothing has been judged yet.

    Raises ValueError for an unknown associator.
    """

    def __init__(
        self,
        slam: Steps,
        associator: str | Associator = "jcbb",
        *,
        informed: bool = False,
        identities: Identities | None = None,
    ) -> None:
        self.slam = slam
        self.identities = identities or Identities()
        self._truth_told = isinstance(associator, str) and associator == CEILING
        self._associate = asked(associator)
        self._informed = informed

    @property
    def tally(self) -> Tally:
        """The decisions so far."""
        return self.identities.total

    @property
    def last_tally(self) -> Tally:
        """The decisions of the last step."""
        return self.identities.last

    def step(self, odometry: Odometry, scan: Scan, truth: Truth, *, plain: bool = False) -> SlamStep:
        """One SLAM step, judged. Raises as `Slam.step`, which says what `plain` is."""
        if not self._truth_told:
            return self._judge(self.slam.step(odometry, scan, self._associate, plain=plain), truth)
        asking = self.slam.asking_step(odometry, scan)
        return self._judge(send(asking, self.associate(scan, next(asking), truth)), truth)

    def associate(self, scan: Scan, prediction: Prediction, truth: Truth) -> Hypothesis:
        """What the associator says; `CEILING` is told the truth."""
        return self._associator(truth)(scan, prediction)

    def asking_step(self, odometry: Odometry, scan: Scan, truth: Truth) -> AskingStep:
        """The same where somebody outside associates: see `slam_gym.slam.slam.AskingStep`."""
        step = yield from self.slam.asking_step(odometry, scan)
        return self._judge(step, truth)

    def _judge(self, step: SlamStep, truth: Truth) -> SlamStep:
        self.identities.judge(step, truth)
        return step

    def _associator(self, truth: Truth) -> Associator:
        if not self._truth_told:
            return self._associate
        known = self.identities.source_of(self.slam.map.ids)
        return functools.partial(true_association, sources=truth.sources, identities=known, new_features=self._informed)
