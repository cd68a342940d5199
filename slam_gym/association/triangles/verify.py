"""Poses that a seed implies, held against the whole scan: bitmaps, then gates, then pairing, fit and joint test.

Most poses are given up at the bitmaps, as soon as too many measurements find no feature within their gate; those that
are left are asked for features in elliptical gates; what passes is paired and fitted (`index_pose`) and recorded.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.triangles.pose import FIT, Look, Store, alike, is_local, pair_around, settle
from slam_gym.association.triangles.store import POWER, SIDE, SIZE, Bits, Small, is_painted
from slam_gym.types import UNPAIRED, Array, IntArray

NODES, BINARY, TRIES, LEAVES, JOINT, LIMIT, WORK = 0, 1, 2, 3, 4, 5, 6  # of `spent`
MODE = 2  # of `state`
_LEAF = 30.0  # poses that take as long as fitting and pairing one hypothesis
ALL, ALIKE = 0, 1
"""What of a pose is tested: that it may explain enough of the scan; that it explains all but pairings / 3 − 1 of what
the best explains."""


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

    features: IntArray  # (h, m) map feature paired with each measurement, UNPAIRED for `*`
    fits: Array  # (h, 12)
    squares: Array  # (h,) D²
    state: IntArray  # (3,) pairings of the best, or one less than what is worth recording; number of hypotheses; mode
    spent: IntArray  # (7,)
    limits: IntArray  # (3,) pairings needed, most work [poses], pairings that chance need not be feared for


@compiled
def spend(found: Found, what: int, amount: int, work: float) -> None:
    """Count an effort, which is as much `work` as so many poses take; too much of it in all, and the limit is hit."""
    found.spent[what] += amount
    found.spent[WORK] += int(work)
    if found.spent[WORK] > found.limits[1]:
        found.spent[LIMIT] = 1


@compiled
def verify(
    look: Look, store: Store, seed: Seed, triangles: Small, variance: float, inertia: float, found: Found
) -> None:
    """Hold the poses that the triangles (t, 3) imply against the whole scan: bitmaps first, then the exact tests."""
    if len(triangles) == 0:
        return
    spend(found, NODES, len(triangles), len(triangles))
    if found.spent[LIMIT] > 0:
        return
    order, allowed = seed.order, len(look.points) - found.state[0] - (found.state[1] == 0)
    if found.state[MODE] == ALIKE:
        order, allowed = order[found.features[0][order] != UNPAIRED], max(found.state[0] // 3 - 1, 0)
    chosen, poses = _promising(
        store.positions,
        store.heads,
        store.following,
        store.bits,
        store.settings,
        seed.corners,
        order,
        seed.levels,
        seed.offsets,
        seed.around,
        triangles,
        allowed,
    )
    for at in range(len(chosen)):
        if found.spent[LIMIT] > 0:
            return
        _examine(look, store, seed, triangles[chosen[at]], poses[chosen[at]], variance, inertia, found)


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
    """Which triangles imply a pose at which no more than `allowed` measurements find nothing; all poses (x, y, c, s).

    The first bitmap tests, as many as it takes to give a pose up, are made of every pose without a branch, so that the
    processor waits for many places of the bitmap at a time; the rest are made one after another of those still left.
    """
    poses, tests, whole, count = _implied_poses(positions, corners, offsets, triangles), 0, len(triangles), 0
    chosen, missing = np.empty(whole + 1, np.int64), np.empty(whole + 1, np.int64)
    left = np.empty(whole + 1, np.int64)
    while tests < min(len(order), 62) and levels[order[tests]] < 2:
        tests += 1
    first = min(tests, allowed + 1)
    power, per_metre = int(settings[POWER]), 1.0 / settings[SIZE]
    behind = 1 << (2 * power)  # the coarse bitmap follows the fine one
    for at in range(whole):
        x, y, c, s = poses[at, 0], poses[at, 1], poses[at, 2], poses[at, 3]
        misses, which = 0, 0
        for p in range(first):
            k = order[p]
            px, py = x + c * offsets[k, 0] - s * offsets[k, 1], y + s * offsets[k, 0] + c * offsets[k, 1]
            level = levels[k]
            scale = per_metre if level == 0 else 0.5 * per_metre
            miss = 1 - is_painted(bits, behind * level, power - level, px * scale, py * scale)
            misses, which = misses + miss, which | miss << p
        chosen[count], missing[count], left[count] = at, which, allowed - misses
        count += misses <= allowed
    for p in range(first, tests):
        whole, count, k = count, 0, order[p]
        level = levels[k]
        scale = per_metre if level == 0 else 0.5 * per_metre
        for q in range(whole):
            at = chosen[q]
            x, y, c, s = poses[at, 0], poses[at, 1], poses[at, 2], poses[at, 3]
            px, py = x + c * offsets[k, 0] - s * offsets[k, 1], y + s * offsets[k, 0] + c * offsets[k, 1]
            miss = 1 - is_painted(bits, behind * level, power - level, px * scale, py * scale)
            chosen[count], missing[count], left[count] = at, missing[q] | miss << p, left[q] - miss
            count += left[count] >= 0
    kept = 0
    for q in range(count):
        at = chosen[q]
        pose = (poses[at, 0], poses[at, 1], poses[at, 2], poses[at, 3])
        if _meets(positions, heads, following, settings, order, offsets, around, pose, missing[q], left[q]):
            chosen[kept] = at
            kept += 1
    return chosen[:kept], poses


@compiled
def _implied_poses(positions: Array, corners: IntArray, offsets: Array, triangles: Small) -> Array:
    """Least-squares fits of the corners to triangles (t, 3): x, y of their centroid, cos θ, sin θ, (t, 4)."""
    poses, u, v = np.empty((len(triangles), 4)), np.empty(3), np.empty(3)
    for k in range(3):
        u[k], v[k] = offsets[corners[k], 0], offsets[corners[k], 1]
    for at in range(len(triangles)):
        i, j, l = int(triangles[at, 0]), int(triangles[at, 1]), int(triangles[at, 2])
        ax, ay, bx, by = positions[i, 0], positions[i, 1], positions[j, 0], positions[j, 1]
        cx, cy = positions[l, 0], positions[l, 1]
        x, y = (ax + bx + cx) / 3.0, (ay + by + cy) / 3.0
        c = (ax - x) * u[0] + (ay - y) * v[0] + (bx - x) * u[1] + (by - y) * v[1] + (cx - x) * u[2] + (cy - y) * v[2]
        s = (ay - y) * u[0] - (ax - x) * v[0] + (by - y) * u[1] - (bx - x) * v[1] + (cy - y) * u[2] - (cx - x) * v[2]
        scale = 1.0 / math.sqrt(c * c + s * s)
        poses[at, 0], poses[at, 1], poses[at, 2], poses[at, 3] = x, y, c * scale, s * scale
    return poses


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
    spend(found, LEAVES, 1, _LEAF)
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
            shared += decisions[i] != UNPAIRED and decisions[i] == found.features[h, i]
        if shared >= 2:
            if square >= found.squares[h]:
                return
            at = h
            break
    if at >= len(found.squares):
        return
    found.features[at], found.fits[at], found.squares[at] = decisions, fit, square
    found.state[0], found.state[1] = pairings, max(count, at + 1)
