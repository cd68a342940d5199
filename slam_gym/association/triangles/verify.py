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
from slam_gym.association.triangles.store import POWER, SIDE, SIZE, Small, bit_number
from slam_gym.types import UNPAIRED, Array, BoolArray, IntArray

NODES, BINARY, TRIES, LEAVES, JOINT, LIMIT, WORK = 0, 1, 2, 3, 4, 5, 6  # of `spent`
MODE = 2  # of `state`
AT_ONCE = 16  # places in a bitmap that one turn of a vectorised loop works out
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
    starts: IntArray  # (m − 2,) of the others, in order: where their places start, and where the last one's end
    places: Array  # (2, ≥ p) [m] from the centroid: the gate of a measurement touches nothing if none of its is painted
    levels: IntArray  # (≥ p,) in which bitmap each of these is looked up: 0 the fine one, 1 the coarse one
    # Of places and levels there are `AT_ONCE` more, zeros: those worked out are a multiple of it.
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
    look: Look, store: Store, seed: Seed, triangles: Small, variance: float, inertia: float, found: Found, strict: bool
) -> None:
    """Hold the poses that the triangles (t, 3) imply against the whole scan: bitmaps first, then the exact tests.

    If `strict`, only those that explain the first measurement in order.
    """
    if len(triangles) == 0:
        return
    spend(found, NODES, len(triangles), len(triangles))
    if found.spent[LIMIT] > 0:
        return
    asked, allowed = seed.order >= 0, len(look.points) - found.state[0] - (found.state[1] == 0)
    if found.state[MODE] == ALIKE:
        asked, allowed = found.features[0][seed.order] != UNPAIRED, max(found.state[0] // 3 - 1, 0)
    if strict:
        first = np.arange(len(asked)) == 0
        triangles = triangles[_promising(store, seed, first, triangles, 0)[0]]
    chosen, poses = _promising(store, seed, asked, triangles, allowed)
    for at in range(len(chosen)):
        if found.spent[LIMIT] > 0:
            return
        _examine(look, store, seed, triangles[chosen[at]], poses[:, chosen[at]], variance, inertia, found)


@compiled
def _promising(store: Store, seed: Seed, asked: BoolArray, triangles: Small, allowed: int) -> tuple[IntArray, Array]:
    """Which triangles imply a pose at which no more than `allowed` measurements find nothing, and all poses (4, t).

    Of each pose all places are worked out first, in a loop of their own, which vectorises, then looked up.
    """
    bits, settings, starts, levels = store.bits, store.settings, seed.starts, seed.levels
    poses, u, v = _implied_poses(store.positions, seed.corners, seed.offsets, triangles), seed.places[0], seed.places[1]
    words, shifts, power = np.empty(len(levels), np.int64), np.empty(len(levels), np.int64), int(settings[POWER])
    chosen, kept, tests = np.empty(len(triangles), np.int64), 0, 0
    for p in range(len(asked)):
        tests = p + 1 if asked[p] else tests
    used = starts[tests] + -starts[tests] % AT_ONCE
    for at in range(len(triangles)):
        x, y, c, s = poses[0, at], poses[1, at], poses[2, at], poses[3, at]
        for i in range(used):
            level = levels[i]
            scale, across = (1.0 - 0.5 * level) / settings[SIZE], power - level
            column = math.floor((x + c * u[i] - s * v[i]) * scale) & ((1 << across) - 1)
            row = math.floor((y + s * u[i] + c * v[i]) * scale) & ((1 << across) - 1)
            # The coarse bitmap follows the fine one.
            words[i], shifts[i] = (level << (2 * power) | bit_number(column, row, across)) >> 5, column & 31
        left = allowed
        for p in range(tests):
            hit = int(not asked[p] or starts[p] == starts[p + 1])
            for i in range(starts[p], starts[p + 1]):
                hit |= int(bits[np.uint64(words[i])]) >> shifts[i] & 1
            left -= 1 - hit  # not given up early: there is no foretelling when, and waiting for it takes longer
        pose = (x, y, c, s)
        if left >= 0 and _meets(store, seed, asked, pose, allowed):
            chosen[kept] = at
            kept += 1
    return chosen[:kept], poses


@compiled
def _implied_poses(positions: Array, corners: IntArray, offsets: Array, triangles: Small) -> Array:
    """Least-squares fits of the corners to triangles (t, 3): x, y of their centroid, cos θ, sin θ, (4, t)."""
    t = len(triangles)
    u, v, F, poses = np.empty(3), np.empty(3), np.empty((6, t)), np.empty((4, t))
    for k in range(3):
        u[k], v[k] = offsets[corners[k], 0], offsets[corners[k], 1]
    for q in range(t):
        for k in range(3):
            j = np.uint64(triangles[q, k])
            F[2 * k, q], F[2 * k + 1, q] = positions[j, 0], positions[j, 1]
    for q in range(t):
        ax, ay, bx, by, cx, cy = F[0, q], F[1, q], F[2, q], F[3, q], F[4, q], F[5, q]
        x, y = (ax + bx + cx) / 3.0, (ay + by + cy) / 3.0
        c = (ax - x) * u[0] + (ay - y) * v[0] + (bx - x) * u[1] + (by - y) * v[1] + (cx - x) * u[2] + (cy - y) * v[2]
        s = (ay - y) * u[0] - (ax - x) * v[0] + (by - y) * u[1] - (bx - x) * v[1] + (cy - y) * u[2] - (cx - x) * v[2]
        scale = 1.0 / math.sqrt(c * c + s * s)
        poses[0, q], poses[1, q], poses[2, q], poses[3, q] = x, y, c * scale, s * scale
    return poses


@compiled
def _meets(store: Store, seed: Seed, asked: BoolArray, pose: tuple[float, float, float, float], allowed: int) -> bool:
    """Whether no more than `allowed` of the measurements `asked`, (m − 3,) in order, miss every feature at a pose.

    Gates are ellipses here, long across the line of sight from the seed, since its heading is what is least known.
    """
    x, y, c, s = pose
    positions, heads, following, side = store.positions, store.heads, store.following, store.settings[SIDE]
    offsets, around, mask, left = seed.offsets, seed.around, len(heads) - 1, allowed
    for p in range(len(asked)):
        if not asked[p]:
            continue
        k = seed.order[p]
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
