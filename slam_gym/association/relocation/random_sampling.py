"""RS: relocation by random sampling (Neira, Tardós and Castellanos, ICRA 2003), with locality."""

import math

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.relocation.constraints import Path
from slam_gym.association.relocation.location import place_of
from slam_gym.association.relocation.problem import (
    INDEX,
    Best,
    Problem,
    fewest,
    joint_distance,
    must_end,
    offer,
    searched,
)
from slam_gym.association.relocation.tree import next_branch
from slam_gym.types import UNPAIRED, Array, IntArray, Landmarks, Locality, Relocation, Scan
from slam_gym.validation import check_count

_SAMPLE = 3  # number of measurements in a sample
_STAR = -1  # in place of a candidate: `*` was tried, no candidates are left


def random_sampling(
    scan: Scan,
    landmarks: Landmarks,
    locality: Locality | None = None,
    *,
    confidence: float = 0.99,
    tries: int = 8,
    seed: int | np.random.Generator = 0,
    min_pairings: int | None = None,
    node_limit: int = 1_000_000,
) -> Relocation:
    """The largest hypothesis grown from random samples of the measurements.

    Each of `tries` tries takes three measurements at random and pairs all of them, depth first and without `*`, under
    the location-independent constraints and the locality of the first feature. Every triple of jointly compatible
    pairings implies a pose, from which JCBB decides the other measurements: candidates must be compatible at that pose,
    and jointly with all previous pairings, where the pose is computed again with every pairing (χ²_{2k−3}). Poses that
    cannot yield as many pairings as the best are abandoned at once. So a scan from outside the map costs no more than
    one from inside.

    All samples are bad with probability P_fail after log P_fail / log(1 − P_good³) tries, where P_good is the fraction
    of measurements that come from features of the map: 8 tries for 0.05 and 0.7. `seed` is that of the samples, or a
    generator to draw them from. `node_limit` bounds the nodes of all trees together. `min_pairings`, the limits and the
    errors are those of `gcbb`; fewer tries than one are an error, too.
    """
    check_count("tries", tries)
    check_count("node_limit", node_limit)
    rng, m = np.random.default_rng(seed), len(scan)
    drawn = tries if m >= _SAMPLE else 0
    samples = np.array([rng.permutation(m)[:_SAMPLE] for _ in range(drawn)], np.int64).reshape(drawn, _SAMPLE)

    def search(problem: Problem, best: Best) -> None:
        _random_sampling(problem, samples, node_limit, best)

    return searched(scan, landmarks, locality, confidence, min_pairings, search)


@compiled
def _random_sampling(problem: Problem, samples: IntArray, node_limit: int, best: Best) -> None:
    """Enter the hypotheses of all tries in `best`: each complete pairing of each sample is extended."""
    m, size, effort = len(problem.allowed), samples.shape[1], problem.effort
    tried = np.zeros(size + 1, np.int64)
    path = Path(np.empty(m, np.int64), np.empty(m, np.int64))
    for sample in samples:
        effort[INDEX.tries] += effort[INDEX.limit_hit] == 0
        p = tried[0] = 0
        while p >= 0 and effort[INDEX.limit_hit] == 0:
            if p == size:
                effort[INDEX.leaves] += 1
                _extend(best, problem, path, p, node_limit)
                p -= 1
                continue
            feature, tried[p] = next_branch(problem, path, p, sample[p], tried[p])
            if feature == UNPAIRED:
                p -= 1
                continue
            if must_end(effort, node_limit):
                break
            effort[INDEX.nodes] += 1
            path.measurements[p], path.features[p] = sample[p], feature
            p += 1
            tried[p] = 0


@compiled
def _extend(best: Best, problem: Problem, path: Path, p: int, node_limit: int) -> None:
    """JCBB over the other measurements, from the pose of p pairings; every prefix is located and tested again."""
    effort, pose, covariance = problem.effort, np.empty(3), np.empty((3, 3))
    if joint_distance(problem, path, p, pose, covariance) == math.inf:
        return
    levels, candidates = _compatible(problem, path, p, pose, covariance)
    level, depth = 0, len(levels)
    # by level: the pairings above it, and the candidates tried
    above, tried = np.full(depth + 1, p), np.zeros(depth + 1, np.int64)
    while level >= 0:
        q = above[level]
        if tried[level] == _STAR or q + depth - level < fewest(best, True):
            level -= 1
            continue
        if level == depth:
            offer(best, problem, path, q)
            level -= 1
            continue
        paired = False
        while tried[level] < len(candidates[level]) and not paired:
            path.measurements[q], path.features[q] = levels[level], candidates[level][tried[level]]
            free = not (path.features[:q] == path.features[q]).any()
            paired = free and joint_distance(problem, path, q + 1, pose, covariance) < math.inf
            tried[level] += 1
        if not paired:
            tried[level] = _STAR
        if must_end(effort, node_limit):
            return
        effort[INDEX.nodes] += 1
        level += 1
        above[level], tried[level] = q + paired, 0


@compiled
def _compatible(
    problem: Problem, path: Path, p: int, pose: Array, covariance: Array
) -> tuple[list[int], list[IntArray]]:
    """Measurements other than the first p of a path that have candidates, and their compatible features, by ascending
    D²_ij.

    Compatibility is tested at the pose of these p pairings. Features are local to the first one paired. The gate
    assumes that pose and features are independent. Where a common drift correlates them it is too wide, and the joint
    test decides.
    """
    scan, F, P, first = problem.scan, problem.mapped.positions, problem.mapped.covariances, path.features[0]
    local = np.arange(len(F))
    if len(problem.starts) > 0:
        local = problem.members[problem.starts[first] : problem.starts[first + 1]]
    measurements, features, squares = [0 for _ in range(0)], [local for _ in range(0)], np.empty(len(local))
    for i in range(len(scan.points)):
        x, y, xx, xy, yy = place_of(scan.points, scan.noise, i, pose, covariance)
        for k in range(len(local)):
            j, squares[k] = local[k], math.inf
            dx, dy, sxx, sxy, syy = F[j, 0] - x, F[j, 1] - y, xx + P[j, 0, 0], xy + P[j, 0, 1], yy + P[j, 1, 1]
            if problem.allowed[i, j] and dx * dx < scan.gate_two * sxx:
                squares[k] = (syy * dx * dx - 2.0 * sxy * dx * dy + sxx * dy * dy) / (sxx * syy - sxy * sxy)
        near = np.flatnonzero(squares < scan.gate_two)
        if len(near) > 0 and not (path.measurements[:p] == i).any():
            measurements.append(i)
            features.append(local[near[np.argsort(squares[near], kind="mergesort")]])
    return measurements, features
