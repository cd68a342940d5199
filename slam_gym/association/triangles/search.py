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
_WIDE_COSTS = 20.0  # times as much as the others
_MOVES = 200  # attempts to move a measurement to another group
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
    order, starts = _near_groups(look, store, groups)
    triples, indexed = _triples(look, store, order, starts, loose, done)
    for t in range(len(triples)):
        triple, pairs = triples[t], np.empty((0, 4), np.int64)
        if t >= indexed:
            pairs = _instead_of(look, store, triple, order, starts, loose)
        for other in pairs:
            try_triple(look, store, other[:3], found, other[3])
        if len(pairs) == 0:
            try_triple(look, store, triple, found)
            done[_number(triple)] = True
        if found.spent[LIMIT] > 0 or _decided(found) or _enough(found) > groups:
            return False
    return True


@compiled
def _instead_of(look: Look, store: Store, triple: IntArray, order: IntArray, starts: IntArray, loose: bool) -> IntArray:
    """What to look up instead of a triple too wide for the index: two of it, each time with another third measurement.

    Returns these triples and which measurement of the wide one each leaves out, (t, 4); none where the index does not
    reach enough of them.

    The groups were cut in two again and again. Of two halves with g and h groups, one holds 2g + 1 or 2h + 1
    measurements of a hypothesis with 2(g + h) + 1, and so on down to a group with 3: it is enough to look triples up
    for hypotheses of which all halves on the way down hold as many. In a half of s measurements, s − 2g − 1 at most are
    no part of the hypothesis, so that of s − 2g of them, besides the triple, one is: whichever two stand for the triple
    with each of these. Among the halves on the way, that with the smallest of such triples is chosen.
    """
    groups, least, best = len(starts) - 1, math.inf, np.empty((0, 4), np.int64)
    low, high, leaf = 0, groups, 0
    while not np.any(order[starts[leaf] : starts[leaf + 1]] == triple[0]):
        leaf += 1
    while True:
        quota = 2 * (high - low) + 1 + (loose and high == groups)
        chosen, radius = _thirds(look, store, triple, order[starts[low] : starts[high]], quota)
        if len(chosen) > 0 and radius <= least:
            best, least = chosen, radius
        if high - low == 1:
            return best
        middle = low + (high - low) // 2
        low, high = (low, middle) if leaf < middle else (middle, high)


@compiled
def _thirds(look: Look, store: Store, triple: IntArray, some: IntArray, quota: int) -> tuple[IntArray, float]:
    """As many triples (t, 4), as in `_instead_of`, as it takes with thirds from `some` measurements, of which `quota`
    are paired, and the sum of their radii [m]; none where there are too few."""
    count, needed = 0, len(some) - quota + 1
    thirds, radii, other = np.empty((len(some), 4), np.int64), np.empty(len(some)), np.empty(3, np.int64)
    for i in some:
        if i == triple[0] or i == triple[1] or i == triple[2]:
            continue
        least = math.inf
        for k in range(3):
            other[0], other[1], other[2] = triple[k], triple[(k + 1) % 3], i
            if is_indexed(look, store, other):
                radius = _longest_first(look.points, other)
                if radius < least:
                    thirds[count, :3], thirds[count, 3] = other, triple[(k + 2) % 3]
                    radii[count] = least = radius
        count += least < math.inf
    if count < needed:
        return thirds[:0], 0.0
    chosen = ascending(radii[:count])[:needed]
    return thirds[chosen], radii[chosen].sum()


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
def _near_groups(look: Look, store: Store, groups: int) -> tuple[IntArray, IntArray]:
    """As `_groups`, but measurements change places, or groups, as long as that leaves fewer triples too wide."""
    order, starts = _groups(look.points, groups)
    m, group, count = len(order), np.empty(len(order), np.int64), 0
    wide, pair = np.zeros((m, m), np.bool_), np.empty(3, np.int64)
    for g in range(groups):
        group[order[starts[g] : starts[g + 1]]] = g
    for within in (True, False):  # as a rule there are none within groups, and nothing is left to do
        for i in range(m):
            for k in range(i):
                pair[0], pair[1], pair[2] = i, k, k
                if (group[i] == group[k]) == within and not is_indexed(look, store, pair):
                    wide[i, k] = wide[k, i] = True
                    count += within
        if count == 0:
            return order, starts
    left, i = _MOVES, 0
    while i < m and left > 0:
        left -= 1
        i = 0 if np.any(wide[i] & (group == group[i])) and _moves(group, groups, wide, i) else i + 1
    for g in range(groups):
        members = np.flatnonzero(group == g)
        starts[g + 1] = starts[g] + len(members)
        order[starts[g] : starts[g + 1]] = members
    return order, starts


@compiled
def _moves(group: IntArray, groups: int, wide: BoolArray, i: int) -> bool:
    """Move measurement i to another group, or let it change places with one of there, if that costs less."""
    of = group[i]
    before = _cost(group, of, wide)
    for g in range(groups):
        both = before + (_cost(group, g, wide) if g != of else 0.0)
        for k in range(-1, len(group) if g != of else -1):  # −1: for nothing in exchange
            if k >= 0 and group[k] != g:
                continue
            group[i] = g
            if k >= 0:
                group[k] = of
            if _cost(group, of, wide) + _cost(group, g, wide) < both:
                return True
            group[i] = of
            if k >= 0:
                group[k] = g
    return False


@compiled
def _cost(group: IntArray, g: int, wide: BoolArray) -> float:
    """Of looking up the triples of one group, in units of one that the index reaches."""
    members, cost = np.flatnonzero(group == g), 0.0
    for p in range(len(members)):
        for q in range(p):
            for r in range(q):
                i, k, l = members[p], members[q], members[r]
                cost += _WIDE_COSTS if wide[i, k] or wide[k, l] or wide[l, i] else 1.0
    return cost


@compiled
def _extent(points: Array, chosen: IntArray, axis: int) -> float:
    low, high = math.inf, -math.inf
    for i in chosen:
        low, high = min(low, points[i, axis]), max(high, points[i, axis])
    return high - low


@compiled
def _triples(
    look: Look, store: Store, order: IntArray, starts: IntArray, loose: bool, done: BoolArray
) -> tuple[IntArray, int]:
    """Triples of measurements within groups and not yet `done`, (t, 3): those with small circumcircles first.

    Those too wide for the index come last; how many do not is the second result. If `loose`, the last group has only
    triples such that any four of it hold one: in three parts, those within a part and from one part two and one of the
    next.
    """
    groups, room = len(starts) - 1, 0
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
