"""JCBB: joint compatibility branch and bound (Neira and Tardós, IEEE TRA 17(6), 2001), with covisibility locality.

The search is depth first. As in a `tree.Node`, every candidate that may still follow the hypothesis H on the path is
kept conditioned on H. A stack holds these for each number of pairings on the path, so that the search can step back.
"""

import math
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled, inlined
from slam_gym.association import tree
from slam_gym.association.compatibility import joint_gates
from slam_gym.association.prediction import Expected, Prediction, PredictionArrays
from slam_gym.association.tracking.near_first import Decided, Spent, decided, offer
from slam_gym.association.tree import Pairings
from slam_gym.types import UNPAIRED, Array, Hypothesis, IntArray, Scan, ScanArrays
from slam_gym.validation import check_count

TEST_LIMIT = 1_000_000  # joint tests of a search: where the robot is lost, a node has thousands of candidates
_UNDECIDED = -1  # in place of a level that is not known yet


def jcbb(scan: Scan, prediction: Prediction, *, node_limit: int = 100_000) -> Hypothesis:
    """The hypothesis with the most pairings, and of these the one with the least D²_H, among those that are jointly
    compatible at every level of the tree; their gates differ, so that the order of the scan may matter.

    Where the prediction has localities, two searches are made (`near_first`). Each is limited to `node_limit` nodes and
    a million joint tests. Where a limit is reached, `effort.limit_hit` is set and the best hypothesis so far is
    returned. Raises ValueError as `individual`, and for a node limit below 1.
    """
    check_count("node_limit", node_limit)
    gates = joint_gates(max(len(scan), 1), prediction.confidence)
    return _decide(scan.arrays, prediction.arrays, gates, node_limit).hypothesis()


@compiled
def _decide(scan: ScanArrays, prediction: PredictionArrays, gates: Array, node_limit: int) -> Decided:
    expected = Expected(*prediction)
    rows, distance, spent = np.full(len(scan[0]), UNPAIRED), 0.0, Spent(0, 0, 0, False)
    for search in range(1 if len(expected.counts) == 0 or expected.near.all() else 2):
        offered = offer(scan, prediction, rows, search == 0, gates[1], len(expected.features))
        best = _Best(distance, 0, 0, False)
        if len(offered.pairings.slots) > offered.pairings.fixed:
            best = branch_and_bound(offered.pairings, offered.rows, gates, node_limit, rows)
        distance = best.distance
        spent = Spent(
            spent.nodes + best.nodes,
            spent.individual_tests + offered.tests,
            spent.joint_tests + best.tests,
            spent.limit_hit or best.limit_hit,
        )
        if not (rows == UNPAIRED).any():
            break
    return decided(expected, rows, distance, spent)


class _Best(NamedTuple):
    """D² of the best hypothesis of a search, and the work done."""

    distance: float  # D²_H
    nodes: int
    tests: int  # joint tests
    limit_hit: bool


class _Stack(NamedTuple):
    """By number p of pairings of the hypothesis H on the path: candidates that may follow it, conditioned on H."""

    alive: IntArray  # (P + 1, c) candidates that can still be legal, level by level, by ascending D²_ij
    total: Array  # (P + 1, c) D² of H with the candidate added
    innovations: Array  # (P + 1, c, 5) `tree.Innovation`
    w: Array  # (c, 2P + 2, 2) w; the first 2p rows belong to H
    end: IntArray  # (P + 1,) number of alive candidates
    levels: IntArray  # (P + 1,) number of their levels, minus those decided with `*` since
    features: IntArray  # (P + 1,) number of their features
    distance: Array  # (P + 1,) D²_H
    floor: Array  # (P + 1,) lower bound of D² of a hypothesis with a pairing in each of those levels
    stamps: IntArray  # (u + 1,) number of the last count that met each feature; at the end, that of the latest count


@compiled
def branch_and_bound(pairings: Pairings, rows: IntArray, gates: Array, node_limit: int, out: IntArray) -> _Best:
    """Write to `out` (m,) the hypothesis with most pairings, then least D²_H, whose prefixes are all compatible.

    `rows` (u,) are the features of the slots; a hypothesis has each of them once. Branches are tried by ascending
    D²_ij, `*` last. A branch is visited if its bound (pairings so far plus those that may follow) exceeds the best, or
    equals it with a smaller D²_H. The number that may follow is the smaller of two counts: the remaining levels with a
    candidate, and their distinct unused features. Only candidates that can still become legal count. D²_H never shrinks
    along a path, so a candidate is excluded from the whole subtree once D² of H and itself exceeds the gate of the
    largest hypothesis that it could complete.

    For each p: path[p] is the next pairing, position[p] the index of the next candidate, level[p] its level.
    """
    measured, fixed, depth, feature = pairings.measured, pairings.fixed, len(gates), rows[pairings.slots]
    path, position, level = np.empty(depth, np.int64), np.zeros(depth, np.int64), np.full(depth, _UNDECIDED)
    path[:fixed] = np.arange(fixed)
    stack = _stack_at(pairings, path, feature)
    alive, total, _, _, end, levels, features, distances, floors, _ = stack
    best_path, best, best_distance = path.copy(), fixed, distances[fixed]
    p, nodes, tests, limit_hit = fixed, 0, 0, False
    while p >= fixed:
        bound, least = p + min(levels[p], features[p]), floors[p] if levels[p] <= features[p] else distances[p]
        if position[p] == end[p] or bound < best or (bound == best and not least < best_distance):
            p -= 1
            continue
        if nodes == node_limit or tests >= TEST_LIMIT:
            limit_hit = True
            break
        c = alive[p, position[p]]
        if level[p] == _UNDECIDED:
            level[p] = measured[c]
        if measured[c] != level[p]:
            # All pairings of this level are tried, so `*` is next. It leaves H unchanged: its node replaces its parent.
            nodes += 1
            levels[p] -= 1
            floors[p], level[p] = distances[p], measured[c]
            continue
        position[p] += 1
        if not total[p, c] < gates[p + 1]:
            continue
        nodes += 1
        path[p] = c
        tests += _push(pairings, stack, feature, p, c, position[p], best, gates)
        p += 1
        position[p], level[p] = 0, _UNDECIDED
        if p > best or (p == best and distances[p] < best_distance):
            best, best_distance = p, distances[p]
            for q in range(p):
                best_path[q] = path[q]
    for c in best_path[:best]:
        out[measured[c]] = feature[c]
    return _Best(best_distance, nodes, tests, limit_hit)


@compiled
def _stack_at(pairings: Pairings, path: IntArray, feature: IntArray) -> _Stack:
    """The stack with the candidates that may follow the fixed pairings, with which the path begins; `feature` (c,) is
    that of each pairing."""
    measured, fixed, depth = pairings.measured, pairings.fixed, len(path)
    count = len(measured)
    stack = _Stack(
        np.empty((depth, count), np.int64),
        np.empty((depth, count)),
        np.empty((depth, count, 5)),
        np.empty((count, 2 * depth, 2)),
        np.zeros(depth, np.int64),
        np.zeros(depth, np.int64),
        np.zeros(depth, np.int64),
        np.zeros(depth),
        np.zeros(depth),
        np.zeros(feature.max() + 2, np.int64),
    )
    innovations, alive_count, last = stack.innovations[fixed], 0, _UNDECIDED
    distance = tree.condition_on_fixed(pairings, innovations, stack.w)
    for c in range(fixed, count):
        if not tree.may_follow(pairings, path, fixed, c):
            continue
        stack.total[fixed, c] = distance + tree.squared(tree.read(innovations, c))
        stack.alive[fixed, alive_count] = c
        alive_count += 1
        if measured[c] != last:
            stack.levels[fixed], last = stack.levels[fixed] + 1, measured[c]
    stack.end[fixed], stack.distance[fixed], stack.floor[fixed] = alive_count, distance, distance
    stack.features[fixed] = _count_features(feature, stack.alive[fixed, :alive_count], stack.stamps)
    return stack


@inlined
def _push(
    pairings: Pairings, stack: _Stack, feature: IntArray, p: int, d: int, first: int, best: int, gates: Array
) -> int:
    """Add candidate d to the p pairings of H: fill entry p + 1 of the stack from alive[p, first:]. Returns the joint
    tests.

    Candidates that cannot become legal are dropped: at most one pairing of each earlier level that still has a
    candidate can precede a candidate. Returns early, with no candidate alive, once the bound must fall below `best`.
    """
    # unpack once: every access to a field counts a reference
    slots, measured, _, _, covariance, local, fixed = pairings
    alive, totals, innovations, w, end, level_counts, feature_counts, distances, floors, stamps = stack
    before, after, restricted = innovations[p], innovations[p + 1], p == fixed
    pivot = tree.pivot_of(slots[d], tree.read(before, d))
    q, distance, remaining, count, tests = p + 1, totals[p, d], level_counts[p] - 1, 0, 0
    levels, level, least, floor = 0, measured[d], math.inf, distance
    end[q], level_counts[q], distances[q] = 0, 0, distance
    for k in range(first, end[p]):
        c = alive[p, k]
        if measured[c] == measured[d] or feature[c] == feature[d]:
            continue
        if restricted and not tree.is_local(local, slots[d], slots[c]):
            continue
        if measured[c] != level:
            if least < math.inf:
                levels, floor, least = levels + 1, max(floor, least), math.inf
            if q + levels + remaining < best:
                return tests
            remaining, level = remaining - 1, measured[c]
        tests += 1
        e = tree.condition(covariance, w, pivot, d, p, c, slots[c], tree.read(before, c))
        # eᵀ S⁻¹ e < gate − D²_H without the division: this rejects most candidates
        numerator = e.yy * e.x * e.x - 2.0 * e.xy * e.x * e.y + e.xx * e.y * e.y
        determinant = e.xx * e.yy - e.xy * e.xy
        if not (e.xx > 0.0 and numerator < (gates[q + levels + 1] - distance) * determinant):
            continue
        total = distance + numerator / determinant
        tree.store(after, c, e)
        totals[q, c], alive[q, count] = total, c
        count, least = count + 1, min(least, total)
    if least < math.inf:
        levels, floor = levels + 1, max(floor, least)
    end[q], level_counts[q], floors[q] = count, levels, floor
    feature_counts[q] = _count_features(feature, alive[q, :count], stamps)
    return tests


@inlined
def _count_features(feature: IntArray, chosen: IntArray, stamps: IntArray) -> int:
    """Number of distinct features among the candidates `chosen`."""
    stamps[-1] += 1
    count = 0
    for c in chosen:
        if stamps[feature[c]] != stamps[-1]:
            stamps[feature[c]] = stamps[-1]
            count += 1
    return count
