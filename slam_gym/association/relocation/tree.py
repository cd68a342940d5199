"""The interpretation tree without a prior on the pose: branches are legal by constraints that hold wherever it is.

`root` gives the node to start from, `branches` what may follow a node, `extend` the node that follows. A pairing is
legal when the unary constraints hold, when its distance agrees with all pairings on the path, its orientation with the
first and every other, when its feature is free, and when that is local to the feature of the first pairing: the tree of
`gcbb`. What is illegal at a node is so in its whole subtree: every node keeps the pairings that are still alive, and a
new pairing filters them. Tests are counted in `counters` (8,), whose entries `association.relocation.outcome` names.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.relocation.answer import BINARY, ORIENTATION
from slam_gym.association.relocation.arrays import problem_arrays
from slam_gym.association.relocation.constraints import (
    Gates,
    Mapped,
    Measured,
    binary_test,
    difference_covariance,
    gates,
    measured,
    orientation_test,
    unary,
)
from slam_gym.types import NONE, Array, BoolArray, IntArray, Landmarks, Locality, Scan

_NOTHING = np.empty(0, np.int64)

Seen = tuple[Array, Array]
Known = tuple[Array, Array, Array, IntArray, IntArray, Array]
Rows = tuple[IntArray, IntArray]


@dataclass(frozen=True, slots=True)
class RelocationTree:
    """A scan's interpretation tree over a whole map: what all walks of it share."""

    scan: Scan
    landmarks: Landmarks
    locality: Locality | None
    unary: BoolArray  # (m, n) pairings that the unary constraints allow
    seen: Seen  # points and noise, fit for kernels
    known: Known  # positions, covariances, covariance and blocks, likewise
    rows: Rows  # locality in compressed rows, empty where all is local to all
    chi2: tuple[float, float]  # χ²_1 and χ²_2


@dataclass(frozen=True, slots=True)
class RelocationNode:
    """The decisions that lead to a node, and what may still follow."""

    measurements: IntArray  # (p,) those paired, in the order of pairing
    features: IntArray  # (p,) theirs
    decided: BoolArray  # (m,)
    alive: BoolArray  # (m, n) pairings of undecided measurements that are legal after those of the path

    @property
    def bound(self) -> int:
        """What no hypothesis below this node can exceed in pairings."""
        return self.bound_without(None)

    def bound_without(self, measurement: int | None) -> int:
        """The same with `measurement` unpaired."""
        alive = self.alive
        if measurement is not None:
            alive = alive.copy()
            alive[measurement] = False
        return len(self.features) + int(min(alive.any(axis=1).sum(), alive.any(axis=0).sum()))


@dataclass(frozen=True, slots=True)
class RelocationBranches:
    """The features that a measurement may be paired with, by descending support, then ascending mean distance."""

    features: IntArray  # (b,)
    support: IntArray  # (b,) undecided other measurements that keep a legal partner after this pairing
    mean: Array  # (b,) D² of the distances to the pairings of the path, their mean; 0 without pairings
    worst: Array  # (b,) their largest
    local: Array  # (b,) share of the path's features that are local to this one; 1 without pairings


def relocation_tree(
    scan: Scan, landmarks: Landmarks, locality: Locality | None = None, confidence: float = 0.99
) -> RelocationTree:
    """The tree of a scan in a map, in the frame of the map. Raises ValueError as `problem_arrays` does."""
    arrays, allowed = problem_arrays(scan, landmarks, locality), unary(scan, landmarks, confidence)
    return RelocationTree(
        scan, landmarks, locality, allowed, arrays.seen, arrays.of_map, arrays.local, gates(confidence)
    )


def root(tree: RelocationTree) -> RelocationNode:
    """The root: nothing decided."""
    return RelocationNode(_NOTHING, _NOTHING, np.zeros(len(tree.scan), np.bool_), tree.unary)


def branches(tree: RelocationTree, node: RelocationNode, measurement: int, counters: IntArray) -> RelocationBranches:
    """What `measurement` may be paired with at `node`; `*` is always legal besides."""
    candidates = np.flatnonzero(node.alive[measurement])
    support, figures = _look_ahead(
        tree.seen,
        tree.known,
        tree.rows,
        tree.chi2,
        node.alive,
        node.measurements,
        node.features,
        measurement,
        candidates,
        counters,
    )
    order = np.lexsort((figures[:, 0], -support))
    ranked = figures[order]
    return RelocationBranches(candidates[order], support[order], ranked[:, 0], ranked[:, 1], ranked[:, 2])


def extend(
    tree: RelocationTree, node: RelocationNode, measurement: int, feature: int, counters: IntArray
) -> RelocationNode:
    """The node reached by pairing `measurement` with `feature`, or with NONE.

    Raises ValueError where the measurement is decided or the pairing is not legal.
    """
    decided, alive = node.decided.copy(), node.alive.copy()
    if decided[measurement]:
        raise ValueError(f"measurement: {measurement} is decided already")
    decided[measurement], alive[measurement] = True, False
    if feature == NONE:
        return RelocationNode(node.measurements, node.features, decided, alive)
    if not (0 <= feature < len(tree.landmarks) and node.alive[measurement, feature]):
        raise ValueError(f"feature: measurement {measurement} may not be paired with {feature} here")
    _filter(
        tree.seen,
        tree.known,
        tree.rows,
        tree.chi2,
        alive,
        node.measurements,
        node.features,
        measurement,
        feature,
        counters,
    )
    paired, features = np.append(node.measurements, measurement), np.append(node.features, feature)
    return RelocationNode(paired, features, decided, alive)


def hypothesis(tree: RelocationTree, node: RelocationNode) -> IntArray:
    """Feature paired with each measurement (m,); NONE for `*` and for what is undecided."""
    features = np.full(len(tree.scan), NONE)
    features[node.measurements] = node.features
    return features


@compiled
def _mapped(known: Known) -> Mapped:
    return Mapped(known[0], known[1], known[2], known[3], known[4], known[5])


@compiled
def _local_to(rows: Rows, feature: int, n: int) -> BoolArray:
    """(n,) L(feature)."""
    if len(rows[0]) == 0:
        return np.ones(n, np.bool_)
    local = np.zeros(n, np.bool_)
    for at in range(rows[0][feature], rows[0][feature + 1]):
        local[rows[1][at]] = True
    return local


@compiled
def _agrees(
    scan: Measured,
    mapped: Mapped,
    chi2: Gates,
    measurements: IntArray,
    features: IntArray,
    i: int,
    j: int,
    k: int,
    l: int,
    counters: IntArray,
) -> bool:
    """Whether (k, l), legal after the path, is still so after the pairing (i, j) as well."""
    counters[BINARY] += 1
    if not binary_test(scan, mapped, chi2, i, j, k, l):
        return False
    if len(features) == 0:
        return True
    counters[ORIENTATION] += 1
    return bool(orientation_test(scan, mapped, chi2, measurements[0], features[0], i, j, k, l))


@compiled
def _filter(
    seen: Seen,
    known: Known,
    rows: Rows,
    chi2: tuple[float, float],
    alive: BoolArray,
    measurements: IntArray,
    features: IntArray,
    i: int,
    j: int,
    counters: IntArray,
) -> None:
    """Strike from `alive` (m, n), in place, what is illegal after the pairing (i, j)."""
    scan, mapped, allowed = measured(seen[0], seen[1]), _mapped(known), Gates(chi2[0], chi2[1])
    local = _local_to(rows, j, alive.shape[1])
    first = len(features) == 0
    for k in range(alive.shape[0]):
        for l in range(alive.shape[1]):
            if not alive[k, l]:
                continue
            if l == j or (first and not local[l]):
                alive[k, l] = False
            else:
                alive[k, l] = _agrees(scan, mapped, allowed, measurements, features, i, j, k, l, counters)


@compiled
def _look_ahead(
    seen: Seen,
    known: Known,
    rows: Rows,
    chi2: tuple[float, float],
    alive: BoolArray,
    measurements: IntArray,
    features: IntArray,
    i: int,
    candidates: IntArray,
    counters: IntArray,
) -> tuple[IntArray, Array]:
    """Support (b,) of pairing i with each of `candidates` (b,); mean and worst D², share local (b, 3)."""
    scan, mapped, allowed = measured(seen[0], seen[1]), _mapped(known), Gates(chi2[0], chi2[1])
    support, figures = np.zeros(len(candidates), np.int64), np.zeros((len(candidates), 3))
    first = len(features) == 0
    for c in range(len(candidates)):
        j = candidates[c]
        local = _local_to(rows, j, alive.shape[1])
        for k in range(alive.shape[0]):
            if k == i:
                continue
            for l in range(alive.shape[1]):
                if not alive[k, l] or l == j or (first and not local[l]):
                    continue
                if _agrees(scan, mapped, allowed, measurements, features, i, j, k, l, counters):
                    support[c] += 1
                    break
        figures[c, 0], figures[c, 1] = _distances(scan, mapped, measurements, features, i, j)
        figures[c, 2] = local[features].sum() / len(features) if len(features) else 1.0
    return support, figures


@compiled
def _distances(
    scan: Measured, mapped: Mapped, measurements: IntArray, features: IntArray, i: int, j: int
) -> tuple[float, float]:
    """Mean and largest D² = (g_scan − g_map)² / (σ²_scan + σ²_map) of (i, j) to the pairings of the path, or 0."""
    total, worst = 0.0, 0.0
    for a in range(len(features)):
        k, l = measurements[a], features[a]
        x, y = mapped.positions[l, 0] - mapped.positions[j, 0], mapped.positions[l, 1] - mapped.positions[j, 1]
        square = max(x * x + y * y, 1e-12)
        xx, xy, yy = difference_covariance(mapped, j, l)
        variance = scan.variances[i, k] + max((x * x * xx + 2.0 * x * y * xy + y * y * yy) / square, 0.0)
        distance = (scan.distances[i, k] - square**0.5) ** 2 / max(variance, 1e-12)
        total, worst = total + distance, max(worst, distance)
    return total / max(len(features), 1), worst
