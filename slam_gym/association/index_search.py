"""The search of a `FeatureIndex`: triples of measurements, map triangles alike, and what they explain of the scan.

Completeness by pigeonhole: with the measurements in g groups, any 2g + 1 of them have three in one group. So once all
triples within the groups have been looked up, no pose is unseen that explains more than 2g measurements. Groups are
compact, since small triangles have few likes: they number n in proportion to the radius of their circumcircle.

A pose found this way is checked against bitmaps first (one bit per measurement: is a feature within its gate?) and
given up as soon as too many measurements find nothing; what is left is paired, fitted and tested (`index_pose`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.index_pose import (
    FIT,
    Look,
    Store,
    StoreArrays,
    alike,
    is_local,
    pair_around,
    settle,
)
from slam_gym.association.index_store import (
    COUNT,
    FEATURES,
    POWER,
    QUANTUM,
    RADIUS,
    REACH,
    SIDE,
    SIZE,
    START,
    TABLE,
    WIDEST,
    Bits,
    Small,
    cell_number,
    features_around,
    largest_variance,
)
from slam_gym.types import NONE, Array, BoolArray, IntArray

KEPT = 16  # hypotheses remembered: the best and those that tie with it
NODES, BINARY, TRIES, LEAVES, JOINT, LIMIT = 0, 1, 2, 3, 4, 5  # of `spent`


class Seed(NamedTuple):
    """A triple of measurements, counterclockwise from its longest side, and the others as seen from its centroid."""

    corners: IntArray  # (3,) its measurements
    sides: Array  # (3,) [m] between corners 0–1, 1–2, 2–0
    doubts: Array  # (3,) [m²] variances of those
    order: IntArray  # (m − 3,) the others, those first whose feature must be nearest to where the pose puts them
    levels: IntArray  # (m,) bitmap that covers the gate of each: 0 fine, 1 coarse, 2 neither
    offsets: Array  # (m, 2) [m] from the centroid, by measurement
    around: Array  # (m, 3) their gates: Σ of the weighted squares of (error · offset), (error × offset) is 1; reach [m]


class Found(NamedTuple):
    """The best hypotheses so far."""

    features: IntArray  # (h, m) map feature paired with each measurement, NONE for `*`
    fits: Array  # (h, 12)
    squares: Array  # (h,) D²
    state: IntArray  # (2,) pairings of the best, or one less than what is worth recording; number of hypotheses
    spent: IntArray  # (6,)
    limits: IntArray  # (3,) pairings needed, most nodes, pairings that chance need not be feared for


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
            _try_triple(look, store, triple, found)
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
            if not done[_number(triple)]:
                done[_number(triple)] = True
                _try_triple(look, store, triple, found)


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


@compiled
def _side(points: Array, noise: Array, i: int, l: int) -> tuple[float, float]:
    """Distance [m] between two measurements, and its variance uᵀ(R_i + R_l)u [m²]."""
    x, y = points[l, 0] - points[i, 0], points[l, 1] - points[i, 1]
    xx, xy, yy = noise[i, 0] + noise[l, 0], noise[i, 1] + noise[l, 1], noise[i, 2] + noise[l, 2]
    square = x * x + y * y
    if square == 0.0:
        return 0.0, xx + yy
    return math.sqrt(square), (x * x * xx + 2.0 * x * y * xy + y * y * yy) / square


@compiled
def _arrange(look: Look, store: Store, triple: IntArray) -> tuple[Seed, float, float]:
    """The seed of a triple, its error variance v [m²] per pairing, and its inertia [m²] about the centroid.

    A pose fitted to three pairings has variance v/3 at their centroid and v/inertia in heading. Measurements are put in
    order of the radius of their gate, given that pose.
    """
    points, m, radius = look.points, len(look.points), store.settings[RADIUS]
    x = (points[triple[0], 0] + points[triple[1], 0] + points[triple[2], 0]) / 3.0
    y = (points[triple[0], 1] + points[triple[1], 1] + points[triple[2], 1]) / 3.0
    offsets, order, levels, gates = np.empty((m, 2)), np.empty(m, np.int64), np.empty(m, np.int64), np.empty(m)
    around = np.empty((m, 3))
    variance, inertia, count = store.settings[WIDEST], 0.0, 0
    for i in range(m):
        offsets[i, 0], offsets[i, 1] = points[i, 0] - x, points[i, 1] - y
    for i in triple:
        inertia += offsets[i, 0] ** 2 + offsets[i, 1] ** 2
        variance = max(variance, store.settings[WIDEST] + look.widest[i])
    for i in range(m):
        if i == triple[0] or i == triple[1] or i == triple[2]:
            continue
        square, near = offsets[i, 0] ** 2 + offsets[i, 1] ** 2 + 1e-12, look.widest[i] + variance / 3.0
        turned = square * variance / (inertia + 1e-12)
        gate = look.gates[1] * (near + turned)
        near += store.settings[WIDEST]
        around[i, 0], around[i, 1] = (
            1.0 / (look.gates[1] * near * square),
            1.0 / (look.gates[1] * (near + turned) * square),
        )
        around[i, 2] = math.sqrt(look.gates[1] * (near + turned))
        levels[i] = 0 if gate <= radius * radius else 1 if gate <= 4.0 * radius * radius else 2
        p = count
        while p > 0 and gates[p - 1] > gate:
            order[p], gates[p] = order[p - 1], gates[p - 1]
            p -= 1
        order[p], gates[p] = i, gate
        count += 1
    return Seed(triple.copy(), np.empty(3), np.empty(3), order[:count], levels, offsets, around), variance, inertia


@compiled
def _try_triple(look: Look, store: Store, triple: IntArray, found: Found) -> None:
    """Look up the map triangles like a triple of measurements, however turned, and verify the poses they imply."""
    found.spent[TRIES] += 1
    seed, variance, inertia = _arrange(look, store, triple)
    if not inertia > 0.0:
        return
    longest, widest = 0.0, 0.0
    for k in range(3):
        side, doubt = _side(look.points, look.noise, triple[k], triple[(k + 1) % 3])
        longest, widest = max(longest, side), max(widest, doubt)
    margin = math.sqrt(look.gates[0] * (2.0 * store.settings[WIDEST] + widest))
    height = _twice_area(look.points, triple) / longest
    indexed = longest + margin <= store.settings[REACH]
    for turn in range(6 if height < 2.0 * margin else 3):
        for k in range(3):
            seed.corners[k] = triple[(turn + k * (1 if turn < 3 else 2)) % 3]
        for k in range(3):
            i, l = seed.corners[k], seed.corners[(k + 1) % 3]
            seed.sides[k], seed.doubts[k] = _side(look.points, look.noise, i, l)
        if indexed and seed.sides[0] + 2.0 * margin >= longest:
            _visit_cells(look, store, seed, variance, inertia, found)
        elif not indexed and seed.sides[0] <= min(seed.sides[1], seed.sides[2]):
            _visit_features(look, store, seed, variance, inertia, margin, found)


@compiled
def _twice_area(points: Array, triple: IntArray) -> float:
    a, b, c = points[triple[0]], points[triple[1]], points[triple[2]]
    return float(abs((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])))


@compiled
def _visit_cells(look: Look, store: Store, seed: Seed, variance: float, inertia: float, found: Found) -> None:
    """Verify the indexed triangles whose sides agree with those of the seed, each within its own gate."""
    found_alike, compared = _matches(
        store.cells,
        store.pool,
        store.settings,
        look.gates[0],
        seed.sides,
        seed.doubts,
    )
    found.spent[BINARY] += compared
    _verify(look, store, seed, found_alike, variance, inertia, found)


@compiled
def _matches(
    cells: Small,
    pool: Small,
    settings: Array,
    gate: float,
    sides: Array,
    doubts: Array,
) -> tuple[Small, int]:
    """Indexed triangles (t, 3) whose sides are within the gate of `sides`, and how many were compared."""
    quantum, reach, variances = settings[QUANTUM], settings[REACH], settings[TABLE:]
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for k in range(3):
        margin = math.sqrt(gate * (doubts[k] + 2.0 * settings[WIDEST]))
        low[k] = max(0, math.floor((sides[k] - margin) / quantum))
        high[k] = math.floor(min(sides[k] + margin, reach) / quantum)
    step = quantum / 256.0
    scale = step * step / gate
    first, second, third = doubts[0] + step * step, doubts[1] + step * step, doubts[2] + step * step  # rounding
    chosen, count, compared = np.empty((64, 3), np.int32), 0, 0
    for c in range(low[0], high[0] + 1):
        for a in range(low[1], min(c, high[1]) + 1):
            row = cell_number(c, a, 0)
            for b in range(max(low[2], c - a - 1), min(c, high[2]) + 1):
                start, entries = int(cells[row + b, START]), int(cells[row + b, COUNT])
                if entries > len(chosen) - count:
                    larger = np.empty((2 * len(chosen) + entries, 3), np.int32)
                    larger[:count] = chosen[:count]
                    chosen = larger
                compared += entries
                x, y = sides[0] / step - 256.0 * c - 0.5, sides[1] / step - 256.0 * a - 0.5
                z = sides[2] / step - 256.0 * b - 0.5
                for at in range(start, start + entries):
                    packed = int(pool[at, 3])
                    dx, dy, dz = x - (packed & 255), y - (packed >> 8 & 255), z - (packed >> 16 & 255)
                    doubt = variances[packed >> 24 & 255]
                    near = (dx * dx * scale <= first + doubt) & (dy * dy * scale <= second + doubt)
                    if near & (dz * dz * scale <= third + doubt):
                        chosen[count, 0], chosen[count, 1], chosen[count, 2] = pool[at, 0], pool[at, 1], pool[at, 2]
                        count += 1
    return chosen[:count], compared


@compiled
def _visit_features(
    look: Look, store: Store, seed: Seed, variance: float, inertia: float, margin: float, found: Found
) -> None:
    """Verify all triangles of the map that agree with the seed, feature by feature: for sides beyond those indexed."""
    positions, n = store.positions, int(store.settings[FEATURES])
    around, beside = np.empty(n, np.int64), np.empty(n, np.int64)
    side, outer = seed.sides[0], seed.sides[0] + margin
    along = (side * side + seed.sides[2] ** 2 - seed.sides[1] ** 2) / (2.0 * side)
    across = math.sqrt(max(seed.sides[2] ** 2 - along * along, 0.0))
    near, one = 2.0 * margin * max(1.0, seed.sides[2] / side), np.empty((1, 3), np.int32)
    for i in range(n):
        x, y = positions[i, 0], positions[i, 1]
        count = features_around(store.heads, store.following, store.settings[SIDE], positions, x, y, outer, around)
        found.spent[BINARY] += count
        for p in range(count):
            j = around[p]
            ux, uy = positions[j, 0] - x, positions[j, 1] - y
            length = math.hypot(ux, uy)
            if j == i or length < side - margin or length == 0.0:
                continue
            cx, cy = x + (along * ux - across * uy) / length, y + (along * uy + across * ux) / length
            thirds = features_around(
                store.heads, store.following, store.settings[SIDE], positions, cx, cy, near, beside
            )
            for q in range(thirds):
                l = beside[q]
                a = math.hypot(positions[l, 0] - positions[j, 0], positions[l, 1] - positions[j, 1])
                b = math.hypot(positions[l, 0] - x, positions[l, 1] - y)
                if l != i and l != j and abs(a - seed.sides[1]) <= margin and abs(b - seed.sides[2]) <= margin:
                    one[0, 0], one[0, 1], one[0, 2] = i, j, l
                    _verify(look, store, seed, one, variance, inertia, found)


@compiled
def _verify(
    look: Look, store: Store, seed: Seed, triangles: Small, variance: float, inertia: float, found: Found
) -> None:
    """Hold the poses that the triangles (t, 3) imply against the whole scan: bitmaps first, then the exact tests."""
    if len(triangles) == 0:
        return
    found.spent[NODES] += len(triangles)
    if found.spent[NODES] > found.limits[1]:
        found.spent[LIMIT] = 1
        return
    left = len(look.points) - found.state[0] - (found.state[1] == 0)
    chosen, poses = _promising(
        store.positions,
        store.heads,
        store.following,
        store.bits,
        store.settings,
        seed.corners,
        seed.order,
        seed.levels,
        seed.offsets,
        seed.around,
        triangles,
        left,
    )
    for at in range(len(chosen)):
        _examine(look, store, seed, triangles[chosen[at]], poses[at], variance, inertia, found)


@compiled
def _promising(
    positions: Array,
    heads: Small,
    following: Small,
    bits: Bits,
    settings: Array,
    corners: IntArray,
    order: IntArray,
    levels: IntArray,
    offsets: Array,
    around: Array,
    triangles: Small,
    allowed: int,
) -> tuple[IntArray, Array]:
    """Which triangles imply a pose at which no more than `allowed` measurements find nothing; those poses (x, y, c, s).

    The pose is the least-squares fit of the three corners, given as that of their centroid.
    """
    chosen, poses, count = np.empty(len(triangles), np.int64), np.empty((len(triangles), 4)), 0
    power, per_metre = int(settings[POWER]), 1.0 / settings[SIZE]
    behind = 1 << (2 * power)  # the coarse bitmap follows the fine one
    u, v = np.empty(3), np.empty(3)
    for k in range(3):
        u[k], v[k] = offsets[corners[k], 0], offsets[corners[k], 1]
    for at in range(len(triangles)):
        i, j, l = int(triangles[at, 0]), int(triangles[at, 1]), int(triangles[at, 2])
        ax, ay, bx, by = positions[i, 0], positions[i, 1], positions[j, 0], positions[j, 1]
        cx, cy = positions[l, 0], positions[l, 1]
        x, y = (ax + bx + cx) / 3.0, (ay + by + cy) / 3.0
        c = (ax - x) * u[0] + (ay - y) * v[0] + (bx - x) * u[1] + (by - y) * v[1] + (cx - x) * u[2] + (cy - y) * v[2]
        s = (ay - y) * u[0] - (ax - x) * v[0] + (by - y) * u[1] - (bx - x) * v[1] + (cy - y) * u[2] - (cx - x) * v[2]
        length = math.sqrt(c * c + s * s)
        c, s, left, missing = c / length, s / length, allowed, 0
        for p in range(min(len(order), 62)):
            k = order[p]
            px, py = x + c * offsets[k, 0] - s * offsets[k, 1], y + s * offsets[k, 0] + c * offsets[k, 1]
            if levels[k] == 0:
                miss = 1 - _painted(bits, 0, power, px * per_metre, py * per_metre)
            elif levels[k] == 1:
                miss = 1 - _painted(bits, behind, power - 1, 0.5 * px * per_metre, 0.5 * py * per_metre)
            else:
                miss = 0
            left, missing = left - miss, missing | miss << p
            if left < 0:
                break
        if left >= 0 and _meets(
            positions, heads, following, settings, order, offsets, around, (x, y, c, s), missing, left
        ):
            chosen[count] = at
            poses[count, 0], poses[count, 1], poses[count, 2], poses[count, 3] = x, y, c, s
            count += 1
    return chosen[:count], poses[:count]


@compiled
def _meets(
    positions: Array,
    heads: Small,
    following: Small,
    settings: Array,
    order: IntArray,
    offsets: Array,
    around: Array,
    pose: tuple[float, float, float, float],
    missing: int,
    allowed: int,
) -> bool:
    """Whether no more than `allowed` of the measurements in `order` miss every feature at a pose.

    Those whose bits are set in `missing`, by place in `order`, are known to miss and counted already.

    Gates are ellipses here, long across the line of sight from the seed, since its heading is what is least known.
    """
    x, y, c, s = pose
    side, mask, left = settings[SIDE], len(heads) - 1, allowed
    for p in range(len(order)):
        if missing >> min(p, 62) & 1:
            continue
        k = order[p]
        u, v = c * offsets[k, 0] - s * offsets[k, 1], s * offsets[k, 0] + c * offsets[k, 1]
        px, py, reach = x + u, y + v, around[k, 2]
        bottom, lowest = math.floor((py - reach) / side), math.floor((px - reach) / side)
        rows = min(math.floor((py + reach) / side) - bottom, mask) + 1
        columns = min(math.floor((px + reach) / side) - lowest, mask) + 1
        met = False
        for row in range(bottom, bottom + rows):
            for column in range(lowest, lowest + columns):
                j = int(heads[row & mask, column & mask])
                while j >= 0:
                    dx, dy = positions[j, 0] - px, positions[j, 1] - py
                    radial, across = dx * u + dy * v, dy * u - dx * v
                    met |= radial * radial * around[k, 0] + across * across * around[k, 1] < 1.0
                    j = int(following[j])
        left -= not met
        if left < 0:
            return False
    return True


@compiled
def _painted(bits: Bits, first: int, power: int, x: float, y: float) -> int:
    mask = (1 << power) - 1
    at = first + (((math.floor(y) & mask) << power) | (math.floor(x) & mask))
    return (int(bits[at >> 3]) >> (at & 7)) & 1


@compiled
def _examine(
    look: Look,
    store: Store,
    seed: Seed,
    features: Small,
    pose: Array,
    variance: float,
    inertia: float,
    found: Found,
) -> None:
    """Pair, fit and test around a pose that passed the bitmaps, and record what is as good as the best or better."""
    m, corners = len(look.points), seed.corners
    for k in range(3):
        if not _may_pair(look, store, corners[k], features[k], features[0]):
            return
    for h in range(found.state[1]):
        best = found.features[h]
        if best[corners[0]] == features[0] and best[corners[1]] == features[1] and best[corners[2]] == features[2]:
            return
    fit, decisions, squares = np.zeros(FIT), np.empty(m, np.int64), np.empty(m)
    fit[:4] = pose
    fit[4] = look.points[corners[0], 0] - seed.offsets[corners[0], 0]
    fit[5] = look.points[corners[0], 1] - seed.offsets[corners[0], 1]
    fit[6] = fit[8] = variance / 3.0
    fit[11] = variance / inertia
    wanted = found.state[0] + (found.state[1] == 0)
    if pair_around(look, store, fit, features[0], wanted, decisions, squares) == 0:
        return
    for k in range(3):
        decisions[corners[k]] = features[k]
    found.spent[LEAVES] += 1
    pairings, square = settle(look, store, features[0], wanted, decisions, fit, found.spent)
    if pairings >= wanted:
        _record(found, decisions, fit, square, pairings)


@compiled
def _may_pair(look: Look, store: Store, i: int, j: int, anchor: int) -> bool:
    same = alike(look.attributes, i, store.details, j, look.gates[0])
    return same and is_local(look.local_starts, look.local, anchor, j)


@compiled
def _record(found: Found, decisions: IntArray, fit: Array, square: float, pairings: int) -> None:
    """Keep a hypothesis that beats the best, or ties with it at another pose: one that shares at most one pairing."""
    count = found.state[1]
    at = count
    if count > 0 and pairings > found.state[0]:
        count = at = 0
    for h in range(count):
        shared = 0
        for i in range(len(decisions)):
            shared += decisions[i] != NONE and decisions[i] == found.features[h, i]
        if shared >= 2:
            if square >= found.squares[h]:
                return
            at = h
            break
    if at >= len(found.squares):
        return
    found.features[at], found.fits[at], found.squares[at] = decisions, fit, square
    found.state[0], found.state[1] = pairings, max(count, at + 1)
