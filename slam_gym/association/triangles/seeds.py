"""Seeds: the triangles of the map that look like a triple of measurements, by the index or feature by feature."""

from __future__ import annotations

import math

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.triangles.pose import Look, Store
from slam_gym.association.triangles.store import (
    COUNT,
    FEATURES,
    QUANTUM,
    RADIUS,
    REACH,
    SIDE,
    START,
    TABLE,
    WIDEST,
    Small,
    cell_number,
    features_around,
    features_between,
)
from slam_gym.association.triangles.verify import AT_ONCE, BINARY, LIMIT, TRIES, Found, Seed, spend, verify
from slam_gym.types import UNPAIRED, Array, IntArray

_PLACES = 8  # of a bitmap that are looked up for one measurement, at most
_PER_TRIANGLE, _PER_FEATURE = 0.02, 0.25
"""Poses that take as long as the comparison of a triangle of the index, and as the look at a feature without it."""


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
def _arrange(look: Look, store: Store, triple: IntArray, first: int) -> tuple[Seed, float, float]:
    """The seed of a triple, its error variance v [m²] per pairing, and its inertia [m²] about the centroid.

    A pose fitted to three pairings has variance v/3 at their centroid and v/inertia in heading. Measurements are put in
    order of the radius of their gate, given that pose, but for measurement `first`, if it is one.
    """
    points, m = look.points, len(look.points)
    x = (points[triple[0], 0] + points[triple[1], 0] + points[triple[2], 0]) / 3.0
    y = (points[triple[0], 1] + points[triple[1], 1] + points[triple[2], 1]) / 3.0
    offsets, order, gates, around = np.empty((m, 2)), np.empty(m, np.int64), np.empty(m), np.empty((m, 3))
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
        turned, gate = square * variance / (inertia + 1e-12), look.gates[1]
        wide = near + store.settings[WIDEST]
        around[i, 0], around[i, 1] = 1.0 / (gate * wide * square), 1.0 / (gate * (wide + turned) * square)
        around[i, 2] = math.sqrt(gate * (wide + turned))
        p = count
        while p > 0 and (gates[p - 1] > near + turned or i == first) and order[p - 1] != first:
            order[p], gates[p] = order[p - 1], gates[p - 1]
            p -= 1
        order[p], gates[p] = i, near + turned
        count += 1
    starts, places, levels = _places(look, offsets, order[:count], gates, variance, store.settings[RADIUS])
    seed = Seed(triple.copy(), np.empty(3), np.empty(3), order[:count], starts, places, levels, offsets, around)
    return seed, variance, inertia


@compiled
def _places(
    look: Look, offsets: Array, order: IntArray, gates: Array, variance: float, radius: float
) -> tuple[IntArray, Array, IntArray]:
    """Where to look into the bitmaps for each measurement in `order`: starts, places and levels of a `Seed`.

    A gate's semi-axes squared, its feature known exactly, are `narrow` along the line of sight from the centroid and
    `wide` across it. Discs of radius r in a row across, at most 2√(r² − narrow) apart, cover all of it but what is
    beyond √wide − r. Discs of features less well known are painted larger by as much as it takes. There are no places
    where neither bitmap does with `_PLACES`.
    """
    count, chi2 = 0, look.gates[1]
    starts, places = np.zeros(len(order) + 1, np.int64), np.zeros((2, _PLACES * len(order) + AT_ONCE))
    levels = np.zeros(_PLACES * len(order) + AT_ONCE, np.int64)
    for p in range(len(order)):
        k = order[p]
        narrow, wide = chi2 * (look.widest[k] + variance / 3.0), math.sqrt(chi2 * gates[p])
        for level in range(2):
            r = radius * (1.0 + level)
            end, half = max(wide - r, 0.0), math.sqrt(max(r * r - narrow, 0.0))
            if end > half * (_PLACES - 1):
                continue
            number = 1 if end == 0.0 else 1 + math.ceil(end / half)
            x, y = offsets[k, 0], offsets[k, 1]
            turn = end / math.sqrt(x * x + y * y) if number > 1 else 0.0
            for i in range(number):
                part = turn * (2.0 * i / max(number - 1, 1) - 1.0)
                places[0, count], places[1, count], levels[count] = x - part * y, y + part * x, level
                count += 1
            break
        starts[p + 1] = count
    return starts, places, levels


@compiled
def is_indexed(look: Look, store: Store, triple: IntArray) -> bool:
    """Whether the triangles like a triple, as far as its gates reach, are all short enough for the index."""
    longest, widest = 0.0, 0.0
    for k in range(3):
        side, doubt = _side(look.points, look.noise, triple[k], triple[(k + 1) % 3])
        longest, widest = max(longest, side), max(widest, doubt)
    return bool(longest + math.sqrt(look.gates[0] * (2.0 * store.settings[WIDEST] + widest)) <= store.settings[REACH])


@compiled
def try_triple(look: Look, store: Store, triple: IntArray, found: Found, required: int = UNPAIRED) -> None:
    """Look up the map triangles like a triple of measurements, however turned, and verify the poses they imply.

    Poses that explain nothing of measurement `required`, if it is one, are not looked at any further.
    """
    found.spent[TRIES] += 1
    seed, variance, inertia = _arrange(look, store, triple, required)
    if not inertia > 0.0:
        return
    longest, widest = 0.0, 0.0
    for k in range(3):
        side, doubt = _side(look.points, look.noise, triple[k], triple[(k + 1) % 3])
        longest, widest = max(longest, side), max(widest, doubt)
    margin = math.sqrt(look.gates[0] * (2.0 * store.settings[WIDEST] + widest))
    height = _twice_area(look.points, triple) / longest
    indexed = is_indexed(look, store, triple)
    for turn in range(6 if height < 2.0 * margin else 3):
        for k in range(3):
            seed.corners[k] = triple[(turn + k * (1 if turn < 3 else 2)) % 3]
        for k in range(3):
            i, l = seed.corners[k], seed.corners[(k + 1) % 3]
            seed.sides[k], seed.doubts[k] = _side(look.points, look.noise, i, l)
        if indexed and seed.sides[0] + 2.0 * margin >= longest:
            like, compared = _matches(store.cells, store.pool, store.settings, look.gates[0], seed.sides, seed.doubts)
            spend(found, BINARY, compared, _PER_TRIANGLE * compared)
            verify(look, store, seed, like, variance, inertia, found, required != UNPAIRED)
        elif not indexed and seed.sides[0] <= min(seed.sides[1], seed.sides[2]):
            _visit_features(look, store, seed, variance, inertia, margin, found)


@compiled
def _twice_area(points: Array, triple: IntArray) -> float:
    a, b, c = points[triple[0]], points[triple[1]], points[triple[2]]
    return float(abs((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])))


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
                if entries >= len(chosen) - count:
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
                    chosen[count, 0], chosen[count, 1], chosen[count, 2] = pool[at, 0], pool[at, 1], pool[at, 2]
                    count += near & (dz * dz * scale <= third + doubt)  # without a branch: there is no foretelling it
    return chosen[:count], compared


@compiled
def _visit_features(
    look: Look, store: Store, seed: Seed, variance: float, inertia: float, margin: float, found: Found
) -> None:
    """Verify all triangles of the map that agree with the seed, feature by feature: for sides beyond those indexed."""
    positions, n = store.positions, int(store.settings[FEATURES])
    around, beside, grid = np.empty(n, np.int64), np.empty(n, np.int64), store.settings[SIDE]
    side = seed.sides[0]
    inner, outer = max(side - margin, 0.0), side + margin
    along = (side * side + seed.sides[2] ** 2 - seed.sides[1] ** 2) / (2.0 * side)
    across = math.sqrt(max(seed.sides[2] ** 2 - along * along, 0.0))
    near, one = 2.0 * margin * max(1.0, seed.sides[2] / side), np.empty((1, 3), np.int32)
    for i in range(n):
        if found.spent[LIMIT] > 0:
            return
        x, y = positions[i, 0], positions[i, 1]
        count, compared = features_between(store.heads, store.following, grid, positions, i, inner, outer, around)
        spend(found, BINARY, compared, _PER_FEATURE * compared)
        for p in range(count):
            j = around[p]
            ux, uy = positions[j, 0] - x, positions[j, 1] - y
            length = math.hypot(ux, uy)
            if length == 0.0:
                continue
            cx, cy = x + (along * ux - across * uy) / length, y + (along * uy + across * ux) / length
            thirds = features_around(store.heads, store.following, grid, positions, cx, cy, near, beside)
            for q in range(thirds):
                l = beside[q]
                a = math.hypot(positions[l, 0] - positions[j, 0], positions[l, 1] - positions[j, 1])
                b = math.hypot(positions[l, 0] - x, positions[l, 1] - y)
                if l != i and l != j and abs(a - seed.sides[1]) <= margin and abs(b - seed.sides[2]) <= margin:
                    one[0, 0], one[0, 1], one[0, 2] = i, j, l
                    verify(look, store, seed, one, variance, inertia, found, False)
