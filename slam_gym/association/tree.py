"""The interpretation tree: level by level, each measurement is paired with a feature or with nothing (`*`, UNPAIRED).

All searches use the same tree. `root` returns the first node, `branches` the pairings that may follow a node, `extend`
the node that follows, `hypothesis` the hypothesis of a node. A node stores all pairings that may still follow it,
conditioned on its own pairings H. With S_H = L Lᵀ and y = L⁻¹ν_H, a candidate pairing c has

    w_c = L⁻¹ S_{H,c},   e_c = ν_c − w_cᵀy,   S_c|H = S_c − w_cᵀw_c,   D² of H ∪ {c} = D²_H + e_cᵀ (S_c|H)⁻¹ e_c.

A further pairing d appends two rows to every w_c: with S_d|H = l lᵀ,

    v = l⁻¹ (S_dc − w_dᵀw_c),   w_c ← (w_c, v),   e_c ← e_c − vᵀ l⁻¹e_d,   S_c|H ← S_c|H − vᵀv.

This is a Cholesky factorisation of the path that is updated for every candidate, in O(|H|) for each; nothing is
factored a second time. `condition` implements this step. Branch and bound applies it to all
candidates that may still become legal, a walk and 1-point RANSAC to all candidates of later levels, the beam to one
candidate at a time.
"""

import math
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled, inlined
from slam_gym.association.compatibility import Candidates, joint_gates
from slam_gym.association.prediction import Prediction
from slam_gym.types import UNPAIRED, Array, BoolArray, Effort, Hypothesis, IntArray, Scan


class Pairings(NamedTuple):
    """The candidate pairings as compiled functions take them: first the fixed pairings, then those of each level.

    Features are identified by their slot.
    """

    slots: IntArray  # (c,) feature of the pairing
    measured: IntArray  # (c,) its measurement
    innovations: Array  # (c, 2) [m] ν_c in R
    noise: Array  # (m, 2, 2) [m²] of the measurements
    covariance: Array  # (2u, 2u) [m²] joint H P Hᵀ of the features
    local: BoolArray  # (u, u) which features are local to each other; (0, 0): all are local to all
    fixed: int  # number of fixed pairings, those of the root; they come first


class Tree(NamedTuple):
    """A scan's interpretation tree over its individually compatible pairings: the data shared by all walks of it."""

    scan: Scan
    prediction: Prediction
    candidates: Candidates  # level i decides measurement candidates.measurements[i]
    pairings: Pairings
    gates: Array  # (g + l + 1,) χ² gate of a hypothesis, by its number of pairings

    @property
    def levels(self) -> int:
        """Number of decisions from the root to a leaf."""
        return len(self.candidates.measurements)

    def level(self, number: int) -> tuple[int, int]:
        """Indices of the first pairing of a level and of the first one after it."""
        first, last = self.candidates.starts[number : number + 2].tolist()
        return first, last


class Innovation(NamedTuple):
    """e and S of a pairing, conditioned on the pairings before it."""

    x: float  # [m]
    y: float
    xx: float  # [m²]
    xy: float
    yy: float


class Pivot(NamedTuple):
    """l⁻¹ and l⁻¹e of a pairing that joins the path, with S = l lᵀ: what `condition` applies to the candidates."""

    slot: int
    inverse_xx: float  # 1 / l_xx
    yx: float  # l_yx
    inverse_yy: float  # 1 / l_yy
    u: float  # l⁻¹e
    v: float


class Node(NamedTuple):
    """The decisions that lead to a node, and the pairings that may follow, conditioned on its pairings H."""

    level: int  # number of decisions taken so far; the level to decide next
    path: IntArray  # (p,) the pairings in order, fixed ones first
    distance: float  # D²_H
    innovations: Array  # (c, 5) `Innovation` of pairings of later levels given H; of pairings in H, as they joined it
    added: Array  # (c,) increase of D²_H by each pairing of later levels
    w: Array  # (c, 2p + 2, 2) their w, with room for the rows of one more pairing


class Branches(NamedTuple):
    """Features that a node's measurement may be paired with, by ascending D²_ij. `*` is always legal and not listed."""

    rows: IntArray  # (b,) individually compatible rows of the prediction
    individual: Array  # (b,) D²_ij
    joint: Array  # (b,) D²_H with the pairing added; inf where the feature is already paired or not local
    legal: BoolArray  # (b,) whether the hypothesis stays jointly compatible


def interpretation_tree(scan: Scan, prediction: Prediction, candidates: Candidates) -> Tree:
    """The tree that decides `candidates.measurements` in that order, at the confidence of the prediction."""
    covariance, all_local = prediction.joint(candidates.rows), np.empty((0, 0), np.bool_)
    slots, measured, innovations = candidates.slots, candidates.measured, candidates.innovations
    pairings = Pairings(slots, measured, innovations, scan.arrays[1], covariance, all_local, 0)
    gates = joint_gates(len(candidates.measurements), prediction.confidence)
    return Tree(scan, prediction, candidates, pairings, gates)


def root(tree: Tree) -> Node:
    """The root: nothing is decided but the fixed pairings."""
    return root_of(tree.pairings)


def branches(tree: Tree, node: Node) -> Branches:
    """The branches of `node`. Raises ValueError at a leaf."""
    if node.level >= tree.levels:
        raise ValueError(f"node: at a leaf, all {tree.levels} measurements are decided")
    first, last = tree.level(node.level)
    joint = node.distance + added_by(tree.pairings, node.path, node.added, first, last)
    rows = tree.candidates.rows[tree.pairings.slots[first:last]]
    legal = joint < tree.gates[len(node.path) + 1]
    return Branches(rows, tree.candidates.distances[first:last], joint, legal)


def extend(tree: Tree, node: Node, row: int) -> Node:
    """The node after the next measurement is paired with `row` of the prediction, or left UNPAIRED.

    Raises ValueError at a leaf, and where the pairing is not legal.
    """
    offer = branches(tree, node)
    if row == UNPAIRED:
        return node._replace(level=node.level + 1)
    chosen = np.flatnonzero((offer.rows == row) & offer.legal)
    if not len(chosen):
        measurement = tree.candidates.measurements[node.level]
        raise ValueError(f"row: measurement {measurement} may not be paired with row {row} after {decided(tree, node)}")
    first, last = tree.level(node.level)
    return add_pairing(tree.pairings, node, first + int(chosen[0]), last)


def decided(tree: Tree, node: Node) -> IntArray:
    """Row of the prediction paired with each measurement, (m,); UNPAIRED for `*` and for undecided measurements."""
    rows, pairings = np.full(len(tree.scan), UNPAIRED), tree.pairings
    rows[pairings.measured[node.path]] = tree.candidates.rows[pairings.slots[node.path]]
    return rows


def hypothesis(
    tree: Tree, node: Node, effort: Effort, *, exclusive: bool = True, new: BoolArray | None = None
) -> Hypothesis:
    """The hypothesis of `node`, with `*` for undecided measurements. For `exclusive` and `new` see `Hypothesis`."""
    rows = decided(tree, node)
    paired, features = rows != UNPAIRED, np.full(len(rows), UNPAIRED)
    features[paired] = tree.prediction.features[rows[paired]]
    return Hypothesis(features, node.distance, 2 * len(node.path), effort, new=new, exclusive=exclusive)


@inlined
def innovation_of(pairings: Pairings, c: int) -> Innovation:
    """ν and S of a pairing, without any conditioning."""
    i, s, P = pairings.measured[c], 2 * pairings.slots[c], pairings.covariance
    xx, xy = P[s, s] + pairings.noise[i, 0, 0], P[s, s + 1] + pairings.noise[i, 0, 1]
    return Innovation(
        pairings.innovations[c, 0], pairings.innovations[c, 1], xx, xy, P[s + 1, s + 1] + pairings.noise[i, 1, 1]
    )


@inlined
def squared(e: Innovation) -> float:
    """D² = eᵀS⁻¹e; inf where S is not positive definite."""
    determinant = e.xx * e.yy - e.xy * e.xy
    if not (e.xx > 0.0 and determinant > 0.0):
        return math.inf
    return (e.yy * e.x * e.x - 2.0 * e.xy * e.x * e.y + e.xx * e.y * e.y) / determinant


@inlined
def pivot_of(slot: int, e: Innovation) -> Pivot:
    """The pivot of a pairing with innovation e, conditioned on all pairings before it."""
    xx = math.sqrt(e.xx)
    yx = e.xy / xx
    yy = math.sqrt(e.yy - yx * yx)
    u = e.x / xx
    return Pivot(slot, 1.0 / xx, yx, 1.0 / yy, u, (e.y - yx * u) / yy)


@inlined
def condition(
    covariance: Array, w: Array, pivot: Pivot, d: int, p: int, c: int, slot: int, e: Innovation
) -> Innovation:
    """Condition candidate c, whose innovation is e, on a pairing that joins the path. Returns its new e and S.

    `pivot` is the pivot of that pairing, the p-th of the path. w[d] is the w of the pairing, w[c] that of the
    candidate; rows 2p and 2p + 1 of w[c] are written.
    """
    a, b = 2 * pivot.slot, 2 * slot
    s00, s01, s10, s11 = covariance[a, b], covariance[a, b + 1], covariance[a + 1, b], covariance[a + 1, b + 1]
    for r in range(2 * p):
        s00 -= w[d, r, 0] * w[c, r, 0]
        s01 -= w[d, r, 0] * w[c, r, 1]
        s10 -= w[d, r, 1] * w[c, r, 0]
        s11 -= w[d, r, 1] * w[c, r, 1]
    s00, s01 = s00 * pivot.inverse_xx, s01 * pivot.inverse_xx
    s10, s11 = (s10 - pivot.yx * s00) * pivot.inverse_yy, (s11 - pivot.yx * s01) * pivot.inverse_yy
    w[c, 2 * p, 0], w[c, 2 * p, 1], w[c, 2 * p + 1, 0], w[c, 2 * p + 1, 1] = s00, s01, s10, s11
    return Innovation(
        e.x - s00 * pivot.u - s10 * pivot.v,
        e.y - s01 * pivot.u - s11 * pivot.v,
        e.xx - s00 * s00 - s10 * s10,
        e.xy - s00 * s01 - s10 * s11,
        e.yy - s01 * s01 - s11 * s11,
    )


@inlined
def is_local(local: BoolArray, anchor: int, slot: int) -> bool:
    """Whether a feature is local to `anchor`, that of the first pairing below the root; an empty `local` allows all
    features."""
    return bool(local.size == 0 or local[anchor, slot])


@inlined
def may_follow(pairings: Pairings, path: IntArray, p: int, c: int) -> bool:
    """Whether the feature of pairing c is not among the p pairings of a path, and is local to that of the first one."""
    for q in range(p):
        if pairings.slots[path[q]] == pairings.slots[c]:
            return False
    if p > pairings.fixed:
        return is_local(pairings.local, pairings.slots[path[pairings.fixed]], pairings.slots[c])
    return True


@inlined
def store(innovations: Array, c: int, e: Innovation) -> None:
    """Write an innovation to row c of (c, 5)."""
    innovations[c, 0], innovations[c, 1] = e.x, e.y
    innovations[c, 2], innovations[c, 3], innovations[c, 4] = e.xx, e.xy, e.yy


@inlined
def read(innovations: Array, c: int) -> Innovation:
    """The innovation in row c."""
    return Innovation(innovations[c, 0], innovations[c, 1], innovations[c, 2], innovations[c, 3], innovations[c, 4])


@inlined
def condition_on_fixed(pairings: Pairings, innovations: Array, w: Array) -> float:
    """Write the innovations (c, 5) of all pairings given the fixed ones before them, and w. Returns D² of the fixed."""
    slots, distance = pairings.slots, 0.0
    for c in range(len(slots)):
        store(innovations, c, innovation_of(pairings, c))
    for d in range(pairings.fixed):
        e = read(innovations, d)
        pivot, distance = pivot_of(slots[d], e), distance + squared(e)
        for c in range(d + 1, len(slots)):
            store(innovations, c, condition(pairings.covariance, w, pivot, d, d, c, slots[c], read(innovations, c)))
    return distance


@compiled
def root_of(pairings: Pairings) -> Node:
    """`root`, compiled."""
    count, fixed = len(pairings.slots), pairings.fixed
    innovations, added, w = np.empty((count, 5)), np.empty(count), np.empty((count, 2 * fixed + 2, 2))
    distance = condition_on_fixed(pairings, innovations, w)
    for c in range(fixed, count):
        added[c] = squared(read(innovations, c))
    return Node(0, np.arange(fixed), distance, innovations, added, w)


@compiled
def add_pairing(pairings: Pairings, node: Node, d: int, following: int) -> Node:
    """The node after pairing d, with the pairings from index `following` on conditioned on it."""
    p, count, slots = len(node.path), len(pairings.slots), pairings.slots
    path, innovations, added = np.empty(p + 1, np.int64), np.empty((count, 5)), np.empty(count)
    w, pivot = np.empty((count, 2 * p + 4, 2)), pivot_of(slots[d], read(node.innovations, d))
    for q in range(p):
        path[q] = node.path[q]
    path[p] = d
    for q in range(p + 1):
        store(innovations, path[q], read(node.innovations, path[q]))
        for r in range(2 * p):
            w[path[q], r, 0], w[path[q], r, 1] = node.w[path[q], r, 0], node.w[path[q], r, 1]
    for c in range(following, count):
        for r in range(2 * p):
            w[c, r, 0], w[c, r, 1] = node.w[c, r, 0], node.w[c, r, 1]
        e = condition(pairings.covariance, w, pivot, d, p, c, slots[c], read(node.innovations, c))
        store(innovations, c, e)
        added[c] = squared(e)
    return Node(node.level + 1, path, node.distance + node.added[d], innovations, added, w)


@compiled
def added_by(pairings: Pairings, path: IntArray, added: Array, first: int, last: int) -> Array:
    """The increase of D²_H by each of the pairings first … last − 1, (last − first,); inf where one may not follow."""
    out = np.empty(last - first)
    for c in range(first, last):
        out[c - first] = added[c] if may_follow(pairings, path, len(path), c) else math.inf
    return out
