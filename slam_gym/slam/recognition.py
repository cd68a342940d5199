"""Two maps of one robot, the way between which is unknown, joined once the recent part of one is recognised."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slam_gym.geometry import compose, inverse
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.map_joining import equate, join_at
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.slam.agreement import agreeing
from slam_gym.slam.loops import LoopSpec, Parts, overlap, recognise
from slam_gym.types import UNPAIRED, IntArray, Relocation


class Joined(NamedTuple):
    """Two maps in one, in the base of the older."""

    map: StochasticMap
    covisibility: CovisibilityGraph
    ids: IntArray  # (k, 2) of the older map and of the newer: the same; the latter are gone
    became: IntArray  # (n_a + n_b,) feature of the joined map that each of the older, then of the newer map is now


def join_recognised(
    a: StochasticMap,
    graph_a: CovisibilityGraph,
    b: StochasticMap,
    graph_b: CovisibilityGraph,
    recent: IntArray,
    spec: LoopSpec,
) -> Joined | None:
    """Maps A and B joined, the robot being that of B, if features `recent` (g,) of B are recognised in A; else None.

    What is known of the base of B comes from the pairs alone. They must have one shape under the covariance of both
    maps, and be most of what both have there. Neither map is changed.
    """
    among = np.flatnonzero(~a.provisional)
    found = recognise(b, recent, a, graph_a, among, spec) if len(among) >= spec.min_pairs else None
    if found is None:
        return None
    paired = found.features != UNPAIRED
    pairs, both = np.column_stack([among[found.features[paired]], a.n + recent[paired]]), join_at(a, b, found.pose)
    pairs = agreeing(both, pairs, spec, prior=False)
    parts = Parts(a.n + recent, among)
    if len(pairs) < spec.min_pairs or overlap(both, parts, pairs) < spec.min_fraction:
        return None
    return _made_one(both, graph_a.followed_by(graph_b), pairs)


def join_relocated(
    a: StochasticMap,
    graph_a: CovisibilityGraph,
    b: StochasticMap,
    graph_b: CovisibilityGraph,
    found: Relocation,
    features: IntArray,
    spec: LoopSpec,
) -> Joined | None:
    """Maps A and B joined by one scan, which was `found` in A and has updated the `features` (m,) of B, or UNPAIRED.

    A wrong relocation can be taken back by the next, a wrong join cannot: as many pairs are asked for as of a recent
    part, of one shape. Neither map is changed.
    """
    both = join_at(a, b, compose(found.pose, inverse(b.pose)))
    paired = (found.features != UNPAIRED) & (features != UNPAIRED)
    pairs = np.column_stack([found.features[paired], a.n + features[paired]])
    pairs = agreeing(both, pairs, spec, prior=False)
    return _made_one(both, graph_a.followed_by(graph_b), pairs) if len(pairs) else None


def _made_one(both: StochasticMap, graph: CovisibilityGraph, pairs: IntArray) -> Joined:
    became, kept = np.arange(both.n), np.delete(np.arange(both.n), pairs[:, 1])
    became[pairs[:, 1]] = pairs[:, 0]
    fused = graph.fused(pairs[:, 0], pairs[:, 1])
    return Joined(equate(both, pairs), fused, both.ids[pairs], np.searchsorted(kept, became))
