"""Decisions that can be taken back: a handful of maps side by side, until the scans tell which is right.

An associator that cannot tell where the robot is says so (`Hypothesis.alternatives`): one of some decisions is right,
each with its probability. A `Slam` goes on with the associator's one answer. Here the whole SLAM branches: every
alternative is learned from in a copy of its own, and is from then on a map like any other, which predicts, is
associated and may branch again. With w_b the probability of map b and p(z, a | b) the density of a scan together with
alternative a of it, the maps that come of it have

    w_ba ∝ w_b · p(z, a | b),

so a map that keeps foreseeing its scans outweighs one that does not, and what was decided long ago is decided anew
whenever the most probable map changes. Maps that are hopeless are dropped, those that have come to the same pose again
are one, and no more than a few are kept. Nearly all of the time there is one.

Whatever goes with a map (what its features are, the way, explored space) has to branch with it: see `followed`.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import numpy as np

from slam_gym.slam.slam import Slam, send
from slam_gym.types import Associator, Hypothesis, Odometry, Prediction, Scan, SlamStep
from slam_gym.validation import check_hypothesis

T = TypeVar("T")

MAPS = 8  # that are kept at most
_HOPELESS = math.log(1e-3)  # below the most probable map, from which one is dropped
_SAME = 0.1, 0.03  # [m], [rad] poses no farther apart are one


@dataclass(frozen=True, eq=False)
class Branch:
    """A map that is kept."""

    slam: Slam
    log_weight: float  # of its probability
    parent: int  # number of the branch before the step that it came from
    step: SlamStep | None  # its last one; None before the first


class _Offer(NamedTuple):
    """An alternative of a map."""

    log_weight: float  # not normalised
    parent: int
    prediction: Prediction
    answer: Hypothesis


class Branches:
    """SLAM in as many maps as the associator leaves open.

    Arguments:
        slam: to begin with. Its features and settings are those of all maps.
        maps: kept at most; 1: no decision is left open.

    Raises ValueError for fewer than one map.
    """

    def __init__(self, slam: Slam, maps: int = MAPS) -> None:
        if maps < 1:
            raise ValueError(f"maps: {maps} is less than 1")
        self.maps = maps
        self.kept: tuple[Branch, ...] = (Branch(slam, 0.0, 0, None),)  # the most probable one first

    @property
    def slam(self) -> Slam:
        """That of the most probable map."""
        return self.kept[0].slam

    def step(self, odometry: Odometry, scan: Scan, associate: Associator) -> SlamStep:
        """A step of every map; that of the one which is now the most probable. Raises as `Slam.asking_step`.

        An associator that leaves nothing open decides for the most probable map, and ends the others.
        """
        offers: list[_Offer] = []
        for k, branch in enumerate(self.kept):
            asking = branch.slam.asking_step(odometry, scan)
            prediction = next(asking)
            answer = associate(scan, prediction)
            if k == 0 and (self.maps == 1 or not getattr(answer, "alternatives", ())):
                self.kept = (Branch(branch.slam, 0.0, k, send(asking, answer)),)
                return self._last_step
            asking.close()
            offers += [_offered(branch, k, prediction, way, scan) for way in answer.alternatives]
        self.kept = _normalised(_agreed(self._grown(scan, offers)))
        return self._last_step

    @property
    def _last_step(self) -> SlamStep:
        step = self.kept[0].step
        assert step is not None
        return step

    def _grown(self, scan: Scan, offers: list[_Offer]) -> list[Branch]:
        """The maps that come of the best offers, the most probable first."""
        best = max(offer.log_weight for offer in offers)
        ranked = sorted(offers, key=lambda offer: -offer.log_weight)[: self.maps]
        chosen = [offer for offer in ranked if offer.log_weight >= best + _HOPELESS]
        slams = followed([branch.slam for branch in self.kept], [offer.parent for offer in chosen])
        return [
            Branch(slam, offer.log_weight, offer.parent, slam._conclude(scan, offer.prediction, offer.answer))
            for slam, offer in zip(slams, chosen)
        ]


def followed(before: Sequence[T], parents: Sequence[int], copied: Callable[[T], T] = copy.deepcopy) -> list[T]:
    """What goes with each map of now, from what went with those `before`: the first that comes of one takes it over,
    the others are given copies."""
    copies = [copied(before[k]) if k in parents[:i] else before[k] for i, k in enumerate(parents)]
    return copies


def _offered(branch: Branch, k: int, prediction: Prediction, way: Hypothesis, scan: Scan) -> _Offer:
    """Raises ValueError for an alternative that does not fit scan and map, or without a density."""
    if way.posterior is None:
        raise ValueError("hypothesis.alternatives: one has no posterior to weigh it by")
    answer = check_hypothesis(way, len(scan), branch.slam.map.n)
    return _Offer(branch.log_weight + way.posterior.log_density, k, prediction, answer)


def _agreed(grown: Sequence[Branch]) -> list[Branch]:
    """Of those that have come to one pose the most probable, with the weight of all."""
    kept: list[Branch] = []
    for branch in grown:
        same = next((i for i, other in enumerate(kept) if _at_one_pose(branch.slam, other.slam)), None)
        if same is None:
            kept.append(branch)
        else:
            weight = float(np.logaddexp(kept[same].log_weight, branch.log_weight))
            kept[same] = replace(kept[same], log_weight=weight)
    return sorted(kept, key=lambda branch: -branch.log_weight)


def _at_one_pose(one: Slam, other: Slam) -> bool:
    x, y, turn = (one.map.pose - other.map.pose).tolist()
    return math.hypot(x, y) < _SAME[0] and abs(math.remainder(turn, 2.0 * math.pi)) < _SAME[1]


def _normalised(kept: Sequence[Branch]) -> tuple[Branch, ...]:
    total = float(np.logaddexp.reduce([branch.log_weight for branch in kept]))
    return tuple(replace(branch, log_weight=branch.log_weight - total) for branch in kept)
