"""JCBB: joint compatibility branch and bound (Neira and Tardós, IEEE TRA 17(6), 2001), with covisibility locality."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.tree import Node, Tree, as_hypothesis, decided, interpretation_tree, root
from slam_gym.types import NONE, Array, BoolArray, Effort, Hypothesis, IntArray, Prediction, Scan

_ALL_LOCAL = np.ones((1, 1), np.bool_)


def jcbb(
    scan: Scan,
    prediction: Prediction,
    *,
    confidence: float = 0.99,
    node_limit: int = 100_000,
    locality: str | None = "covisibility",
) -> Hypothesis:
    """The jointly compatible hypothesis with most pairings, and of those the one with least D²_H.

    Where the prediction carries a locality, it is used unless `locality` is None, in two searches: measurements are
    first offered the features near those paired in recent scans; those left over are then offered the other features,
    with the pairings of the first search kept, and there the first pairing restricts the others to its own locality.

    `node_limit` bounds each of the two searches; where it is met, `effort.limit_hit` says so and the best hypothesis
    found until then is returned. Raises ValueError as `individual` does, for a node limit below 1, and for an unknown
    locality.
    """
    if node_limit < 1:
        raise ValueError(f"node_limit: {node_limit} is less than 1")
    if locality not in ("covisibility", None):
        raise ValueError(f"locality: {locality!r} is neither 'covisibility' nor None")
    near = prediction.locality.near if locality and prediction.locality else None
    tree = interpretation_tree(scan, prediction, confidence, eligible=near)
    rows, distance, effort = complete(tree, root(tree), node_limit)
    if near is not None and not near.all() and (rows == NONE).any():
        tree = interpretation_tree(scan, prediction, confidence, given=rows, eligible=~near, local=True)
        rows, distance, more = complete(tree, root(tree), node_limit)
        effort = Effort(
            effort.nodes + more.nodes,
            effort.individual_tests + more.individual_tests,
            effort.joint_tests + more.joint_tests,
            effort.limit_hit or more.limit_hit,
        )
    return as_hypothesis(prediction, rows, distance, effort)


def complete(tree: Tree, node: Node, node_limit: int = 100_000) -> tuple[IntArray, float, Effort]:
    """The best completion of `node`: most pairings, then least D²_H, of all paths whose every prefix is compatible.

    Returns the row of the prediction paired with each measurement (m,), or NONE; D²_H; and the effort.

    Depth first, branches by ascending D²_ij and `*` last. A branch is visited if its bound (pairings so far + what may
    follow) beats the best, or equals it while its D²_H is below the best's. What may follow is the lesser of the levels
    left with a candidate and of their distinct unused features. Only candidates that can still be legal count: D²_H
    never shrinks along a path, so a candidate is out of the whole subtree once D² of H and itself exceeds the gate of
    the largest hypothesis that it could complete.
    """
    candidates = tree.candidates
    rows, held, first = decided(tree, node), len(node.slots), candidates.starts[node.level]
    slots, innovations, measured = tree.slots[first:], candidates.innovations[first:], candidates.measured[first:]
    if held:
        paired = np.array([np.flatnonzero(rows == row)[0] for row in tree.rows[node.slots]])
        before = tree.scan.points[paired] - tree.prediction.positions[rows[paired]]
        slots, innovations = np.concatenate((node.slots, slots)), np.concatenate((before, innovations))
        measured = np.concatenate((paired, measured))
    chosen, distance, nodes, tests, limit_hit = _search(
        slots,
        innovations,
        measured,
        tree.scan.covariances,
        tree.covariance,
        _ALL_LOCAL if tree.local is None else tree.local,
        tree.local is not None,
        tree.pairings_given,
        tree.gates,
        held,
        node_limit,
    )
    rows[measured[chosen]] = tree.rows[slots[chosen]]
    return rows, distance, Effort(nodes, candidates.tests, tests, limit_hit)


class _Pairings(NamedTuple):
    """What may be paired with what: first the pairings held, then the candidates, level by level."""

    slots: IntArray  # (c,) feature
    innovations: Array  # (c, 2) [m]
    measured: IntArray  # (c,) measurement; a new one begins a new level
    noise: Array  # (m, 2, 2) [m²]
    covariance: Array  # (2u, 2u) [m²]
    local: BoolArray  # (u, u)
    restricted: bool  # the pairing that follows `given` others restricts those after it to its locality
    given: int
    gates: Array  # χ² gate by number of pairings


class _Stack(NamedTuple):
    """By p, the number of pairings of the hypothesis H on the path: what may follow it, conditioned on H."""

    alive: IntArray  # (P + 1, c) candidates that can still be legal, level by level, by ascending D²_ij
    total: Array  # (P + 1, c) D² of H and the candidate
    error: Array  # (P + 1, c, 2) [m] e = ν_ij − wᵀy
    spread: Array  # (P + 1, c, 3) [m²] S_ij − wᵀw: xx, xy, yy
    w: Array  # (c, 2P, 2) [m] w = L⁻¹ S_{H,ij}; its first 2p rows belong to H
    stamps: IntArray  # (u,) feature was counted in this call


@compiled
def _search(
    slots: IntArray,
    innovations: Array,
    measured: IntArray,
    noise: Array,
    covariance: Array,
    local: BoolArray,
    restricted: bool,
    given: int,
    gates: Array,
    held: int,
    node_limit: int,
) -> tuple[IntArray, float, int, int, bool]:
    """Indices (b,) of the best's pairings, those held first; its D²_H; nodes; joint tests; limit hit."""
    pairings = _Pairings(slots, innovations, measured, noise, covariance, local, restricted, given, gates)
    most, count = len(gates), len(slots)
    stack = _Stack(
        np.empty((most, count), np.int64),
        np.empty((most, count)),
        np.empty((most, count, 2)),
        np.empty((most, count, 3)),
        np.empty((count, 2 * most, 2)),
        np.zeros(len(local) if restricted else len(covariance) // 2, np.int64),
    )
    distance, path = np.zeros(most), np.empty(most, np.int64)
    position, end, level = np.zeros(most, np.int64), np.zeros(most, np.int64), np.full(most, NONE)
    bound, floor = np.zeros(most, np.int64), np.zeros(most)
    end[0] = _start(pairings, stack)
    for p in range(held):
        path[p], distance[p + 1] = p, stack.total[p, p]
        end[p + 1] = _condition(pairings, stack, p, p, 1, end[p], distance[p + 1])
    p, best, best_distance, best_path = held, held, distance[held], path.copy()
    nodes, tests, limit_hit = 0, 0, False
    end[p], bound[p], floor[p] = _prune(pairings, stack, p, 0, end[p], 1)
    while p >= held:
        if position[p] == end[p] or bound[p] < best or (bound[p] == best and not floor[p] < best_distance):
            p -= 1
            continue
        if nodes == node_limit:
            limit_hit = True
            break
        c = stack.alive[p, position[p]]
        if level[p] == NONE:
            level[p] = measured[c]
        if measured[c] != level[p]:
            # all pairings of this level are done: `*`, which leaves H as it is and takes the place of its parent
            nodes += 1
            end[p], bound[p], floor[p] = _prune(pairings, stack, p, position[p], end[p], nodes + 1)
            level[p] = NONE
            continue
        position[p] += 1
        if bound[p] == best and not stack.total[p, c] < best_distance:
            continue
        nodes += 1
        path[p], distance[p + 1] = c, stack.total[p, c]
        end[p + 1] = _condition(pairings, stack, p, c, position[p], end[p], distance[p + 1])
        p += 1
        tests += end[p]
        if p > best or (p == best and distance[p] < best_distance):
            best, best_distance = p, distance[p]
            best_path[:p] = path[:p]
        position[p], level[p] = 0, NONE
        end[p], bound[p], floor[p] = _prune(pairings, stack, p, 0, end[p], nodes + 1)
    return best_path[:best], best_distance, nodes, tests, limit_hit


@compiled
def _start(pairings: _Pairings, stack: _Stack) -> int:
    """All candidates, conditioned on nothing; their number."""
    for c in range(len(pairings.slots)):
        x, y = pairings.innovations[c]
        noise, s = pairings.noise[pairings.measured[c]], 2 * pairings.slots[c]
        xx, yy = pairings.covariance[s, s] + noise[0, 0], pairings.covariance[s + 1, s + 1] + noise[1, 1]
        xy = pairings.covariance[s, s + 1] + noise[0, 1]
        stack.alive[0, c], stack.total[0, c] = c, _squared_distance(x, y, xx, xy, yy)
        stack.error[0, c, 0], stack.error[0, c, 1] = x, y
        stack.spread[0, c, 0], stack.spread[0, c, 1], stack.spread[0, c, 2] = xx, xy, yy
    return len(pairings.slots)


@compiled
def _squared_distance(x: float, y: float, xx: float, xy: float, yy: float) -> float:
    """eᵀ S⁻¹ e, inf where S is not positive definite."""
    determinant = xx * yy - xy * xy
    if not (determinant > 0.0 and xx > 0.0):
        return math.inf
    return (yy * x * x - 2.0 * xy * x * y + xx * y * y) / determinant


@compiled
def _condition(pairings: _Pairings, stack: _Stack, p: int, d: int, first: int, last: int, distance: float) -> int:
    """Candidate d joins the p pairings of H: what follows it among alive[p, first:last], conditioned on both.

    `distance` is D² of H and d. Fills level p + 1 of the stack and returns the number of candidates there.
    """
    slots, w, alive, count = pairings.slots, stack.w, stack.alive, 0
    lxx = math.sqrt(stack.spread[p, d, 0])
    lyx = stack.spread[p, d, 1] / lxx
    lyy = math.sqrt(stack.spread[p, d, 2] - lyx * lyx)
    yx = stack.error[p, d, 0] / lxx
    yy = (stack.error[p, d, 1] - lyx * yx) / lyy
    a = 2 * slots[d]
    for k in range(first, last):
        c = alive[p, k]
        if pairings.measured[c] == pairings.measured[d] or slots[c] == slots[d]:
            continue
        if pairings.restricted and p == pairings.given and not pairings.local[slots[d], slots[c]]:
            continue
        b = 2 * slots[c]
        s00, s01 = pairings.covariance[a, b], pairings.covariance[a, b + 1]
        s10, s11 = pairings.covariance[a + 1, b], pairings.covariance[a + 1, b + 1]
        for r in range(2 * p):
            s00 -= w[d, r, 0] * w[c, r, 0]
            s01 -= w[d, r, 0] * w[c, r, 1]
            s10 -= w[d, r, 1] * w[c, r, 0]
            s11 -= w[d, r, 1] * w[c, r, 1]
        s00, s01 = s00 / lxx, s01 / lxx
        s10, s11 = (s10 - lyx * s00) / lyy, (s11 - lyx * s01) / lyy
        w[c, 2 * p, 0], w[c, 2 * p, 1], w[c, 2 * p + 1, 0], w[c, 2 * p + 1, 1] = s00, s01, s10, s11
        x, y = stack.error[p, c, 0] - s00 * yx - s10 * yy, stack.error[p, c, 1] - s01 * yx - s11 * yy
        xx = stack.spread[p, c, 0] - s00 * s00 - s10 * s10
        xy = stack.spread[p, c, 1] - s00 * s01 - s10 * s11
        zz = stack.spread[p, c, 2] - s01 * s01 - s11 * s11
        stack.error[p + 1, c, 0], stack.error[p + 1, c, 1] = x, y
        stack.spread[p + 1, c, 0], stack.spread[p + 1, c, 1], stack.spread[p + 1, c, 2] = xx, xy, zz
        stack.total[p + 1, c] = distance + _squared_distance(x, y, xx, xy, zz)
        alive[p + 1, count] = c
        count += 1
    return count


@compiled
def _prune(
    pairings: _Pairings, stack: _Stack, p: int, first: int, last: int, stamp: int
) -> tuple[int, int, float]:
    """Drop from alive[p, first:last] what cannot become legal any more; its new end, the bound, and the floor.

    A candidate can at most be preceded by one pairing of each level before its own that still has a candidate. Bound:
    pairings of the largest hypothesis that may come of H. Floor: D² of a hypothesis that reaches the bound is no less,
    where that takes a pairing of every level.
    """
    kept, levels, distinct, level, least, floor = first, 0, 0, NONE, math.inf, 0.0
    for k in range(first, last):
        c = stack.alive[p, k]
        if pairings.measured[c] != level:
            if least < math.inf:
                levels, floor = levels + 1, max(floor, least)
            level, least = pairings.measured[c], math.inf
        total, slot = stack.total[p, c], pairings.slots[c]
        if total < pairings.gates[p + levels + 1]:
            stack.alive[p, kept] = c
            kept, least = kept + 1, min(least, total)
            if stack.stamps[slot] != stamp:
                stack.stamps[slot] = stamp
                distinct += 1
    if least < math.inf:
        levels, floor = levels + 1, max(floor, least)
    return kept, p + min(levels, distinct), floor if distinct >= levels else 0.0
