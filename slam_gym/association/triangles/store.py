"""What a `FeatureIndex` remembers: features in a grid, triangles of near features in cells of their sides, two bitmaps.

A triangle of features is written once, counterclockwise and longest side first: vertices A, B, C with sides
c = |AB| ≥ a = |BC|, b = |CA|. A mirror image runs clockwise, so it is found under other sides or not at all. Cells
(⌊c/q⌋, ⌊a/q⌋, ⌊b/q⌋) of a quantum q hold the triangles in one stretch of a pool each, with room to grow; a full stretch
moves to the end of the pool.

Grid and bitmaps wrap around: cell (x, y) is stored at (x mod W, y mod W), with W² in proportion to the number of
features. Memory then depends on that number only, not on how far the map reaches; what falls onto the same place from
far away is told apart by its position, or costs a false alarm that a later test finds out.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from slam_gym._compile import compiled
from slam_gym.types import Array, IntArray

Small = NDArray[np.int32]
Bits = NDArray[np.uint32]

START, COUNT, ROOM, CODE = 0, 1, 2, 3  # columns of `cells` (c, 4): stretch of the pool; largest code of σ in it
SIDE, REACH, QUANTUM, BUDGET, SIZE, RADIUS, WIDEST, FEATURES, POWER = 0, 1, 2, 3, 4, 5, 6, 7, 8
TABLE = 16
"""Entries of `settings`: side of the grid [m], longest side of triangles [m], quantum q [m], triangles allowed per
feature, cell [m] and radius [m] of the fine bitmap, largest λ(C_j) [m²], number of features, log₂ of the fine bitmap's
side; from TABLE on, the variances that codes stand for."""

CODES = 256
CROWD = 4096  # features around one that are looked at; triangles run out long before
FINEST = 1e-4  # [m] σ of code 0; each code is 5 % larger than the one before, the last 25 m
STEP = 1.05


def sigma_table() -> Array:
    """(256,) [m²] variance that each code stands for."""
    variances: Array = (FINEST * STEP ** np.arange(CODES, dtype=np.float64)) ** 2
    return variances


def number_of_cells(reach: float, quantum: float) -> int:
    """Cells of triangles whose sides are all up to `reach`."""
    levels = math.floor(reach / quantum) + 1
    return levels * (levels + 1) * (2 * levels + 1) // 6


@compiled
def cell_number(c: int, a: int, b: int) -> int:
    """Number of cell (c, a, b) with a, b ≤ c: those of smaller c come first."""
    return c * (c + 1) * (2 * c + 1) // 6 + a * (c + 1) + b


@compiled
def paint(bits: Bits, power: int, size: float, x: float, y: float, radius: float) -> None:
    """Set the bits of all cells of `size` [m] that a disc touches, in a bitmap of side 2^power."""
    mask = (1 << power) - 1
    bottom, top = math.floor((y - radius) / size), math.floor((y + radius) / size)
    for row in range(bottom, min(top, bottom + mask) + 1):
        dy = max(row * size - y, y - (row + 1) * size, 0.0)
        half = math.sqrt(max(radius * radius - dy * dy, 0.0))
        left, right = math.floor((x - half) / size), math.floor((x + half) / size)
        for column in range(left, min(right, left + mask) + 1):
            at = bit_number(column & mask, row & mask, power)
            bits[at >> 5] |= np.uint32(1 << (at & 31))


@compiled
def bit_number(column: int, row: int, power: int) -> int:
    """Place of a cell in a bitmap of side 2^power: by tiles of 16 words of 32 cells, a cache line each."""
    return (row >> 4) << (power + 4) | (column >> 5) << 9 | (row & 15) << 5 | (column & 31)


@compiled
def paint_features(
    bits: Bits,
    power: int,
    size: float,
    radius: float,
    gate: float,
    positions: Array,
    details: Array,
    first: int,
    n: int,
) -> None:
    """Paint features first … n−1: discs of √(radius² + gate·λ) with λ the largest variance of each in any direction."""
    for j in range(first, n):
        wide = math.sqrt(radius * radius + gate * largest_variance(details[j, 0], details[j, 1], details[j, 2]))
        paint(bits, power, size, positions[j, 0], positions[j, 1], wide)


@compiled
def largest_variance(xx: float, xy: float, yy: float) -> float:
    """Largest eigenvalue of the covariance [[xx, xy], [xy, yy]]."""
    return 0.5 * (xx + yy) + math.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)


@compiled
def largest_spread(details: Array, first: int, n: int) -> float:
    """Largest λ(C_j) of features first … n−1."""
    widest = 0.0
    for j in range(first, n):
        widest = max(widest, largest_variance(details[j, 0], details[j, 1], details[j, 2]))
    return widest


@compiled
def enter_grid(heads: Small, following: Small, side: float, positions: Array, first: int, n: int) -> None:
    """Chain features first … n−1 into the grid of (W, W) cells of `side` [m]."""
    mask = len(heads) - 1
    for j in range(first, n):
        row, column = math.floor(positions[j, 1] / side) & mask, math.floor(positions[j, 0] / side) & mask
        following[j], heads[row, column] = heads[row, column], j


@compiled
def features_around(
    heads: Small, following: Small, side: float, positions: Array, x: float, y: float, radius: float, found: IntArray
) -> int:
    """Write the features within `radius` [m] of (x, y) into `found`, as far as it has room; return how many."""
    mask, count = len(heads) - 1, 0
    bottom, left = math.floor((y - radius) / side), math.floor((x - radius) / side)
    rows = min(math.floor((y + radius) / side) - bottom, mask) + 1
    columns = min(math.floor((x + radius) / side) - left, mask) + 1
    for row in range(bottom, bottom + rows):
        for column in range(left, left + columns):
            j = int(heads[row & mask, column & mask])
            while j >= 0:
                dx, dy = positions[j, 0] - x, positions[j, 1] - y
                if dx * dx + dy * dy <= radius * radius and count < len(found):
                    found[count] = j
                    count += 1
                j = int(following[j])
    return count


@compiled
def features_between(
    heads: Small, following: Small, side: float, positions: Array, i: int, inner: float, outer: float, found: IntArray
) -> tuple[int, int]:
    """Write the features whose distance to feature i is from `inner` to `outer` [m] into `found`, which has room for
    all; returns how many, and how many were looked at."""
    mask, count, compared, x, y = len(heads) - 1, 0, 0, positions[i, 0], positions[i, 1]
    bottom, left = math.floor((y - outer) / side), math.floor((x - outer) / side)
    rows = min(math.floor((y + outer) / side) - bottom, mask) + 1
    columns = min(math.floor((x + outer) / side) - left, mask) + 1
    low, high = inner * inner, outer * outer
    whole = rows <= mask and columns <= mask  # no cell stands for several places
    for row in range(bottom, bottom + rows):
        dy = max(abs(row * side - y), abs((row + 1) * side - y))
        for column in range(left, left + columns):
            dx = max(abs(column * side - x), abs((column + 1) * side - x))
            if whole and dx * dx + dy * dy < low:  # all of the cell is too near
                continue
            j = int(heads[row & mask, column & mask])
            while j >= 0:
                square, compared = (positions[j, 0] - x) ** 2 + (positions[j, 1] - y) ** 2, compared + 1
                if low <= square <= high and j != i:
                    found[count] = j
                    count += 1
                j = int(following[j])
    return count, compared


@compiled
def side_code(details: Array, j: int, l: int, dx: float, dy: float) -> int:
    """Code of the standard deviation of the distance between two features, rounded up."""
    xx, xy, yy = details[j, 0] + details[l, 0], details[j, 1] + details[l, 1], details[j, 2] + details[l, 2]
    square = dx * dx + dy * dy
    variance = (dx * dx * xx + 2.0 * dx * dy * xy + dy * dy * yy) / square if square > 0.0 else xx + yy
    if not variance > FINEST * FINEST:
        return 0
    return min(CODES - 1, math.ceil(0.5 * math.log(variance / (FINEST * FINEST)) / math.log(STEP)))


@compiled
def place_of(positions: Array, j: int, k: int, l: int, quantum: float) -> tuple[int, int, int, int, int]:
    """(A, B, C, cell, fractions of q of the three sides in 8 bits each) of the triangle of three features."""
    jx, jy, kx, ky = positions[j, 0], positions[j, 1], positions[k, 0], positions[k, 1]
    lx, ly = positions[l, 0], positions[l, 1]
    if (kx - jx) * (ly - jy) - (ky - jy) * (lx - jx) < 0.0:
        k, l, kx, ky, lx, ly = l, k, lx, ly, kx, ky
    c, a, b = math.hypot(kx - jx, ky - jy), math.hypot(lx - kx, ly - ky), math.hypot(jx - lx, jy - ly)
    if a > c and a >= b:
        j, k, l, c, a, b = k, l, j, a, b, c
    elif b > c:
        j, k, l, c, a, b = l, j, k, b, c, a
    c, a, b = c / quantum, a / quantum, b / quantum
    fractions = int(256.0 * (c - int(c))) | int(256.0 * (a - int(a))) << 8 | int(256.0 * (b - int(b))) << 16
    return j, k, l, cell_number(int(c), int(a), int(b)), fractions


@compiled
def append(cells: Small, pool: Small, used: int, place: tuple[int, int, int, int, int], code: int) -> int:
    """Add one triangle to its cell; returns the part of the pool then in use, or −1 where it is too small."""
    a, b, c, cell, fractions = place
    count = int(cells[cell, COUNT])
    if count == cells[cell, ROOM]:
        room, start = count + (count >> 2) + 2, int(cells[cell, START])
        if used + room > len(pool):
            return -1
        for i in range(count):
            for field in range(4):
                pool[used + i, field] = pool[start + i, field]
        cells[cell, START], cells[cell, ROOM] = used, room
        used += room
    at = cells[cell, START] + count
    pool[at, 0], pool[at, 1], pool[at, 2], pool[at, 3] = a, b, c, np.int32(np.uint32(fractions | code << 24))
    cells[cell, COUNT], cells[cell, CODE] = count + 1, max(code, int(cells[cell, CODE]))
    return used


@compiled
def move_pool(cells: Small, pool: Small, larger: Small) -> int:
    """Copy all stretches one after another, with an eighth of room to grow; returns the part in use."""
    used = 0
    for cell in range(len(cells)):
        start, count = int(cells[cell, START]), int(cells[cell, COUNT])
        for i in range(count):
            for field in range(4):
                larger[used + i, field] = pool[start + i, field]
        room = count + (count >> 3) + 1 if count > 0 else 0
        cells[cell, START], cells[cell, ROOM] = used, room
        used += room
    return used


@compiled
def keep_triangles(cells: Small, pool: Small, renumbered: IntArray) -> int:
    """Drop the triangles of removed features (renumbered −1), renumber the others; returns how many stay."""
    total = 0
    for cell in range(len(cells)):
        start, kept = int(cells[cell, START]), 0
        for i in range(start, start + cells[cell, COUNT]):
            a, b, c = renumbered[pool[i, 0]], renumbered[pool[i, 1]], renumbered[pool[i, 2]]
            if a >= 0 and b >= 0 and c >= 0:
                at = start + kept
                pool[at, 0], pool[at, 1], pool[at, 2], pool[at, 3] = a, b, c, pool[i, 3]
                kept += 1
        cells[cell, COUNT] = kept
        total += kept
    return total


@compiled
def _by_distance(positions: Array, f: int, near: IntArray, count: int, distances: Array) -> None:
    """Sort the first `count` of `near` by distance to feature f, ties by number."""
    for p in range(count):
        j = near[p]
        square = (positions[j, 0] - positions[f, 0]) ** 2 + (positions[j, 1] - positions[f, 1]) ** 2
        q = p
        while q > 0 and (distances[q - 1] > square or (distances[q - 1] == square and near[q - 1] > j)):
            near[q], distances[q] = near[q - 1], distances[q - 1]
            q -= 1
        near[q], distances[q] = j, square


@compiled
def enter_triangles(
    cells: Small,
    pool: Small,
    heads: Small,
    following: Small,
    positions: Array,
    details: Array,
    settings: Array,
    progress: IntArray,
    n: int,
    fitted: int,
) -> None:
    """Enter features up to n − 1 into the grid, each with its triangles with earlier features, nearest ones first.

    On average they have as many as the settings allow at most, at any time; the first `fitted` of them, for which the
    reach was chosen, only all together, so that those that crowd take what others leave.

    progress: next feature, its triangles already done, triangles, features some of whose triangles were left out, part
    of the pool in use. Returns early, before the next feature is n, where the pool is full: to be called again with a
    larger one.
    """
    side, reach, quantum = settings[SIDE], settings[REACH], settings[QUANTUM]
    near, distances = np.empty(min(n, CROWD), np.int64), np.empty(min(n, CROWD))
    while progress[0] < n:
        f, number, skip = progress[0], 0, progress[1]
        allowed = int(settings[BUDGET] * max(f + 1, fitted)) - progress[2] + skip
        count = features_around(heads, following, side, positions, positions[f, 0], positions[f, 1], reach, near)
        _by_distance(positions, f, near, count, distances)
        for p in range(count):
            for q in range(p):
                j, l = near[p], near[q]
                dx, dy = positions[j, 0] - positions[l, 0], positions[j, 1] - positions[l, 1]
                if dx * dx + dy * dy > reach * reach:
                    continue
                number += 1
                if number <= skip:
                    continue
                if number > allowed:
                    continue
                code = max(
                    side_code(details, j, l, dx, dy),
                    side_code(details, f, j, positions[f, 0] - positions[j, 0], positions[f, 1] - positions[j, 1]),
                    side_code(details, f, l, positions[f, 0] - positions[l, 0], positions[f, 1] - positions[l, 1]),
                )
                used = append(cells, pool, progress[4], place_of(positions, f, l, j, quantum), code)
                if used < 0:
                    progress[1] = number - 1
                    return
                progress[1], progress[2], progress[4] = number, progress[2] + 1, used
            if number > allowed:
                break
        progress[3] += number > allowed
        enter_grid(heads, following, side, positions, f, f + 1)
        progress[0], progress[1] = f + 1, 0
