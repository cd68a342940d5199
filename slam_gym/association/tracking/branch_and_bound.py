"""The best completion of a node of the interpretation tree, by depth-first branch and bound.

Every candidate that may still follow the hypothesis H on the path is kept conditioned on H. With S_H = L Lᵀ and
y = L⁻¹ν_H, candidate c of measurement i and feature j has w_c = L⁻¹S_{H,c}, e_c = ν_ij − w_cᵀy and the Schur complement
S_ij − w_cᵀw_c, whence D² of H ∪ {c} = D²_H + e_cᵀ(S_ij − w_cᵀw_c)⁻¹e_c. Pairing d appends two rows to each w_c, and
nothing is ever factored anew: this is a Cholesky factorisation of the path, updated for all that may continue it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.tree import Node, Tree, decided
from slam_gym.types import NONE, Array, BoolArray, Effort, IntArray

_UNRESTRICTED = np.empty((0, 0), np.bool_)


def complete(tree: Tree, node: Node | None = None, node_limit: int = 100_000) -> tuple[IntArray, float, Effort]:
    """The completion of `node` (default: the root) with most pairings, then least D²_H, every prefix being compatible.

    Returns the row of the prediction paired with each measurement (m,), or NONE; D²_H; and the effort.

    Depth first, branches by ascending D²_ij and `*` last. A branch is visited if its bound (pairings so far + what may
    follow) beats the best, or equals it while its D²_H is below the best's. What may follow is the lesser of the levels
    left with a candidate and of their distinct unused features. Only candidates that can still be legal count: D²_H
    never shrinks along a path, so a candidate is out of the whole subtree once D² of H and itself exceeds the gate of
    the largest hypothesis that it could complete.
    """
    candidates = tree.candidates
    if node is None:
        rows, path, first = tree.given.copy(), np.arange(tree.pairings_given), 0
    else:
        rows, path, first = decided(tree, node), node.slots, int(candidates.starts[node.level])
    slots, innovations, measured = tree.slots[first:], candidates.innovations[first:], candidates.measured[first:]
    if len(path):
        paired = np.array([np.flatnonzero(rows == row)[0] for row in tree.rows[path]])
        before = tree.scan.points[paired] - tree.prediction.positions[rows[paired]]
        slots, innovations = np.concatenate((path, slots)), np.concatenate((before, innovations))
        measured = np.concatenate((paired, measured))
    distance, nodes, tests, limit_hit = _search(
        rows,
        tree.rows,
        slots,
        innovations,
        measured,
        tree.scan.covariances,
        tree.covariance,
        _UNRESTRICTED if tree.local is None else tree.local,
        tree.pairings_given,
        len(path),
        tree.gates,
        node_limit,
    )
    return rows, distance, Effort(nodes, candidates.tests, tests, limit_hit)


class _Pairings(NamedTuple):
    """What may be paired with what: first the pairings held, then the candidates, level by level."""

    slots: IntArray  # (c,) feature
    innovations: Array  # (c, 2) [m]
    measured: IntArray  # (c,) measurement; a new one begins a new level
    noise: Array  # (m, 2, 2) [m²]
    covariance: Array  # (2u, 2u) [m²]
    local: (
        BoolArray  # (u, u) the pairing after the `given` ones restricts the others to its locality; empty: it does not
    )
    given: int
    held: int
    gates: Array  # (P + 1,) χ² gate by number of pairings


class _Stack(NamedTuple):
    """By p, the number of pairings of the hypothesis H on the path: what may follow it, conditioned on H."""

    alive: IntArray  # (P + 1, c) candidates that can still be legal, level by level, by ascending D²_ij
    total: Array  # (P + 1, c) D² of H and the candidate
    error: Array  # (P + 1, c, 2) [m] e = ν_ij − wᵀy
    schur: Array  # (P + 1, c, 3) [m²] S_ij − wᵀw: xx, xy, yy
    w: Array  # (c, 2P + 2, 2) [m] w; its first 2p rows belong to H
    end: IntArray  # (P + 1,) number of alive candidates
    levels: IntArray  # (P + 1,) number of their levels, less those decided with `*` since
    features: IntArray  # (P + 1,) number of their features
    distance: Array  # (P + 1,) D²_H
    floor: Array  # (P + 1,) D² of a hypothesis with a pairing of each of those levels is no less
    stamps: IntArray  # (u + 1,) number of the count that last met each feature; at the end, of the last count


@compiled
def _search(
    decisions: IntArray,
    rows: IntArray,
    slots: IntArray,
    innovations: Array,
    measured: IntArray,
    noise: Array,
    covariance: Array,
    local: BoolArray,
    given: int,
    held: int,
    gates: Array,
    node_limit: int,
) -> tuple[float, int, int, bool]:
    """Write the best into `decisions` (m,), as `rows` (u,) of its slots. Its D²_H, nodes, joint tests, limit hit.

    By p: path[p] the pairing that comes next, position[p] in alive[p] of the candidate to try next, level[p] its level.
    """
    pairings = _Pairings(slots, innovations, measured, noise, covariance, local, given, held, gates)
    stack = _empty_stack(len(gates), len(slots), len(covariance) // 2)
    _start(pairings, stack)
    path, position, level = np.empty(len(gates), np.int64), np.zeros(len(gates), np.int64), np.full(len(gates), NONE)
    best_path, best, best_distance = np.empty(len(gates), np.int64), 0, 0.0
    p, nodes, tests, limit_hit = 0, 0, 0, False
    while p >= 0:
        # a pairing held is the only branch of its level
        done = position[p] == stack.end[p] or (p < held and position[p] > 0)
        if done or not _promises(stack, p, best, best_distance):
            p -= 1
            continue
        if nodes == node_limit:
            limit_hit = True
            break
        c = stack.alive[p, position[p]]
        if level[p] == NONE:
            level[p] = measured[c]
        if measured[c] != level[p]:
            # All pairings of this level are done: `*`. It leaves H as it is, so its node takes the place of its parent.
            nodes += 1
            stack.levels[p] -= 1
            stack.floor[p], level[p] = stack.distance[p], measured[c]
            continue
        position[p] += 1
        if c >= held:
            if not stack.total[p, c] < gates[p + 1]:
                continue
            nodes += 1
        path[p] = c
        tests += _pair(pairings, stack, p, c, position[p], best)
        p += 1
        position[p], level[p] = 0, NONE
        if p > best or (p == best and stack.distance[p] < best_distance):
            best, best_distance = p, stack.distance[p]
            for q in range(p):
                best_path[q] = path[q]
    for q in range(best):
        decisions[measured[best_path[q]]] = rows[slots[best_path[q]]]
    return best_distance, nodes, tests, limit_hit


@compiled
def _promises(stack: _Stack, p: int, best: int, best_distance: float) -> bool:
    """Whether something may follow H that beats the best: by pairings, or by D² with as many."""
    bound = p + min(stack.levels[p], stack.features[p])
    if bound != best:
        return bool(bound > best)
    floor = stack.floor[p] if stack.levels[p] <= stack.features[p] else stack.distance[p]
    return bool(floor < best_distance)


@compiled
def _empty_stack(depth: int, candidates: int, features: int) -> _Stack:
    return _Stack(
        np.empty((depth, candidates), np.int64),
        np.empty((depth, candidates)),
        np.empty((depth, candidates, 2)),
        np.empty((depth, candidates, 3)),
        np.empty((candidates, 2 * depth, 2)),
        np.zeros(depth, np.int64),
        np.zeros(depth, np.int64),
        np.zeros(depth, np.int64),
        np.zeros(depth),
        np.zeros(depth),
        np.zeros(features + 1, np.int64),
    )


@compiled
def _start(pairings: _Pairings, stack: _Stack) -> None:
    """The empty hypothesis: everything may follow, conditioned on nothing."""
    for c in range(len(pairings.slots)):
        x, y = pairings.innovations[c]
        noise, s = pairings.noise[pairings.measured[c]], 2 * pairings.slots[c]
        xx, yy = pairings.covariance[s, s] + noise[0, 0], pairings.covariance[s + 1, s + 1] + noise[1, 1]
        xy = pairings.covariance[s, s + 1] + noise[0, 1]
        stack.alive[0, c], stack.total[0, c] = c, (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy)
        stack.error[0, c, 0], stack.error[0, c, 1] = x, y
        stack.schur[0, c, 0], stack.schur[0, c, 1], stack.schur[0, c, 2] = xx, xy, yy
        if c == 0 or pairings.measured[c] != pairings.measured[c - 1]:
            stack.levels[0] += 1
    stack.end[0], stack.features[0] = len(pairings.slots), len(stack.stamps) - 1


@compiled
def _pair(pairings: _Pairings, stack: _Stack, p: int, d: int, first: int, best: int) -> int:
    """Candidate d joins the p pairings of H: fill entry p + 1 of the stack from alive[p, first:]. Joint tests made.

    Drops the candidates that cannot become legal any more: a candidate can at most be preceded by one pairing of each
    level before its own that still has a candidate. Gives up, with none alive, once the bound must end below `best`.
    """
    measured, slots, alive, gates, w = pairings.measured, pairings.slots, stack.alive, pairings.gates, stack.w
    ixx, lyx, iyy, yx, yy = _pivot(stack, p, d)
    restricted, a = p == pairings.given and len(pairings.local) > 0, 2 * slots[d]
    q, distance, left, kept, tests = p + 1, stack.total[p, d], stack.levels[p] - 1, 0, 0
    levels, level, least, floor = 0, measured[d], math.inf, distance
    stack.end[q], stack.levels[q], stack.distance[q] = 0, 0, distance
    for k in range(first, stack.end[p]):
        c = alive[p, k]
        if measured[c] == measured[d] or slots[c] == slots[d]:
            continue
        if restricted and not pairings.local[slots[d], slots[c]]:
            continue
        if measured[c] != level:
            if least < math.inf:
                levels, floor, least = levels + 1, max(floor, least), math.inf
            if q + levels + left < best:
                return tests
            left, level = left - 1, measured[c]
        tests += 1
        b = 2 * slots[c]
        s00, s01 = pairings.covariance[a, b], pairings.covariance[a, b + 1]
        s10, s11 = pairings.covariance[a + 1, b], pairings.covariance[a + 1, b + 1]
        for r in range(2 * p):
            s00 -= w[d, r, 0] * w[c, r, 0]
            s01 -= w[d, r, 0] * w[c, r, 1]
            s10 -= w[d, r, 1] * w[c, r, 0]
            s11 -= w[d, r, 1] * w[c, r, 1]
        s00, s01 = s00 * ixx, s01 * ixx
        s10, s11 = (s10 - lyx * s00) * iyy, (s11 - lyx * s01) * iyy
        x, y = stack.error[p, c, 0] - s00 * yx - s10 * yy, stack.error[p, c, 1] - s01 * yx - s11 * yy
        xx = stack.schur[p, c, 0] - s00 * s00 - s10 * s10
        xy = stack.schur[p, c, 1] - s00 * s01 - s10 * s11
        zz = stack.schur[p, c, 2] - s01 * s01 - s11 * s11
        added, determinant = zz * x * x - 2.0 * xy * x * y + xx * y * y, xx * zz - xy * xy
        if not (xx > 0.0 and added < (gates[q + levels + 1] - distance) * determinant) and c >= pairings.held:
            continue
        w[c, 2 * p, 0], w[c, 2 * p, 1], w[c, 2 * p + 1, 0], w[c, 2 * p + 1, 1] = s00, s01, s10, s11
        stack.error[q, c, 0], stack.error[q, c, 1] = x, y
        stack.schur[q, c, 0], stack.schur[q, c, 1], stack.schur[q, c, 2] = xx, xy, zz
        stack.total[q, c] = distance + added / determinant
        alive[q, kept] = c
        kept, least = kept + 1, min(least, stack.total[q, c])
    if least < math.inf:
        levels, floor = levels + 1, max(floor, least)
    stack.end[q], stack.levels[q], stack.floor[q] = kept, levels, floor
    stack.features[q] = _count_features(slots, alive[q, :kept], stack.stamps)
    return tests


@compiled
def _pivot(stack: _Stack, p: int, d: int) -> tuple[float, float, float, float, float]:
    """What d appends to L and to y: 1/L_xx, L_yx, 1/L_yy of the factor of its Schur complement, and y_x, y_y."""
    lxx = math.sqrt(stack.schur[p, d, 0])
    lyx = stack.schur[p, d, 1] / lxx
    lyy = math.sqrt(stack.schur[p, d, 2] - lyx * lyx)
    yx = stack.error[p, d, 0] / lxx
    return 1.0 / lxx, lyx, 1.0 / lyy, yx, (stack.error[p, d, 1] - lyx * yx) / lyy


@compiled
def _count_features(slots: IntArray, chosen: IntArray, stamps: IntArray) -> int:
    """Distinct features among the candidates `chosen`."""
    stamps[-1] += 1
    count = 0
    for c in chosen:
        if stamps[slots[c]] != stamps[-1]:
            stamps[slots[c]] = stamps[-1]
            count += 1
    return count
