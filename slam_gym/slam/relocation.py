"""Relocation in the loop: where a lost robot is, by a search without a prior, and the map's pose put there."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from slam_gym.association import resolve_relocator
from slam_gym.association.relocation.acceptance import min_pairings
from slam_gym.mapping.locality import covisible, within
from slam_gym.slam.slam import Relocate, Slam
from slam_gym.types import Hypothesis, Locality, Relocation, Relocator, Scan

_SAYS_NOTHING = np.diag([10.0**2, 10.0**2, math.pi**2 / 3.0])  # [m², m², rad²] of a pose before it is found
_MOST = 0.5

Localities = Literal["covisibility", "two-hop covisibility", "distance"]


def relocate_by(
    search: str | Relocator, locality: Localities | None = "covisibility", probability: float = 1e-6
) -> Relocate:
    """A `Relocate` for `Slam`: `search` (a name, `"module:function"`, a callable) among the features of the map.

    A lost robot asks scan after scan, and rooms resemble each other, so that an answer must pass more than the search's
    own rule: chance brings so many pairings with less than `probability` a scan, and they are most of what is measured
    and most of what should be in view from there. The robot is then moved to the pose found, with a covariance that
    says nothing: the update with the pairings, which `Slam` makes next, leaves it with what they tell.
    Raises ValueError for an unknown search or locality, or a probability that is none.
    """
    if not 0.0 < probability < 1.0:
        raise ValueError(f"probability: {probability} is not between 0 and 1")
    find = resolve_relocator(search)
    if locality not in (None, "covisibility", "two-hop covisibility", "distance"):
        raise ValueError(f"locality: {locality!r} is none of covisibility, two-hop covisibility, distance, None")

    def relocate(slam: Slam, scan: Scan) -> Hypothesis | None:
        landmarks = slam.map.landmarks()
        found = find(scan, landmarks, _locality(slam, locality))
        if not found.accepted or found.pairings < min_pairings(scan, landmarks, probability=probability):
            return None
        if found.pairings < _MOST * len(scan) or not _makes_sense(slam, found):
            return None
        slam.map.place(found.pose, _SAYS_NOTHING)
        return Hypothesis(found.features, found.joint_distance, 2 * found.pairings, found.effort)

    return relocate


def _makes_sense(slam: Slam, found: Relocation) -> bool:
    """Most of the established features that should be in view from the pose found are paired."""
    if slam.visible is None:
        return True
    there = slam.map.copy()
    there.place(found.pose, found.covariance)
    prediction = there.prediction(slam.spec.reach)
    visibility = slam.visible(found.pose, prediction)
    expected = prediction.features[(visibility >= _MOST) & ~there.provisional[prediction.features]]
    return int(np.isin(expected, found.features).sum()) >= _MOST * len(expected)


def _locality(slam: Slam, kind: Localities | None) -> Locality | None:
    if kind is None:
        return None
    if kind == "distance":
        return within(slam.map.positions, 2.0 * slam.spec.reach)
    return covisible(slam.covisibility, hops=2 if kind == "two-hop covisibility" else 1)
