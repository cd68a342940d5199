"""The interpretation tree without a prior on the pose: branches are legal by constraints that hold for any pose.

A pairing is legal under four conditions: it satisfies the unary constraints; its distances agree with all pairings on
the path, and its orientation with the first and every other one; its feature is unused; and this is local to the
feature of the first pairing. `follows` is the only implementation of this rule. `next_branch` returns the next branch
of a depth-first search, for `gcbb` and `random_sampling`. Walks store all pairings that are still legal
(`keep_what_follows`), since a pairing that is illegal at a node is illegal in its whole subtree.
"""

import math

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.relocation import constraints
from slam_gym.association.relocation.constraints import Mapped, Measured, Path
from slam_gym.association.relocation.problem import INDEX, Problem
from slam_gym.types import UNPAIRED, Array, BoolArray, IntArray


@compiled
def follows(scan: Measured, mapped: Mapped, effort: IntArray, path: Path, p: int, i: int, j: int, since: int) -> bool:
    """Whether pairing (i, j) may follow the p pairings of a path, if it may follow the first `since` of them.

    The caller checks the unary constraint and the locality of the first pairing, since both determine where to search.
    The first three arguments are fields of a `Problem`: to read them here, at every call, would cost as much as the
    tests.
    """
    measurements, features = path
    for a in range(since, p):
        if features[a] == j:
            return False
        effort[INDEX.binary_tests] += 1
        if not constraints.binary_test(scan, mapped, measurements[a], features[a], i, j):
            return False
    for a in range(max(since, 1), p):
        effort[INDEX.orientation_tests] += 1
        corners, of_map = (measurements[0], measurements[a], i), (features[0], features[a], j)
        if not constraints.orientation_test(scan, mapped, corners, of_map):
            return False
    return True


@compiled
def next_branch(problem: Problem, path: Path, p: int, i: int, tried: int) -> tuple[int, int]:
    """The next feature that may be paired with measurement i after p pairings, or UNPAIRED; number of candidates
    examined.

    Candidates are the features local to the first one paired, or all. The first `tried` of them were examined before.
    """
    scan, mapped, effort, allowed = problem.scan, problem.mapped, problem.effort, problem.allowed
    F, P, starts, members, gate = mapped.positions, mapped.covariances, problem.starts, problem.members, scan.gate_two
    begin, end, x, y, trace, distance, spread = 0, len(F), 0.0, 0.0, 0.0, 0.0, 0.0
    first, restricted = path.features[0] if p > 0 else UNPAIRED, p > 0 and len(starts) > 0
    if restricted:
        begin, end = starts[first], starts[first + 1]
    if p > 0:
        x, y, trace = F[first, 0], F[first, 1], P[first, 0, 0] + P[first, 1, 1]
        distance, spread = scan.distances[i, path.measurements[0]], scan.spreads[i, path.measurements[0]]
    for at in range(begin + tried, end):
        j = members[at] if restricted else at
        effort[INDEX.unary_tests] += 1
        if not allowed[i, j]:
            continue
        if p > 0:  # the first test of `follows`, with values read once: it settles most pairings
            error = distance - math.sqrt((F[j, 0] - x) ** 2 + (F[j, 1] - y) ** 2)
            if constraints.far_apart(error, spread, P[j, 0, 0] + P[j, 1, 1], trace, gate):
                effort[INDEX.binary_tests] += first != j
                continue
        if follows(scan, mapped, effort, path, p, i, j, 0):
            return j, at + 1 - begin
    return UNPAIRED, end - begin


@compiled
def _local_to(problem: Problem, feature: int) -> BoolArray:
    """(n,) mask of L(feature)."""
    starts, local = problem.starts, np.full(len(problem.mapped.positions), len(problem.starts) == 0)
    if len(starts) > 0:
        for at in range(starts[feature], starts[feature + 1]):
            local[problem.members[at]] = True
    return local


@compiled
def keep_what_follows(problem: Problem, alive: BoolArray, path: Path) -> None:
    """Clear in `alive` (m, n), in place, the pairings that the last pairing of the path rules out."""
    scan, mapped, effort, p = problem.scan, problem.mapped, problem.effort, len(path.features)
    local = _local_to(problem, path.features[p - 1])
    for k in range(alive.shape[0]):
        for l in range(alive.shape[1]):
            if alive[k, l]:
                alive[k, l] = (p > 1 or local[l]) and follows(scan, mapped, effort, path, p, k, l, p - 1)


@compiled
def look_ahead(problem: Problem, alive: BoolArray, path: Path, i: int, candidates: IntArray) -> tuple[IntArray, Array]:
    """Support (b,), and mean, worst and local (b, 3), of pairing measurement i with each of `candidates` (b,)."""
    scan, mapped, effort, positions = problem.scan, problem.mapped, problem.effort, problem.mapped.positions
    p = len(path.features)
    longer = Path(np.empty(p + 1, np.int64), np.empty(p + 1, np.int64))
    longer.measurements[:p], longer.features[:p], longer.measurements[p] = path.measurements, path.features, i
    support, figures = np.zeros(len(candidates), np.int64), np.zeros((len(candidates), 3))
    for c in range(len(candidates)):
        j = longer.features[p] = candidates[c]
        local = _local_to(problem, j)
        for k in range(alive.shape[0]):
            for l in range(alive.shape[1] if k != i else 0):
                if alive[k, l] and (p > 0 or local[l]) and follows(scan, mapped, effort, longer, p + 1, k, l, p):
                    support[c] += 1
                    break
        total, worst = 0.0, 0.0
        for a in range(p):
            k, l = path.measurements[a], path.features[a]
            x, y = positions[l, 0] - positions[j, 0], positions[l, 1] - positions[j, 1]
            square = max(x * x + y * y, 1e-12)
            xx, xy, yy = constraints.difference_covariance(mapped, j, l)
            variance = scan.variances[i, k] + max((x * x * xx + 2.0 * x * y * xy + y * y * yy) / square, 0.0)
            distance = (scan.distances[i, k] - square**0.5) ** 2 / max(variance, 1e-12)
            total, worst = total + distance, max(worst, distance)
        figures[c, 0], figures[c, 1] = total / max(p, 1), worst
        figures[c, 2] = local[path.features].sum() / p if p > 0 else 1.0
    return support, figures
