"""Relocation in the loop: where a lost robot is, by a search without a prior, and the map's pose put there."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from slam_gym.association import resolve_relocator
from slam_gym.mapping.locality import covisible, within
from slam_gym.slam import Relocate, Slam
from slam_gym.types import Hypothesis, Locality, Relocator, Scan

_SAYS_NOTHING = np.diag([10.0**2, 10.0**2, math.pi**2 / 3.0])  # [m², m², rad²] of a pose before it is found

Localities = Literal["covisibility", "two-hop covisibility", "distance"]


def relocate_by(search: str | Relocator, locality: Localities | None = "covisibility") -> Relocate:
    """A `Relocate` for `Slam`: `search` (a name, `"module:function"`, a callable) among the features of the map.

    An accepted answer moves the robot to the pose found, with a covariance that says nothing: the update with the
    pairings, which `Slam.step` makes next, then leaves the robot with what they tell and correlated as they are.
    Raises ValueError for an unknown search or locality.
    """
    find = resolve_relocator(search)
    if locality not in (None, "covisibility", "two-hop covisibility", "distance"):
        raise ValueError(f"locality: {locality!r} is none of covisibility, two-hop covisibility, distance, None")

    def relocate(slam: Slam, scan: Scan) -> Hypothesis | None:
        found = find(scan, slam.map.landmarks(), _locality(slam, locality))
        if not found.accepted:
            return None
        slam.map.place(found.pose, _SAYS_NOTHING)
        return Hypothesis(found.features, found.joint_distance, 2 * found.pairings, found.effort)

    return relocate


def _locality(slam: Slam, kind: Localities | None) -> Locality | None:
    if kind is None:
        return None
    if kind == "distance":
        return within(slam.map.positions, 2.0 * slam.spec.reach)
    return covisible(slam.covisibility, hops=2 if kind == "two-hop covisibility" else 1)
