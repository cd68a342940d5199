"""Relocation: a lost robot is found by a search without a prior, whose answer must explain the scan."""

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
"""The default search for a lost robot."""

LocalityName = Literal["covisibility", "two-hop covisibility", "distance"]
LOCALITIES: tuple[LocalityName, ...] = get_args(LocalityName)

Relocate = Callable[[Scan, StochasticMap, CovisibilityGraph, float, ViewsFrom | None], Relocation | None]
"""Finds the robot: takes a scan, a map, its covisibility, the reach [m] of the sensor and, if known, what it has in
view from a pose; returns a relocation, or None where the scan does not determine the pose."""


def relocate_by(
    search: str | Relocator, locality: LocalityName | None = "covisibility", probability: float = 1e-6
) -> Relocate:
    """Relocation by `search` (a name, `"module:function"` or a callable) among the features of a map.

    A lost robot searches scan after scan, and rooms resemble each other, so that an answer must pass more than the
    rule of the search itself: the probability of so many accidental pairings in a scan must be less than `probability`,
    and most measurements, and most features that should be in view from the pose found, must be paired.
    Raises ValueError for an unknown search or locality, or a probability outside (0, 1).
    """
    if not 0.0 < probability < 1.0:
        raise ValueError(f"probability: {probability} is not between 0 and 1")
    find = resolve_relocator(search)
    is_built_in = any(find is known for known in RELOCATORS.values())
    if locality not in (None, *LOCALITIES):
        raise ValueError(f"locality: {locality!r} is none of {', '.join(LOCALITIES)}, None")

    def relocate(
        scan: Scan, m: StochasticMap, graph: CovisibilityGraph, reach: float, view_from: ViewsFrom | None
    ) -> Relocation | None:
        landmarks = m.landmarks()
        local_to = locality_of(graph, m.positions, reach, locality)
        found = find(scan if is_built_in else scan.read_only(), landmarks, local_to)
        if not found.accepted or found.pairings < min_pairings(scan, landmarks, probability=probability):
            return None
        explains = found.pairings >= _EXPLAINED * len(scan)
        return found if explains and (view_from is None or _shows(found, m, reach, view_from)) else None

    return relocate


def locality_of(graph: CovisibilityGraph, positions: Array, reach: float, kind: LocalityName | None) -> Locality | None:
    """The locality named `kind` among features at `positions` (n, 2) [m], for a sensor of range `reach` [m]."""
    if kind is None:
        return None
    if kind == "distance":
        return within(positions, 2.0 * reach)
    return covisible(graph, hops=2 if kind == "two-hop covisibility" else 1)


def _shows(found: Relocation, m: StochasticMap, reach: float, view_from: ViewsFrom) -> bool:
    """Whether most of the established features that should be in view from the pose found are paired."""
    relocated = m.copy()
    relocated.place(found.pose, found.covariance)
    prediction = predict(relocated, reach, sight=view_from)
    visibility = prediction.visibility()
    assert visibility is not None
    expected: IntArray = prediction.features[(visibility >= EXPECTED) & ~prediction.provisional]
    return int(np.isin(expected, found.features).sum()) >= _EXPLAINED * len(expected)
