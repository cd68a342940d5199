"""The interpretation tree: level by level, each measurement is paired with a feature or with nothing (`*`, NONE).

Everybody walks the same tree: `root` gives the node to start from, `branches` what may follow a node, `extend` the node
that follows, `hypothesis` the answer that a node amounts to. The joint test is incremental, O(p²) for a node of p
pairings: with S_H = L Lᵀ and y = L⁻¹ν_H kept in the node, pairing (i, j) adds

    w = L⁻¹ S_{H,ij},   e = ν_ij − wᵀy,   D² += eᵀ (S_ij − wᵀw)⁻¹ e.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.compatibility import Candidates, joint_gates
from slam_gym.types import NONE, Array, BoolArray, Effort, Hypothesis, IntArray, Prediction, Scan

_NO_PATH = np.empty(0, np.int64)
_NO_COVARIANCE = np.empty((0, 0))
_NO_INNOVATION = np.empty(0)


@dataclass(frozen=True, slots=True)
class Tree:
    """A scan's interpretation tree over its individually compatible pairings: what all walks of it share.

    Features are known by their slot: an index into `rows` and `local`, and by twos into `covariance`.
    """

    scan: Scan
    prediction: Prediction
    candidates: Candidates  # level i decides measurement candidates.measurements[i]
    given: IntArray  # (m,) row paired with each measurement before the root, NONE for the others
    rows: IntArray  # (u,) rows of the prediction: the g given ones in order of measurement, then candidates.rows
    slots: IntArray  # (c,) slot of each candidate pairing: candidates.slots + g
    covariance: Array  # (2u, 2u) [m²] joint H P Hᵀ of `rows`
    local: BoolArray | None  # (u, u) the first pairing below the root restricts the others to its locality, unless None
    gates: Array  # (g + l + 1,) χ² gate of a hypothesis by its number of pairings

    @property
    def levels(self) -> int:
        """Number of decisions from the root to a leaf."""
        return len(self.candidates.measurements)

    @property
    def pairings_given(self) -> int:
        """Number of pairings of the root."""
        return len(self.gates) - 1 - self.levels


@dataclass(frozen=True, slots=True)
class Node:
    """The decisions that lead to a node, and what the joint test needs to go on from there."""

    path: IntArray  # (level,) row of the prediction decided at each level, NONE for `*`
    slots: IntArray  # (p,) slot of each pairing, those given first
    factor: Array  # (2p, 2p) [m] L, lower triangular, S_H = L Lᵀ
    whitened: Array  # (2p,) y = L⁻¹ ν_H
    distance: float  # D²_H = yᵀy

    @property
    def level(self) -> int:
        """Decisions taken so far; the level that decides next."""
        return len(self.path)


@dataclass(frozen=True, slots=True)
class Branches:
    """What a node's measurement may be paired with, by ascending D²_ij. `*` is always legal besides, and comes last."""

    rows: IntArray  # (b,) individually compatible rows of the prediction
    individual: Array  # (b,) D²_ij
    joint: Array  # (b,) D²_H with the pairing added; inf where the feature is taken or not local
    legal: BoolArray  # (b,) the hypothesis stays jointly compatible


def interpretation_tree(
    scan: Scan,
    prediction: Prediction,
    candidates: Candidates,
    confidence: float | None = None,
    *,
    given: IntArray | None = None,
    local: bool = False,
) -> Tree:
    """The tree that decides `candidates.measurements`, in that order, with `confidence` of the joint test.

    `given` (m,): rows paired before the root, NONE elsewhere. With `local`, the first pairing below the root restricts
    those after it to its own locality. Raises ValueError where a row or a measurement is both given and a candidate, or
    where `local` is asked of a prediction without locality.
    """
    rows, slots, g = candidates.rows, candidates.slots, 0
    if given is None:
        given = np.full(len(scan.points), NONE)
    else:
        fixed = given[given != NONE]
        if (given[candidates.measurements] != NONE).any() or not set(fixed.tolist()).isdisjoint(rows.tolist()):
            raise ValueError("given: pairs measurements or features that are to be decided")
        g, rows, slots = len(fixed), np.concatenate((fixed, rows)), slots + len(fixed)
    covariance = prediction.joint(rows) if len(rows) else _NO_COVARIANCE
    among = None
    if local:
        if prediction.local is None:
            raise ValueError("local: the prediction has no locality")
        among = prediction.local(rows)
    confidence = prediction.confidence if confidence is None else confidence
    gates = joint_gates(g + len(candidates.measurements), confidence)
    return Tree(scan, prediction, candidates, given, rows, slots, covariance, among, gates)


def root(tree: Tree) -> Node:
    """The root: nothing decided but the pairings given."""
    if not tree.pairings_given:
        return Node(_NO_PATH, _NO_PATH, _NO_COVARIANCE, _NO_INNOVATION, 0.0)
    paired = np.flatnonzero(tree.given != NONE)
    slots = np.arange(len(paired))
    innovations = tree.scan.points[paired] - tree.prediction.positions[tree.rows[slots]]
    factor, whitened, distance = _factorise(tree.covariance, slots, innovations, tree.scan.covariances[paired])
    return Node(_NO_PATH, slots, factor, whitened, distance)


def branches(tree: Tree, node: Node) -> Branches:
    """What may follow `node`. Raises ValueError at a leaf."""
    first, last = _next_level(tree, node)
    slots, candidates = tree.slots[first:last], tree.candidates
    joint = node.distance + _distances_added(
        node.factor,
        node.whitened,
        node.slots,
        tree.covariance,
        slots,
        candidates.innovations[first:last],
        tree.scan.covariances[candidates.measurements[node.level]],
    )
    g = tree.pairings_given
    joint[np.isin(slots, node.slots)] = np.inf
    if tree.local is not None and len(node.slots) > g:
        joint[~tree.local[node.slots[g], slots]] = np.inf
    return Branches(tree.rows[slots], candidates.distances[first:last], joint, joint < tree.gates[len(node.slots) + 1])


def extend(tree: Tree, node: Node, row: int) -> Node:
    """The node reached by deciding the next measurement: paired with `row` of the prediction, or NONE.

    Raises ValueError at a leaf, and where the pairing is not legal.
    """
    first, _ = _next_level(tree, node)
    path = np.append(node.path, row)
    if row == NONE:
        return Node(path, node.slots, node.factor, node.whitened, node.distance)
    offer, measurement = branches(tree, node), tree.candidates.measurements[node.level]
    chosen = np.flatnonzero((offer.rows == row) & offer.legal)
    if not len(chosen):
        raise ValueError(f"row: measurement {measurement} may not be paired with row {row} after {node.path.tolist()}")
    c, slots = first + chosen[0], np.append(node.slots, tree.slots[first + chosen[0]])
    factor, whitened = _with_room(node.factor, node.whitened)
    innovation, noise = tree.candidates.innovations[c], tree.scan.covariances[measurement]
    append_pairing(factor, whitened, slots, len(slots) - 1, tree.covariance, tree.slots[c], innovation, noise)
    return Node(path, slots, factor, whitened, float(offer.joint[chosen[0]]))


def decided(tree: Tree, node: Node) -> IntArray:
    """Row of the prediction paired with each measurement of the scan, (m,); NONE for `*` and for what is undecided."""
    rows = tree.given.copy()
    rows[tree.candidates.measurements[: node.level]] = node.path
    return rows


def hypothesis(tree: Tree, node: Node, effort: Effort) -> Hypothesis:
    """The answer that `node` amounts to, with `*` for what is undecided."""
    return as_hypothesis(tree.prediction, decided(tree, node), node.distance, effort)


def as_hypothesis(
    prediction: Prediction,
    rows: IntArray,
    distance: float,
    effort: Effort,
    *,
    exclusive: bool = True,
    new: BoolArray | None = None,
) -> Hypothesis:
    """Rows of the prediction (m,), or NONE, turned into map features."""
    features, pairings = _features(prediction.features, rows)
    return Hypothesis(features, distance, 2 * pairings, effort, new=new, exclusive=exclusive)


def _next_level(tree: Tree, node: Node) -> tuple[int, int]:
    """Where the candidates of the level that decides next begin and end."""
    if node.level >= tree.levels:
        raise ValueError(f"node: at a leaf, all {tree.levels} measurements are decided")
    return int(tree.candidates.starts[node.level]), int(tree.candidates.starts[node.level + 1])


@compiled
def append_pairing(
    factor: Array,
    whitened: Array,
    slots: IntArray,
    p: int,
    covariance: Array,
    slot: int,
    innovation: Array,
    noise: Array,
) -> float:
    """Rows 2p, 2p + 1 of L and y for one more pairing, in place; what it adds to D²_H, inf where S_H turns singular.

    `factor` and `whitened` hold the p pairings of `slots[:p]`; innovation (2,) [m], noise (2, 2) [m²] in R.
    """
    a, b, x, y = 2 * p, 2 * p + 1, innovation[0], innovation[1]
    xx = covariance[2 * slot, 2 * slot] + noise[0, 0]
    xy = covariance[2 * slot, 2 * slot + 1] + noise[0, 1]
    yy = covariance[2 * slot + 1, 2 * slot + 1] + noise[1, 1]
    for r in range(2 * p):
        row = 2 * slots[r // 2] + r % 2
        u, v = covariance[row, 2 * slot], covariance[row, 2 * slot + 1]
        for q in range(r):
            u -= factor[r, q] * factor[a, q]
            v -= factor[r, q] * factor[b, q]
        u, v = u / factor[r, r], v / factor[r, r]
        factor[a, r], factor[b, r] = u, v
        x, y = x - u * whitened[r], y - v * whitened[r]
        xx, xy, yy = xx - u * u, xy - u * v, yy - v * v
    if not xx > 0.0:
        return math.inf
    factor[a, a] = math.sqrt(xx)
    factor[b, a] = xy / factor[a, a]
    rest = yy - factor[b, a] * factor[b, a]
    if not rest > 0.0:
        return math.inf
    factor[b, b] = math.sqrt(rest)
    whitened[a] = x / factor[a, a]
    whitened[b] = (y - factor[b, a] * whitened[a]) / factor[b, b]
    return float(whitened[a] * whitened[a] + whitened[b] * whitened[b])


@compiled
def _factorise(covariance: Array, slots: IntArray, innovations: Array, noise: Array) -> tuple[Array, Array, float]:
    """L (2p, 2p), y (2p,) and D² of the pairings of `slots` (p,)."""
    p = len(slots)
    factor, whitened, distance = np.zeros((2 * p, 2 * p)), np.empty(2 * p), 0.0
    for i in range(p):
        distance += append_pairing(factor, whitened, slots, i, covariance, slots[i], innovations[i], noise[i])
    return factor, whitened, distance


@compiled
def _with_room(factor: Array, whitened: Array) -> tuple[Array, Array]:
    """L and y, with room for one more pairing."""
    d = len(whitened)
    larger, longer = np.zeros((d + 2, d + 2)), np.zeros(d + 2)
    for i in range(d):
        longer[i] = whitened[i]
        for j in range(i + 1):
            larger[i, j] = factor[i, j]
    return larger, longer


@compiled
def _distances_added(
    factor: Array,
    whitened: Array,
    path_slots: IntArray,
    covariance: Array,
    slots: IntArray,
    innovations: Array,
    noise: Array,
) -> Array:
    """What each of one measurement's candidates (b,) would add to D²_H of the pairings of `path_slots` (p,)."""
    factor, whitened = _with_room(factor, whitened)
    added = np.empty(len(slots))
    for c in range(len(slots)):
        added[c] = append_pairing(
            factor, whitened, path_slots, len(path_slots), covariance, slots[c], innovations[c], noise
        )
    return added


@compiled
def _features(features: IntArray, rows: IntArray) -> tuple[IntArray, int]:
    """`features` (k,) at `rows` (m,), NONE where there is no row; and the number of rows."""
    out, count = np.full(len(rows), NONE), 0
    for i in range(len(rows)):
        if rows[i] != NONE:
            out[i] = features[rows[i]]
            count += 1
    return out, count
