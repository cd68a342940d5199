"""The search of a `FeatureIndex`: which triples of measurements are looked up, and when enough have been.

Completeness by pigeonhole: with the measurements in g groups, any 2g + 1 of them have three in one group. So once all
triples within the groups have been looked up, no pose is unseen that explains more than 2g measurements. Groups are
compact, since small triangles have few likes: they number n in proportion to the radius of their circumcircle.
"""

from __future__ import annotations

import math

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.index_pose import FIT, Look, Store, StoreArrays
from slam_gym.association.index_seeds import is_indexed, try_triple
from slam_gym.association.index_store import largest_variance
from slam_gym.association.index_verify import LIMIT, Found
from slam_gym.types import NONE, Array, BoolArray, IntArray

KEPT = 16  # hypotheses remembered: the best and those that tie with it


@compiled
def search(
    scan: tuple[Array, Array, Array],
    locality: tuple[IntArray, IntArray],
    arrays: StoreArrays,
    gates: Array,
    needed: int,
    decisive: int,
    node_limit: int,
) -> tuple[int, IntArray, Array, Array, IntArray]:
    """All hypotheses with most pairings, at least `needed` − 1 of them.

    Returns the number of pairings; decisions (h, m), fits (h, 12) and D² (h,) of the hypotheses; effort (6,). With
    `needed` pairings or more, there are no others with as many but what the gates turn away; with `decisive` ones, no
    others that explain all but (pairings / 3 − 1) of the same measurements: places that look alike.
    """
    store, look = Store(*arrays), _look(scan, locality, gates)
    m = len(look.points)
    found = Found(
        np.full((KEPT, m), NONE),
        np.full((KEPT, FIT), math.nan),
        np.zeros(KEPT),
        np.array([max(needed - 1, 3) - 1, 0]),
        np.zeros(6, np.int64),
        np.array([needed, node_limit, decisive]),
    )
    done = np.zeros(m * (m - 1) * (m - 2) // 6, np.bool_)
    seen_beyond, groups = m, max(m // 5, 1)  # no pose is unseen that explains more than 2 × seen_beyond
    while m > 2 and seen_beyond > _enough(found) and found.spent[LIMIT] == 0 and not _decided(found):
        groups, whole = min(max(groups, _enough(found)), seen_beyond - 1), True
        for triple in _triples(look.points, groups, done):
            try_triple(look, store, triple, found)
            done[_number(triple)] = True
            if found.spent[LIMIT] > 0 or _enough(found) > groups or _decided(found):
                whole = False
                break
        if whole:
            seen_beyond = groups
        groups = (7 * groups) // 10 if found.state[1] == 0 else 1
    if _decided(found):
        _try_places_alike(look, store, found, done)
    count = found.state[1]
    pairings = found.state[0] if count > 0 else 0
    return pairings, found.features[:count], found.fits[:count], found.squares[:count], found.spent


@compiled
def _decided(found: Found) -> bool:
    return bool(found.state[1] > 0 and found.state[0] >= found.limits[2])


@compiled
def _try_places_alike(look: Look, store: Store, found: Found, done: BoolArray) -> None:
    """Look up disjoint triples of what the best explains, until it stays: a place like its own explains one of them."""
    pairings = 0
    while pairings < found.state[0] and found.spent[LIMIT] == 0:
        pairings = found.state[0]
        paired = np.flatnonzero(found.features[0] != NONE)
        order, starts = _groups(look.points[paired], pairings // 3)
        for g in range(pairings // 3):
            triple = paired[order[starts[g] : starts[g] + 3]]
            _longest_first(look.points, triple)
            if not done[_number(triple)] and is_indexed(look, store, triple):
                done[_number(triple)] = True
                try_triple(look, store, triple, found)


@compiled
def _enough(found: Found) -> int:
    """The most groups whose triples leave no better pose unseen, nor another as good."""
    return int(max((max(found.limits[0], found.state[0] if found.state[1] > 0 else 0) - 1) // 2, 1))


@compiled
def _look(scan: tuple[Array, Array, Array], locality: tuple[IntArray, IntArray], gates: Array) -> Look:
    points, covariances, attributes = scan
    noise, widest = np.empty((len(points), 3)), np.empty(len(points))
    for i in range(len(points)):
        noise[i, 0], noise[i, 1], noise[i, 2] = covariances[i, 0, 0], covariances[i, 0, 1], covariances[i, 1, 1]
        widest[i] = largest_variance(noise[i, 0], noise[i, 1], noise[i, 2])
    return Look(points, noise, attributes, widest, gates, locality[0], locality[1])


@compiled
def _number(triple: IntArray) -> int:
    """A number of its own for each set of three measurements."""
    a, b, c = min(triple), max(triple), triple.sum()
    b, c = c - a - b, b
    return int(c * (c - 1) * (c - 2) // 6 + b * (b - 1) // 2 + a)


@compiled
def _groups(points: Array, groups: int) -> tuple[IntArray, IntArray]:
    """Measurements in order of compact groups of nearly equal size, and where each group starts, (groups + 1,).

    The points are cut in two across their longer extent, in proportion to the groups wanted on either side, and so on.
    """
    m = len(points)
    order, starts, parts = np.arange(m), np.zeros(groups + 1, np.int64), np.ones(groups + 1, np.int64)
    starts[1], parts[0], count, at = m, groups, 1, 0
    while at < count:
        if parts[at] == 1:
            at += 1
            continue
        low, high = starts[at], starts[at + 1]
        wide = _extent(points, order[low:high], 0) >= _extent(points, order[low:high], 1)
        axis = 0 if wide else 1
        for p in range(low + 1, high):
            i, q = order[p], p
            while q > low and points[order[q - 1], axis] > points[i, axis]:
                order[q] = order[q - 1]
                q -= 1
            order[q] = i
        for p in range(count, at, -1):
            starts[p + 1], parts[p] = starts[p], parts[p - 1]
        left = parts[at] // 2
        parts[at], parts[at + 1] = left, parts[at + 1] - left
        starts[at + 1] = low + ((high - low) * left + (left + parts[at + 1]) // 2) // (left + parts[at + 1])
        count += 1
    return order, starts


@compiled
def _extent(points: Array, chosen: IntArray, axis: int) -> float:
    low, high = math.inf, -math.inf
    for i in chosen:
        low, high = min(low, points[i, axis]), max(high, points[i, axis])
    return high - low


@compiled
def _triples(points: Array, groups: int, done: BoolArray) -> IntArray:
    """Triples of measurements within groups and not yet `done`, (t, 3): those with small circumcircles first."""
    order, starts = _groups(points, groups)
    room = 0
    for g in range(groups):
        size = starts[g + 1] - starts[g]
        room += size * (size - 1) * (size - 2) // 6
    triples, radii, count = np.empty((room, 3), np.int64), np.empty(room), 0
    for g in range(groups):
        for p in range(starts[g], starts[g + 1]):
            for q in range(starts[g], p):
                for r in range(starts[g], q):
                    triple = triples[count]
                    triple[0], triple[1], triple[2] = order[p], order[q], order[r]
                    if not done[_number(triple)]:
                        radii[count] = _longest_first(points, triple)
                        count += 1
    return triples[:count][np.argsort(radii[:count], kind="mergesort")]


@compiled
def _longest_first(points: Array, triple: IntArray) -> float:
    """Turn a triple of measurements so that it runs counterclockwise; radius [m] of its circumcircle."""
    a, b, c = points[triple[0]], points[triple[1]], points[triple[2]]
    area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    if area < 0.0:
        triple[1], triple[2] = triple[2], triple[1]
    sides = math.hypot(b[0] - a[0], b[1] - a[1]) * math.hypot(c[0] - b[0], c[1] - b[1])
    return float(sides * math.hypot(a[0] - c[0], a[1] - c[1]) / (2.0 * abs(area) + 1e-9))
