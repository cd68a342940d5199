"""SLAM that notices when the robot is lost, stops learning, and finds it again by a search without a prior."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, get_args

import numpy as np

from slam_gym.association import RELOCATORS, resolve_relocator
from slam_gym.association.relocation.acceptance import min_pairings
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.locality import covisible, within
from slam_gym.mapping.map_joining import UNKNOWN_POSE
from slam_gym.slam.asked import locked
from slam_gym.slam.kernels import Learned
from slam_gym.slam.lost import EXPECTED, Tracker
from slam_gym.slam.slam import Slam, SlamSpec, ViewFrom
from slam_gym.types import (
    NO_ID,
    UNPAIRED,
    Array,
    Effort,
    Expectation,
    Hypothesis,
    IntArray,
    Locality,
    Odometry,
    Prediction,
    Relocation,
    Relocator,
    Scan,
    SlamStep,
)
from slam_gym.validation import check_hypothesis

_STILL = Odometry(np.zeros(3), np.zeros((3, 3)))
_EXPLAINED = 0.5  # fraction of the measurements, and of what should be in view, that a relocation must pair

SEARCH = "gcbb"
"""The search that finds a lost robot unless another is asked for."""

LocalityName = Literal["covisibility", "two-hop covisibility", "distance"]
LOCALITIES: tuple[LocalityName, ...] = get_args(LocalityName)

Relocate = Callable[[Slam, Scan], Relocation | None]
"""Asked scan by scan while the robot is lost: where it is, or None where the scan does not decide."""


class RelocatingSlam(Slam):
    """`Slam` with relocation around its step.

    A scan that pairs too little of what should be in view (`Tracker`) is not learned from. Once there were too many of
    them in a row the robot is lost, and `relocate` is asked scan after scan. With its answer the robot is moved to the
    pose found, with a covariance that says nothing, and the step goes on from there: the update with the pairings
    leaves it with what they tell.
    """

    def __init__(self, spec: SlamSpec | None, relocate: Relocate, view_from: ViewFrom | None = None) -> None:
        super().__init__(spec, view_from)
        self.relocate = relocate
        self.tracker = Tracker(self.spec.lost_fraction, self.spec.lost_scans, self.spec.min_expected)
        self._relocations = 0

    @property
    def lost(self) -> bool:
        """The robot is not where the map has it, and waits for relocation."""
        return self.tracker.lost

    @property
    def relocations(self) -> int:
        """How often the robot was found again so far."""
        return self._relocations

    @property
    def doubted(self) -> bool:
        """The last scan was not believed."""
        return self.tracker.doubted > 0

    def _trust(self) -> tuple[float, bool]:
        """A scan is learned from at once where it is plain that it shows what it should."""
        return self.tracker.trust(blind=self.view_from is None)

    def _conclude(
        self, scan: Scan, expected: Expectation, hypothesis: Hypothesis, learned: Learned | None = None
    ) -> SlamStep:
        """As `Slam` does, unless the scan is doubted."""
        if self.view_from is None:
            self.tracker.look(scan.points)
        if learned is not None:
            self.tracker.believe(hypothesis)
            return self._remember(scan, expected, hypothesis, learned)
        prediction = expected.prediction
        if not self.tracker.doubts(prediction, hypothesis, self.map.established(prediction.features)):
            hypothesis = self._believed(scan, prediction, hypothesis)
            self.tracker.believe(hypothesis)  # what is held back is not expected to be seen again
            return self._learn(scan, prediction, hypothesis)
        found = self.relocate(self, scan) if self.lost else None
        if found is None:
            return self._learn_nothing(prediction, scan)
        return self._go_on_from(found, scan)

    def _believed(self, scan: Scan, prediction: Prediction, hypothesis: Hypothesis) -> Hypothesis:
        """The part of a hypothesis that is learned from: all of it."""
        return hypothesis

    def _renumber(self, became: IntArray) -> None:
        super()._renumber(became)
        self.tracker.renumber(became)

    def _go_on_from(self, found: Relocation, scan: Scan) -> SlamStep:
        """The step of a scan that says where the robot is. Raises ValueError, the robot unmoved, where it cannot be."""
        answer = Hypothesis(found.features, found.joint_distance, 2 * found.pairings, found.effort)
        hypothesis = check_hypothesis(answer, len(scan), self.map.n)
        self.map.place(found.pose, UNKNOWN_POSE)
        self.tracker.believe(hypothesis)
        self._relocations += 1
        everything = Slam.predict_features(self, scan, _STILL)  # nothing is known of the pose: all would be ambiguous
        return self._learn(scan, everything, hypothesis)

    def _learn_nothing(self, prediction: Prediction, scan: Scan) -> SlamStep:
        """The step of a scan that is not believed: the map stays as the odometry left it."""
        m, none = len(scan), np.empty(0, np.int64)
        self.map.end_of_step()
        hypothesis = Hypothesis(np.full(m, UNPAIRED), 0.0, 0, Effort())
        return SlamStep(prediction, hypothesis, np.full(m, NO_ID), np.zeros(m, np.bool_), none)


def relocate_by(
    search: str | Relocator, locality: LocalityName | None = "covisibility", probability: float = 1e-6
) -> Relocate:
    """A `Relocate` for `RelocatingSlam`: `search` (a name, `"module:function"`, a callable) among the map's features.

    A lost robot asks scan after scan, and rooms resemble each other, so that an answer must pass more than the search's
    own rule: chance brings so many pairings with less than `probability` a scan, and they are most of what is measured
    and most of what should be in view from there.
    Raises ValueError for an unknown search or locality, or a probability that is none.
    """
    if not 0.0 < probability < 1.0:
        raise ValueError(f"probability: {probability} is not between 0 and 1")
    find = resolve_relocator(search)
    own = any(find is known for known in RELOCATORS.values())
    if locality not in (None, *LOCALITIES):
        raise ValueError(f"locality: {locality!r} is none of {', '.join(LOCALITIES)}, None")

    def relocate(slam: Slam, scan: Scan) -> Relocation | None:
        landmarks = slam.map.landmarks()
        local = locality_of(slam.covisibility, slam.map.positions, slam.reach, locality)
        found = find(scan if own else locked(scan), landmarks, local)
        if not found.accepted or found.pairings < min_pairings(scan, landmarks, probability=probability):
            return None
        explains = found.pairings >= _EXPLAINED * len(scan) and _makes_sense(slam, found)
        return found if explains else None

    return relocate


def locality_of(graph: CovisibilityGraph, positions: Array, reach: float, kind: LocalityName | None) -> Locality | None:
    """The locality of that name among features at `positions` (n, 2) [m], for a sensor that reaches `reach` [m]."""
    if kind is None:
        return None
    if kind == "distance":
        return within(positions, 2.0 * reach)
    return covisible(graph, hops=2 if kind == "two-hop covisibility" else 1)


def _makes_sense(slam: Slam, found: Relocation) -> bool:
    """Most of the established features that should be in view from the pose found are paired."""
    if slam.view_from is None:
        return True
    there = slam.map.copy()
    there.place(found.pose, found.covariance)
    prediction = there.prediction(slam.reach)
    visibility = slam.view_from(found.pose)(prediction.positions, prediction.covariances)
    expected: IntArray = prediction.features[(visibility >= EXPECTED) & ~there.provisional[prediction.features]]
    return int(np.isin(expected, found.features).sum()) >= _EXPLAINED * len(expected)
