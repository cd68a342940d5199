"""Loops that close while the robot is tracked: the recent part of the map is looked for among its older features.

A robot that comes back with more drift than its covariance admits starts its features anew: a second layer of the map,
which no single scan tells from new ground. A dozen of its features do. They take the place of a scan (`as_scan`), the
older features near by, as far as the uncertainty allows, that of the map, and one of the searches without a prior pairs
them. What it finds must then pass the *prior* as well, see `slam.agreement`: one shape, and a
motion between the two that the map thinks possible.

A wrong loop ruins the map, a missed one can be closed later: besides, there must be enough pairs, more than chance
brings by far, where chance is what the same search finds for the mirror image of the recent part in the same map; and
they must be most of what both parts have where they overlap.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from slam_gym.association import indexed, resolve_relocator
from slam_gym.association.compatibility import chi2_gate
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.locality import linked
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.slam.agreement import agreeing
from slam_gym.slam.merging import as_scan
from slam_gym.types import UNPAIRED, IntArray, Landmarks, Relocation, Relocator, Scan

NO_PAIRS = np.empty((0, 2), np.int64)


@dataclass(frozen=True)
class LoopSpec:
    """What is searched for while the robot is tracked, and when it is believed."""

    search: str | Relocator = "indexed"  # what finds the recent part among the older features
    node_limit: int = 5_000  # poses that `indexed` weighs before it gives up
    every: int = 20  # [scans] from one search to the next
    group: int = 20  # features of the recent part of the map: those seen last
    recent: int = 60  # [scans] what was seen in these is not older
    min_pairs: int = 8  # below which no loop is closed: with six, half of them were wrong
    above_chance: int = 3  # pairs more than the mirror image of the recent part finds
    min_fraction: float = 0.5  # of the features of either part, where they overlap, that must be paired
    confidence: float = 0.999  # of the tests of shape and of motion
    inflation: float = 3.0  # of the standard deviations of the motion between the two parts

    def __post_init__(self) -> None:
        resolve_relocator(self.search)
        for name, least in (
            ("node_limit", 1),
            ("every", 1),
            ("recent", 1),
            ("group", 3),
            ("min_pairs", 3),
            ("above_chance", 0),
        ):
            if getattr(self, name) < least:
                raise ValueError(f"LoopSpec.{name}: {getattr(self, name)} is less than {least}")
        if not 0.0 <= self.min_fraction <= 1.0:
            raise ValueError(f"LoopSpec.min_fraction: {self.min_fraction} is not between 0 and 1")
        if not 0.0 < self.confidence < 1.0:
            raise ValueError(f"LoopSpec.confidence: {self.confidence} is not between 0 and 1")
        if not 1.0 <= self.inflation < math.inf:
            raise ValueError(f"LoopSpec.inflation: {self.inflation} is not a number ≥ 1")


class Parts(NamedTuple):
    """What is searched for, and where."""

    recent: IntArray  # (g,) features that are searched for, ascending
    older: IntArray  # (a,) features that they are searched among, ascending


def parts_of(m: StochasticMap, graph: CovisibilityGraph, spec: LoopSpec) -> Parts | None:
    """The recent part of a map and the older features that it may be, or None where there are too few of either.

    Older features are individually compatible with one of the recent part under the inflated covariance; a feature of
    the recent part that none is compatible with is still searched for, as part of its shape.
    """
    recent, old = recent_part(m, graph, spec), ~m.provisional & (m.last_seen < m.step - spec.recent)
    old[recent] = False
    older = np.flatnonzero(old)
    if len(recent) < spec.min_pairs or len(older) < spec.min_pairs:
        return None
    gate = spec.inflation**2 * chi2_gate(2, spec.confidence)
    near = np.isfinite(m.distances_between(recent, older, gate))
    if near.any(axis=1).sum() < spec.min_pairs or near.any(axis=0).sum() < spec.min_pairs:
        return None
    return Parts(recent, older[near.any(axis=0)])


def recent_part(m: StochasticMap, graph: CovisibilityGraph, spec: LoopSpec) -> IntArray:
    """The established features (g,) that were seen last, ascending: those of the recent scans, and what was seen
    together with them, or with what was. How others lie to them is the question, not a part of it."""
    last, established = m.last_seen, ~m.provisional
    linked_to = np.flatnonzero(graph.local_to(np.flatnonzero(last >= m.step - spec.recent)))
    part = np.flatnonzero(established & graph.local_to(linked_to))
    return np.sort(part[np.argsort(last[part], kind="stable")[-spec.group :]])


def find_loop(m: StochasticMap, graph: CovisibilityGraph, parts: Parts, spec: LoopSpec) -> IntArray:
    """Pairs (k, 2) of an older feature and one of the recent part that are the same; none where no loop is believed."""
    found = recognise(m, parts.recent, m, graph, parts.older, spec)
    if found is None:
        return NO_PAIRS
    pairs = agreeing(m, _pairs_of(found, parts), spec, prior=True)
    believed = len(pairs) >= spec.min_pairs and never_together(graph, pairs)
    return pairs if believed and overlap(m, parts, pairs) >= spec.min_fraction else NO_PAIRS


def recognise(
    m: StochasticMap, recent: IntArray, of: StochasticMap, graph: CovisibilityGraph, among: IntArray, spec: LoopSpec
) -> Relocation | None:
    """Where features `recent` (g,) of a map are found among the features `among` (a,) of another, or of the same.

    None where too few are, or as many elsewhere, or hardly more than of their mirror image. `graph` is that of the
    map `of` which they are searched in. The pose found is that of the base of the first map in the base of the other.
    """
    search, scan, landmarks = _search_of(spec), as_scan(m, recent), landmarks_of(of, among)
    locality = linked(len(among), _edges_among(graph, among), hops=2)
    found = search(scan, landmarks, locality)
    if found.pairings < max(spec.min_pairs, found.min_pairings) or found.ambiguous or found.effort.limit_hit:
        return None
    by_chance = search(mirrored(scan), landmarks, locality).pairings
    return found if found.pairings >= by_chance + spec.above_chance else None


def _search_of(spec: LoopSpec) -> Relocator:
    """What finds the recent part, with a limit on its work: clutter can make it look at everything."""
    search = resolve_relocator(spec.search)
    return functools.partial(indexed, node_limit=spec.node_limit) if search is indexed else search


def _pairs_of(found: Relocation, parts: Parts) -> IntArray:
    """(k, 2) older and newer feature of each pairing found, by the older."""
    paired = found.features != UNPAIRED
    pairs = np.column_stack([parts.older[found.features[paired]], parts.recent[paired]])
    return pairs[np.argsort(pairs[:, 0])]


def landmarks_of(m: StochasticMap, features: IntArray) -> Landmarks:
    """Some features (k,) of a map, with their joint covariance."""
    landmarks = Landmarks.from_points(m.positions[features], covariance=m.covariance_of(features))
    of_each = {name: getattr(m, name)[features] for name in ("sizes", "size_variances", "kinds")}
    return replace(landmarks, **of_each)


def _edges_among(graph: CovisibilityGraph, features: IntArray) -> IntArray:
    """(e, 2) pairs of rows of `features` (k,) that were seen together."""
    first, second = np.nonzero(graph.among(features))
    return np.column_stack([first, second])[first < second]


def mirrored(scan: Scan) -> Scan:
    """The scan as it would be measured beyond a mirror: y becomes −y.

    A map holds no mirror image of itself, but for rooms that are symmetric: what a search finds of it is chance.
    """
    flip = np.diag([1.0, -1.0])
    return Scan(scan.points @ flip, flip @ scan.covariances @ flip, scan.sizes, scan.size_variances, scan.kinds)


def never_together(graph: CovisibilityGraph, pairs: IntArray) -> bool:
    """Whether no scan saw both features of a pair (k, 2), as two."""
    return not any(graph.count(older, newer) for older, newer in pairs.tolist())


def overlap(m: StochasticMap, parts: Parts, pairs: IntArray) -> float:
    """Fraction that the pairs (k, 2) are of the features of either part, the lesser, within the circle about them."""
    positions, counts = m.positions, []
    for side, features in ((0, parts.older), (1, parts.recent)):
        paired = positions[pairs[:, side]]
        centre = paired.mean(axis=0)
        radius = float(np.hypot(*(paired - centre).T).max()) + 1e-9
        counts.append(int((np.hypot(*(positions[features] - centre).T) <= radius).sum()))
    return len(pairs) / max(min(counts), 1)
