"""Relocation: where a lost robot is, by a search without a prior whose answer must explain what is seen."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, get_args

import numpy as np

from slam_gym.association import RELOCATORS, resolve_relocator
from slam_gym.association.acceptance import min_pairings
from slam_gym.association.prediction import predict
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.locality import covisible, within
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.navigation.visibility import ViewsFrom
from slam_gym.slam.tracker import EXPECTED
from slam_gym.types import Array, IntArray, Locality, Relocation, Relocator, Scan

_EXPLAINED = 0.5  # fraction of the measurements, and of what should be in view, that a relocation must pair

SEARCH = "gcbb"
"""The search that finds a lost robot unless another is asked for."""

LocalityName = Literal["covisibility", "two-hop covisibility", "distance"]
LOCALITIES: tuple[LocalityName, ...] = get_args(LocalityName)

Relocate = Callable[[Scan, StochasticMap, CovisibilityGraph, float, ViewsFrom | None], Relocation | None]
"""From a scan, a map, its covisibility, the reach [m] of the sensor and what it has in view, if that is known, to where
the robot is; None where the scan does not decide."""


def relocate_by(
    search: str | Relocator, locality: LocalityName | None = "covisibility", probability: float = 1e-6
) -> Relocate:
    """Relocation by `search` (a name, `"module:function"`, a callable) among a map's features.

    A lost robot searches scan after scan, and rooms resemble each other, so that an answer must pass more than the
    search's own rule: chance brings so many pairings with less than `probability` a scan, and they are most of what is
    measured and most of what should be in view from there.
    Raises ValueError for an unknown search or locality, or a probability that is none.
    """
    if not 0.0 < probability < 1.0:
        raise ValueError(f"probability: {probability} is not between 0 and 1")
    find = resolve_relocator(search)
    own = any(find is known for known in RELOCATORS.values())
    if locality not in (None, *LOCALITIES):
        raise ValueError(f"locality: {locality!r} is none of {', '.join(LOCALITIES)}, None")

    def relocate(
        scan: Scan, m: StochasticMap, graph: CovisibilityGraph, reach: float, view_from: ViewsFrom | None
    ) -> Relocation | None:
        landmarks = m.landmarks()
        found = find(scan if own else scan.read_only(), landmarks, locality_of(graph, m.positions, reach, locality))
        if not found.accepted or found.pairings < min_pairings(scan, landmarks, probability=probability):
            return None
        explains = found.pairings >= _EXPLAINED * len(scan)
        return found if explains and (view_from is None or _shows(found, m, reach, view_from)) else None

    return relocate


def locality_of(graph: CovisibilityGraph, positions: Array, reach: float, kind: LocalityName | None) -> Locality | None:
    """The locality of that name among features at `positions` (n, 2) [m], for a sensor that reaches `reach` [m]."""
    if kind is None:
        return None
    if kind == "distance":
        return within(positions, 2.0 * reach)
    return covisible(graph, hops=2 if kind == "two-hop covisibility" else 1)


def _shows(found: Relocation, m: StochasticMap, reach: float, view_from: ViewsFrom) -> bool:
    """Most of the established features that should be in view from the pose found are paired."""
    there = m.copy()
    there.place(found.pose, found.covariance)
    prediction = predict(there, reach, sight=view_from)
    visibility = prediction.visibility()
    assert visibility is not None
    expected: IntArray = prediction.features[(visibility >= EXPECTED) & ~prediction.provisional]
    return int(np.isin(expected, found.features).sum()) >= _EXPLAINED * len(expected)
