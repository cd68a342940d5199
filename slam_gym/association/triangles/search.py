"""The search of a `FeatureIndex`: which triples of measurements are looked up, and when enough have been.

Completeness by pigeonhole: with the measurements in g groups, any 2g + 1 of them have three in one group. So once all
triples within the groups have been looked up, no pose is unseen that explains more than 2g measurements. Of 2g + 2, one
group may do with triples of which any four measurements hold one (Turán's, by and large a third of all). Groups are
compact, since small triangles have few likes: they number n in proportion to the radius of their circumcircle.
"""

from __future__ import annotations

import math

import numpy as np

from slam_gym._arrays import ascending
from slam_gym._compile import compiled
from slam_gym.association.triangles.pose import FIT, Look, Store, StoreArrays
from slam_gym.association.triangles.seeds import is_indexed, try_triple
from slam_gym.association.triangles.store import largest_variance
from slam_gym.association.triangles.verify import ALIKE, ALL, LIMIT, MODE, Found
from slam_gym.types import UNPAIRED, Array, BoolArray, IntArray

_WIDE = 1e12  # [m] put on top of the radius of triples too wide for the index
KEPT = 16  # hypotheses remembered: the best and those that tie with it


@compiled
def search(
    scan: tuple[Array, Array, Array],
    locality: tuple[IntArray, IntArray],
    arrays: StoreArrays,
    gates: Array,
    needed: int,
    decisive: int,
    work_limit: int,
) -> tuple[int, IntArray, Array, Array, IntArray]:
    """All hypotheses with most pairings, at least `needed` − 1 of them.

    Returns the number of pairings; decisions (h, m), fits (h, 12) and D² (h,) of the hypotheses; effort (7,). With
    `needed` pairings or more, there are no others with as many but what the gates turn away; with `decisive` ones, no
    others that explain all but (pairings / 3 − 1) of the same measurements: places that look alike.
    """
    store, look = Store(*arrays), _look(scan, locality, gates)
    m = len(look.points)
    found = Found(
        np.full((KEPT, m), UNPAIRED),
        np.full((KEPT, FIT), math.nan),
        np.zeros(KEPT),
        np.array([max(needed - 1, 3) - 1, 0, ALL]),
        np.zeros(7, np.int64),
        np.array([needed, work_limit, decisive]),
    )
    done = np.zeros(m * (m - 1) * (m - 2) // 6, np.bool_)
    groups, whole, beyond = max(m // 5, 1), m, m  # no pose is unseen that explains more than `beyond`
    while m > 2 and beyond >= _wanted(found) and found.spent[LIMIT] == 0 and not _decided(found):
        groups = min(max(groups, _enough(found)), whole - 1)
        loose = _wanted(found) == 2 * groups + 2
        if _try_groups(look, store, found, groups, loose, done):
            whole, beyond = groups, 2 * groups + loose
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
def _wanted(found: Found) -> int:
    """Pairings of which no pose may be left unseen."""
    return int(max(found.limits[0], found.state[0] if found.state[1] > 0 else 0))


@compiled
def _enough(found: Found) -> int:
    """The most groups whose triples leave no better pose unseen, nor another as good."""
    return max((_wanted(found) - 1) // 2, 1)


@compiled
def _try_groups(look: Look, store: Store, found: Found, groups: int, loose: bool, done: BoolArray) -> bool:
    """Look up all triples within groups; False if that was cut short, since a better hypothesis needs fewer of them."""
    triples, indexed = _triples(look, store, groups, loose, done)
    for t in range(len(triples)):
        for triple in triples[t : t + 1] if t < indexed else _instead_of(look, store, triples[t], found, done):
            try_triple(look, store, triple, found)
            done[_number(triple)] = True
        done[_number(triples[t])] = True
        if found.spent[LIMIT] > 0 or _decided(found) or _enough(found) > groups:
            return False
    return True


@compiled
def _instead_of(look: Look, store: Store, triple: IntArray, found: Found, done: BoolArray) -> IntArray:
    """What to look up instead of a triple too wide for the index: two of it, each time with another third measurement.

    Of m measurements a hypothesis leaves out m − k at most, so of m − k + 1 thirds it has one, whichever two stand for
    the triple with each of them. Only where the index reaches fewer are the features gone through.
    """
    m, count = len(look.points), 0
    thirds, radii, other = np.empty((m, 3), np.int64), np.empty(m), np.empty(3, np.int64)
    for i in range(m):
        if i == triple[0] or i == triple[1] or i == triple[2]:
            continue
        least = math.inf
        for k in range(3):
            other[0], other[1], other[2] = triple[k], triple[(k + 1) % 3], i
            if is_indexed(look, store, other):
                radius = _longest_first(look.points, other)
                if radius < least:
                    thirds[count], radii[count], least = other, radius, radius
        count += least < math.inf
    if count <= m - _wanted(found):
        return triple.copy().reshape(1, 3)
    chosen, number = np.empty((m, 3), np.int64), 0
    for at in ascending(radii[:count])[: m - _wanted(found) + 1]:
        if not done[_number(thirds[at])]:
            chosen[number] = thirds[at]
            number += 1
    return chosen[:number]


@compiled
def _try_places_alike(look: Look, store: Store, found: Found, done: BoolArray) -> None:
    """Look up disjoint triples of what the best explains, until it stays: a place like its own explains one of them."""
    pairings, found.state[MODE] = 0, ALIKE
    while pairings < found.state[0] and found.spent[LIMIT] == 0:
        pairings = found.state[0]
        paired = np.flatnonzero(found.features[0] != UNPAIRED)
        order, starts = _groups(look.points[paired], pairings // 3)
        for g in range(pairings // 3):
            triple = paired[order[starts[g] : starts[g] + 3]]
            _longest_first(look.points, triple)
            if not done[_number(triple)] and is_indexed(look, store, triple):
                done[_number(triple)] = True
                try_triple(look, store, triple, found)


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
def _triples(look: Look, store: Store, groups: int, loose: bool, done: BoolArray) -> tuple[IntArray, int]:
    """Triples of measurements within groups and not yet `done`, (t, 3): those with small circumcircles first.

    Those too wide for the index come last; how many do not is the second result. If `loose`, the last group has only
    triples such that any four of it hold one: in three parts, those within a part and from one part two and one of the
    next.
    """
    order, starts = _groups(look.points, groups)
    room = 0
    for g in range(groups):
        size = starts[g + 1] - starts[g]
        room += size * (size - 1) * (size - 2) // 6
    triples, radii, count, indexed = np.empty((room, 3), np.int64), np.empty(room), 0, 0
    for g in range(groups):
        low, size = starts[g], starts[g + 1] - starts[g]
        for p in range(low, starts[g + 1]):
            for q in range(low, p):
                for r in range(low, q):
                    if loose and g == groups - 1 and not covers(low, size, p, q, r):
                        continue
                    triple = triples[count]
                    triple[0], triple[1], triple[2] = order[p], order[q], order[r]
                    if not done[_number(triple)]:
                        short = is_indexed(look, store, triple)
                        radii[count] = _longest_first(look.points, triple) + (0.0 if short else _WIDE)
                        count, indexed = count + 1, indexed + short
    return triples[:count][ascending(radii[:count])], indexed


@compiled
def covers(low: int, size: int, p: int, q: int, r: int) -> bool:
    """Whether p, q, r lie in one third of low … low + size − 1, or two in one and the other in the next."""
    a, b, c = 3 * (p - low) // size, 3 * (q - low) // size, 3 * (r - low) // size
    if a == b:
        return c == a or c == (a + 1) % 3
    if a == c:
        return b == (a + 1) % 3
    return b == c and a == (b + 1) % 3


@compiled
def _longest_first(points: Array, triple: IntArray) -> float:
    """Turn a triple of measurements so that it runs counterclockwise; radius [m] of its circumcircle."""
    a, b, c = points[triple[0]], points[triple[1]], points[triple[2]]
    area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    if area < 0.0:
        triple[1], triple[2] = triple[2], triple[1]
    sides = math.hypot(b[0] - a[0], b[1] - a[1]) * math.hypot(c[0] - b[0], c[1] - b[1])
    return float(sides * math.hypot(a[0] - c[0], a[1] - c[1]) / (2.0 * abs(area) + 1e-9))
