"""The interpretation tree without a prior on the pose: branches are legal by constraints that hold wherever it is.

A pairing is legal when the unary constraints hold, when its distance agrees with all pairings on the path, its
orientation with the first and every other, when its feature is free, and when that is local to the feature of the first
pairing. `follows` is that rule, and the only one: `next_branch` is the branch that a depth-first search takes next, as
`gcbb` and `random_sampling` do; a `RelocationNode`, which walks go by, keeps all pairings that are still legal, since
what is illegal at a node is so in its whole subtree.

`root` gives the node to start from, `branches` what may follow a node, `extend` the node that follows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.relocation.arrays import locality_arrays, map_arrays, scan_arrays
from slam_gym.association.relocation.constraints import (
    Gates,
    Mapped,
    Measured,
    Path,
    binary_test,
    difference_covariance,
    far_apart,
    gates,
    mapped_of,
    measured,
    orientation_test,
    unary_table,
)
from slam_gym.types import UNPAIRED, Array, BoolArray, IntArray, Landmarks, Locality, Scan

NODES, UNARY, BINARY, ORIENTATION, LEAVES, JOINT, TRIES, LIMIT = range(8)
"""Entries of `Problem.effort`."""

_NOTHING = np.empty(0, np.int64)


class Where(NamedTuple):
    """Where to look for the feature of a measurement."""

    allowed: BoolArray  # (m, n) the unary constraints, looked up for every test that is counted
    traces: Array  # (n,) [m²] of the features' covariances
    starts: IntArray  # (n + 1,) L(j) is members[starts[j]:starts[j + 1]]; both empty where all is local to all
    members: IntArray


class Problem(NamedTuple):
    """A scan, a map and a locality, as the compiled searches take them, and what was spent on them."""

    scan: Measured
    mapped: Mapped
    gates: Gates
    where: Where
    effort: IntArray  # (8,)


@dataclass(frozen=True, slots=True)
class RelocationTree:
    """A scan's interpretation tree over a whole map: what all walks of it share."""

    scan: Scan
    landmarks: Landmarks
    locality: Locality | None
    problem: Problem


@dataclass(frozen=True, slots=True)
class RelocationNode:
    """The decisions that lead to a node, and what may still follow."""

    path: Path  # (p,) the pairings
    decided: BoolArray  # (m,)
    alive: BoolArray  # (m, n) pairings of undecided measurements that are legal after those of the path

    @property
    def pairings(self) -> int:
        """Number of pairings on the path."""
        return len(self.path.features)

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
        return self.pairings + int(min(alive.any(axis=1).sum(), alive.any(axis=0).sum()))


@dataclass(frozen=True, slots=True)
class RelocationBranches:
    """The features that a measurement may be paired with, by descending support, then ascending mean distance."""

    features: IntArray  # (b,)
    support: IntArray  # (b,) undecided other measurements that keep a legal partner after this pairing
    mean: Array  # (b,) D² of the distances to the pairings of the path, their mean; 0 without pairings
    worst: Array  # (b,) their largest
    local: Array  # (b,) fraction of the path's features that are local to this one; 1 without pairings


class _Outlook(NamedTuple):
    """Beyond each of one measurement's branches."""

    support: IntArray  # (b,)
    figures: Array  # (b, 3) mean, worst and local


class Branch(NamedTuple):
    """A step of a depth-first search."""

    feature: int  # or UNPAIRED
    tried: int  # candidates done with


def problem_of(scan: Scan, landmarks: Landmarks, locality: Locality | None, confidence: float) -> Problem:
    """What a search without a prior is given. Raises ValueError for bad numbers in scan, map or locality."""
    seen = scan_arrays(scan)
    arrays, chi2 = map_arrays(landmarks), gates(confidence)
    mapped, (starts, members) = mapped_of(arrays), locality_arrays(locality, len(landmarks))
    allowed = unary_table(*seen[2:], *arrays[2:5], chi2.one)
    traces = mapped.covariances[:, 0, 0] + mapped.covariances[:, 1, 1]
    effort = np.zeros(8, np.int64)
    return Problem(measured(*seen[:2]), mapped, chi2, Where(allowed, traces, starts, members), effort)


def relocation_tree(
    scan: Scan, landmarks: Landmarks, locality: Locality | None = None, confidence: float = 0.99
) -> RelocationTree:
    """The tree of a scan in a map, in the frame of the map. Raises ValueError as `problem_of` does."""
    return RelocationTree(scan, landmarks, locality, problem_of(scan, landmarks, locality, confidence))


def root(tree: RelocationTree) -> RelocationNode:
    """The root: nothing decided."""
    return RelocationNode(Path(_NOTHING, _NOTHING), np.zeros(len(tree.scan), np.bool_), tree.problem.where.allowed)


def branches(tree: RelocationTree, node: RelocationNode, measurement: int) -> RelocationBranches:
    """What `measurement` may be paired with at `node`; `*` is always legal besides."""
    candidates = np.flatnonzero(node.alive[measurement])
    ahead = _look_ahead(tree.problem, node.alive, node.path, measurement, candidates)
    order = np.lexsort((ahead.figures[:, 0], -ahead.support))
    mean, worst, local = ahead.figures[order].T
    return RelocationBranches(candidates[order], ahead.support[order], mean, worst, local)


def extend(tree: RelocationTree, node: RelocationNode, measurement: int, feature: int) -> RelocationNode:
    """The node reached by pairing `measurement` with `feature`, or with UNPAIRED.

    Raises ValueError where the measurement is decided or the pairing is not legal.
    """
    decided, alive = node.decided.copy(), node.alive.copy()
    if decided[measurement]:
        raise ValueError(f"measurement: {measurement} is decided already")
    decided[measurement], alive[measurement] = True, False
    if feature == UNPAIRED:
        return RelocationNode(node.path, decided, alive)
    if not (0 <= feature < len(tree.landmarks) and node.alive[measurement, feature]):
        raise ValueError(f"feature: measurement {measurement} may not be paired with {feature} here")
    path = Path(np.append(node.path.measurements, measurement), np.append(node.path.features, feature))
    _keep_what_follows(tree.problem, alive, path)
    return RelocationNode(path, decided, alive)


def hypothesis(tree: RelocationTree, node: RelocationNode) -> IntArray:
    """Feature paired with each measurement (m,); UNPAIRED for `*` and for what is undecided."""
    features = np.full(len(tree.scan), UNPAIRED)
    features[node.path.measurements] = node.path.features
    return features


@compiled
def follows(
    scan: Measured, mapped: Mapped, chi2: Gates, effort: IntArray, path: Path, p: int, i: int, j: int, since: int
) -> bool:
    """Whether pairing (i, j) may follow the p pairings of a path, given that it may follow the first `since` of them.

    The unary constraint and the locality of the first pairing are the caller's to see to: both say where to look. The
    first four arguments are of a `Problem`; taken out of it here, at every call, they cost as much as the tests.
    """
    for a in range(since, p):
        if path.features[a] == j:
            return False
        effort[BINARY] += 1
        if not binary_test(scan, mapped, chi2, path.measurements[a], path.features[a], i, j):
            return False
    for a in range(max(since, 1), p):
        effort[ORIENTATION] += 1
        k, l = path.measurements[a], path.features[a]
        if not orientation_test(scan, mapped, chi2, path.measurements[0], path.features[0], k, l, i, j):
            return False
    return True


@compiled
def next_branch(
    scan: Measured, mapped: Mapped, chi2: Gates, effort: IntArray, where: Where, path: Path, p: int, i: int, tried: int
) -> Branch:
    """The next feature that measurement i may be paired with after the p pairings, or UNPAIRED.

    Candidates are the features local to the first one paired, or all; the first `tried` of them are done with. The
    first five arguments are of a `Problem`, see `follows`.
    """
    positions, traces, allowed, members, gate = mapped.positions, where.traces, where.allowed, where.members, chi2.two
    restricted = p > 0 and len(where.starts) > 0
    begin, end = 0, len(traces)
    if restricted:
        begin, end = where.starts[path.features[0]], where.starts[path.features[0] + 1]
    first, x0, y0, trace, distance, spread = UNPAIRED, 0.0, 0.0, 0.0, 0.0, 0.0
    if p > 0:
        first = path.features[0]
        x0, y0, trace = positions[first, 0], positions[first, 1], traces[first]
        k = path.measurements[0]
        distance, spread = scan.distances[i, k], scan.spreads[i, k]
    for position in range(begin + tried, end):
        j = members[position] if restricted else position
        effort[UNARY] += 1
        if not allowed[i, j]:
            continue
        if p > 0:  # what `follows` would do first, with all at hand: it settles most pairings
            x, y = positions[j, 0] - x0, positions[j, 1] - y0
            if far_apart(distance - math.sqrt(x * x + y * y), spread, traces[j], trace, gate):
                effort[BINARY] += first != j
                continue
        if follows(scan, mapped, chi2, effort, path, p, i, j, 0):
            return Branch(j, position + 1 - begin)
    return Branch(UNPAIRED, end - begin)


@compiled
def _local_to(problem: Problem, feature: int) -> BoolArray:
    """(n,) L(feature)."""
    n = len(problem.where.traces)
    if len(problem.where.starts) == 0:
        return np.ones(n, np.bool_)
    local = np.zeros(n, np.bool_)
    for at in range(problem.where.starts[feature], problem.where.starts[feature + 1]):
        local[problem.where.members[at]] = True
    return local


@compiled
def _keep_what_follows(problem: Problem, alive: BoolArray, path: Path) -> None:
    """Strike from `alive` (m, n), in place, what the last pairing of the path rules out."""
    scan, mapped, chi2, effort, p = problem.scan, problem.mapped, problem.gates, problem.effort, len(path.features)
    local = _local_to(problem, path.features[p - 1])
    for k in range(alive.shape[0]):
        for l in range(alive.shape[1]):
            if not alive[k, l]:
                continue
            alive[k, l] = False
            if p > 1 or local[l]:
                alive[k, l] = follows(scan, mapped, chi2, effort, path, p, k, l, p - 1)


@compiled
def _look_ahead(problem: Problem, alive: BoolArray, path: Path, i: int, candidates: IntArray) -> _Outlook:
    """Beyond the pairings of measurement i with each of `candidates` (b,)."""
    scan, mapped, chi2, effort, p = problem.scan, problem.mapped, problem.gates, problem.effort, len(path.features)
    longer = Path(np.empty(p + 1, np.int64), np.empty(p + 1, np.int64))
    longer.measurements[:p], longer.features[:p], longer.measurements[p] = path.measurements, path.features, i
    support, figures = np.zeros(len(candidates), np.int64), np.zeros((len(candidates), 3))
    for c in range(len(candidates)):
        longer.features[p] = candidates[c]
        local = _local_to(problem, candidates[c])
        for k in range(alive.shape[0]):
            if k == i:
                continue
            for l in range(alive.shape[1]):
                if not alive[k, l] or (p == 0 and not local[l]):
                    continue
                if follows(scan, mapped, chi2, effort, longer, p + 1, k, l, p):
                    support[c] += 1
                    break
        _distances(problem, path, i, candidates[c], figures[c])
        figures[c, 2] = local[path.features].sum() / p if p > 0 else 1.0
    return _Outlook(support, figures)


@compiled
def _distances(problem: Problem, path: Path, i: int, j: int, out: Array) -> None:
    """Mean and largest D² = (g_scan − g_map)² / (σ²_scan + σ²_map) of (i, j) to the pairings of the path, or 0."""
    scan, positions, p, total, worst = problem.scan, problem.mapped.positions, len(path.features), 0.0, 0.0
    for a in range(p):
        k, l = path.measurements[a], path.features[a]
        x, y = positions[l, 0] - positions[j, 0], positions[l, 1] - positions[j, 1]
        square = max(x * x + y * y, 1e-12)
        xx, xy, yy = difference_covariance(problem.mapped, j, l)
        variance = scan.variances[i, k] + max((x * x * xx + 2.0 * x * y * xy + y * y * yy) / square, 0.0)
        distance = (scan.distances[i, k] - square**0.5) ** 2 / max(variance, 1e-12)
        total, worst = total + distance, max(worst, distance)
    out[0], out[1] = total / max(p, 1), worst
