"""Poses that a seed implies, held against the whole scan: bitmaps, then gates, then pairing, fit and joint test.

Most poses are given up at the bitmaps, as soon as too many measurements find no feature within their gate; those that
are left are asked for features in elliptical gates; what passes is paired and fitted (`index_pose`) and recorded.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.index_pose import FIT, Look, Store, alike, is_local, pair_around, settle
from slam_gym.association.index_store import POWER, SIDE, SIZE, Bits, Small
from slam_gym.types import NONE, Array, IntArray

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
def verify(
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
