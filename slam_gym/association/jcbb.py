"""JCBB: joint compatibility branch and bound (Neira and Tardós, IEEE TRA 17(6), 2001), with covisibility locality."""

from __future__ import annotations

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.tree import Node, Tree, append_pairing, as_hypothesis, interpretation_tree, root
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

    Depth first, branches by ascending D²_ij and `*` last. The bound of a branch is its pairings so far + min(levels
    left with a candidate, distinct candidate features left unused); it is visited if its bound beats the best, or
    equals it while its D²_H is below the best's. Returns the row paired with each measurement (m,), or NONE; D²_H; and
    the effort.
    """
    candidates = tree.candidates
    best, distance, nodes, tests, limit_hit = _search(
        candidates.starts,
        tree.slots,
        candidates.innovations,
        tree.scan.covariances[candidates.measurements],
        tree.covariance,
        _ALL_LOCAL if tree.local is None else tree.local,
        tree.local is not None,
        tree.gates,
        tree.pairings_given,
        node.level,
        node.slots,
        node.factor,
        node.whitened,
        node.distance,
        node_limit,
    )
    rows = tree.given.copy()
    rows[candidates.measurements[: node.level]] = node.path
    paired = best != NONE
    rows[candidates.measurements[paired]] = tree.rows[best[paired]]
    return rows, distance, Effort(nodes, candidates.tests, tests, limit_hit)


@compiled
def _search(
    starts: IntArray,
    slots: IntArray,
    innovations: Array,
    noise: Array,
    covariance: Array,
    local: BoolArray,
    restricted: bool,
    gates: Array,
    given: int,
    top: int,
    path_slots: IntArray,
    path_factor: Array,
    path_whitened: Array,
    path_distance: float,
    node_limit: int,
) -> tuple[IntArray, float, int, int, bool]:
    """Slot paired at each level below `top` (levels,) or NONE, D²_H, nodes, joint tests, limit hit.

    At level l with p pairings: chosen[:p] their slots, distance[p] their D², cursor[l] the candidate to try next.
    """
    levels, held = len(starts) - 1, len(path_slots)
    factor, whitened = np.empty((2 * len(gates), 2 * len(gates))), np.empty(2 * len(gates))
    chosen, distance = np.empty(len(gates), np.int64), np.empty(len(gates))
    factor[: 2 * held, : 2 * held], whitened[: 2 * held] = path_factor, path_whitened
    chosen[:held], distance[held] = path_slots, path_distance
    levels_left, features_left, last_level = _what_is_left(starts, slots, len(covariance) // 2)
    decision, best = np.full(levels + 1, NONE), np.full(levels, NONE)
    used = np.zeros(len(last_level), np.bool_)
    for slot in path_slots:
        used[slot] = True
    cursor = starts.copy()
    level, p, best_p, best_distance = top, held, held, path_distance
    nodes, tests, limit_hit = 0, 0, False
    while level >= top:
        # take back the pairing that this level tried before
        if decision[level] != NONE:
            used[decision[level]] = False
            decision[level] = NONE
            p -= 1
        if level == levels or cursor[level] > starts[level + 1]:
            level -= 1
            continue
        c = cursor[level]
        cursor[level] += 1
        slot = slots[c] if c < starts[level + 1] else NONE
        bound = p + _left(levels_left, features_left, last_level, level + 1, chosen, p, slot)
        if bound < best_p or (bound == best_p and not distance[p] < best_distance):
            continue
        if slot != NONE:
            if used[slot] or (restricted and p > given and not local[chosen[given], slot]):
                continue
            tests += 1
            total = distance[p] + append_pairing(
                factor, whitened, chosen, p, covariance, slot, innovations[c], noise[level]
            )
            if not total < gates[p + 1] or (bound == best_p and not total < best_distance):
                continue
        if nodes == node_limit:
            limit_hit = True
            break
        nodes += 1
        if slot != NONE:
            decision[level], chosen[p], distance[p + 1], used[slot] = slot, slot, total, True
            p += 1
            if p > best_p or (p == best_p and total < best_distance):
                best_p, best_distance = p, total
                best[:] = decision[:levels]
        level += 1
        if level < levels:
            cursor[level] = starts[level]
    return best, best_distance, nodes, tests, limit_hit


@compiled
def _what_is_left(starts: IntArray, slots: IntArray, features: int) -> tuple[IntArray, IntArray, IntArray]:
    """By level (levels + 1,): levels from there on with a candidate, distinct features among their candidates; and by
    slot (features,): the last level at which it is a candidate, −1 where it is at none."""
    levels = len(starts) - 1
    levels_left, features_left = np.zeros(levels + 1, np.int64), np.zeros(levels + 1, np.int64)
    last_level = np.full(features, -1)
    for level in range(levels - 1, -1, -1):
        levels_left[level] = levels_left[level + 1] + (1 if starts[level + 1] > starts[level] else 0)
        features_left[level] = features_left[level + 1]
        for c in range(starts[level], starts[level + 1]):
            if last_level[slots[c]] < 0:
                last_level[slots[c]] = level
                features_left[level] += 1
    return levels_left, features_left, last_level


@compiled
def _left(
    levels_left: IntArray,
    features_left: IntArray,
    last_level: IntArray,
    level: int,
    chosen: IntArray,
    p: int,
    slot: int,
) -> int:
    """Pairings that a branch may still gain: its own (`slot` ≠ NONE), and those from `level` on."""
    unused = int(features_left[level])
    for q in range(p):
        if last_level[chosen[q]] >= level:
            unused -= 1
    if slot == NONE:
        return min(int(levels_left[level]), unused)
    if last_level[slot] >= level:
        unused -= 1
    return 1 + min(int(levels_left[level]), unused)
