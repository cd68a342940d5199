"""RS: relocation by random sampling (Neira, Tardós and Castellanos, ICRA 2003), with locality."""

from __future__ import annotations

import math
import time
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.relocation.answer import (
    Best,
    decide,
    keep,
    location_gates,
    nothing_found,
    relocation,
)
from slam_gym.association.relocation.constraints import Mapped, Path
from slam_gym.association.relocation.location import locate_pairings
from slam_gym.association.relocation.tree import (
    JOINT,
    LEAVES,
    LIMIT,
    NODES,
    TRIES,
    Problem,
    next_branch,
    problem_of,
)
from slam_gym.types import UNPAIRED, Array, IntArray, Landmarks, Locality, Relocation, Scan

_CANDIDATES = 64  # of a measurement, at one pose
_STAR = -1  # in place of a candidate: `*` was tried, the candidates are done


def random_sampling(
    scan: Scan,
    landmarks: Landmarks,
    locality: Locality | None = None,
    *,
    confidence: float = 0.99,
    p_fail: float = 0.05,
    p_good: float = 0.7,
    sample: int = 3,
    seed: int | np.random.Generator = 0,
    min_pairings: int | None = None,
    node_limit: int = 1_000_000,
) -> Relocation:
    """The largest hypothesis grown from random samples of the measurements.

    Each of t = ⌈log P_fail / log(1 − P_good^p)⌉ tries, P_good being the share of measurements that come from features
    of the map, takes p = `sample` measurements at random and pairs all of them, depth first and without `*`, under the
    location-independent constraints and the locality of the first. Every set of p pairings that is jointly compatible
    gives a pose, from which JCBB decides the other measurements: those compatible with a feature there, jointly with
    all that is already paired, located anew with every pairing (χ²_{2k−3}). Poses that cannot bring as many pairings as
    the best are left at once, which is why a scan from outside the map costs no more than one from inside.

    `seed` is that of the samples, or the generator to draw them from; `effort.tries` says how many there were.
    `min_pairings` replaces the rule of `acceptance`; `node_limit` bounds the nodes of all trees together. Raises
    ValueError for bad numbers in scan or map, for a locality of another map, and for settings out of range.
    """
    if not (0.0 < p_fail < 1.0 and 0.0 < p_good <= 1.0 and sample >= 2 and node_limit >= 1):
        settings = f"p_fail {p_fail}, p_good {p_good}, sample {sample}, node_limit {node_limit}"
        raise ValueError(f"{settings}: one is out of range")
    rng, m = np.random.default_rng(seed), len(scan)
    drawn = tries(p_fail, p_good, sample) if m >= sample else 0
    samples = np.array([rng.permutation(m)[:sample] for _ in range(drawn)], np.int64).reshape(drawn, sample)
    start, problem = time.perf_counter(), problem_of(scan, landmarks, locality, confidence)
    gates = location_gates(m, confidence)
    found = decide(_random_sampling(problem, gates, samples, node_limit), gates[-1])
    seconds = time.perf_counter() - start
    return relocation(scan, landmarks, found, problem.effort, seconds, confidence=confidence, min_pairings=min_pairings)


def tries(p_fail: float, p_good: float, sample: int) -> int:
    """⌈log P_fail / log(1 − P_good^p)⌉, at least 1."""
    all_good = p_good**sample
    return 1 if all_good >= 1.0 else max(1, math.ceil(math.log(p_fail) / math.log1p(-all_good)))


@compiled
def _random_sampling(problem: Problem, gates: Array, samples: IntArray, node_limit: int) -> Best:
    """The best of all tries."""
    best = nothing_found(len(problem.where.allowed))
    for sample in samples:
        if problem.effort[LIMIT] > 0:
            break
        problem.effort[TRIES] += 1
        _try(best, problem, gates, sample, node_limit)
    return best


@compiled
def _try(best: Best, problem: Problem, gates: Array, sample: IntArray, node_limit: int) -> None:
    """All ways to pair every measurement of the sample, each extended."""
    m, size = len(problem.where.allowed), len(sample)
    scan, mapped, chi2, where, effort = problem.scan, problem.mapped, problem.gates, problem.where, problem.effort
    path, tried, p = Path(np.empty(m, np.int64), np.empty(m, np.int64)), np.zeros(size + 1, np.int64), 0
    while p >= 0:
        if p == size:
            effort[LEAVES] += 1
            _extend(best, problem, gates, path, p, node_limit)
            p -= 1
            continue
        branch = next_branch(scan, mapped, chi2, effort, where, path, p, sample[p], tried[p])
        tried[p] = branch.tried
        if branch.feature == UNPAIRED:
            p -= 1
            continue
        if effort[NODES] == node_limit:
            effort[LIMIT] = 1
            return
        effort[NODES] += 1
        path.measurements[p], path.features[p] = sample[p], branch.feature
        p += 1
        tried[p] = 0


class _Poses(NamedTuple):
    """Of the hypothesis being extended, by its number of pairings."""

    poses: Array  # (m + 1, 3)
    covariances: Array  # (m + 1, 3, 3)
    distances: Array  # (m + 1,) D²


class _Candidates(NamedTuple):
    """What the measurements left may be paired with, by ascending D²_ij."""

    levels: IntArray  # (l,) measurements with a candidate
    starts: IntArray  # (l + 1,) where theirs begin
    features: IntArray  # (c,)


@compiled
def _extend(best: Best, problem: Problem, gates: Array, path: Path, p: int, node_limit: int) -> None:
    """JCBB from the pose of p pairings over the other measurements, every prefix located anew and jointly compatible.

    By level: how many pairings there are above it, and which candidate comes next.
    """
    m, effort = len(problem.where.allowed), problem.effort
    poses = _Poses(np.empty((m + 1, 3)), np.empty((m + 1, 3, 3)), np.empty(m + 1))
    if not _locate(poses, problem, path, p, gates):
        return
    candidates = _compatible(problem, path, p, poses)
    depth, level = len(candidates.levels), 0
    above, following = np.full(depth + 1, p), np.zeros(depth + 1, np.int64)
    while level >= 0:
        q = above[level]
        if following[level] == _STAR or q + depth - level < best.state[0]:
            level -= 1
            continue
        if level == depth:
            keep(best, path, q, poses.poses[q], poses.covariances[q], poses.distances[q])
            level -= 1
            continue
        position, chosen = candidates.starts[level] + following[level], UNPAIRED
        while position < candidates.starts[level + 1] and chosen == UNPAIRED:
            j, used = candidates.features[position], False
            position += 1
            for a in range(q):
                used = used or path.features[a] == j
            if used:
                continue
            path.measurements[q], path.features[q] = candidates.levels[level], j
            if _locate(poses, problem, path, q + 1, gates):
                chosen = j
        following[level] = position - candidates.starts[level] if chosen != UNPAIRED else _STAR
        if effort[NODES] == node_limit:
            effort[LIMIT] = 1
            return
        effort[NODES] += 1
        level += 1
        above[level], following[level] = q + (chosen != UNPAIRED), 0


@compiled
def _locate(poses: _Poses, problem: Problem, path: Path, k: int, gates: Array) -> bool:
    """Enter pose, covariance and D² of the first k pairings; whether they are jointly compatible."""
    problem.effort[JOINT] += 1
    pose, covariance, scan = poses.poses[k], poses.covariances[k], problem.scan
    poses.distances[k] = locate_pairings(scan.points, scan.noise, problem.mapped, path, k, pose, covariance)
    return bool(poses.distances[k] < gates[k])


@compiled
def _compatible(problem: Problem, path: Path, p: int, poses: _Poses) -> _Candidates:
    """What is individually compatible at the pose of p pairings, and local to the first one.

    Pose and features are taken for independent here: where a common drift correlates them the gate is too wide, and the
    joint test decides.
    """
    points, noise, starts, m = problem.scan.points, problem.scan.noise, problem.where.starts, len(problem.where.allowed)
    begin, end, gate = 0, len(problem.where.traces), problem.gates.two
    if len(starts) > 0:
        begin, end = starts[path.features[0]], starts[path.features[0] + 1]
    free = np.ones(m, np.bool_)
    for a in range(p):
        free[path.measurements[a]] = False
    distances, found, counts = np.empty((m, _CANDIDATES)), np.empty((m, _CANDIDATES), np.int64), np.zeros(m, np.int64)
    for position in range(begin, end):
        j = problem.where.members[position] if len(starts) > 0 else position
        hx, hy, xx, xy, yy = _predicted(poses.poses[p], poses.covariances[p], problem.mapped, j)
        for i in range(m):
            x, y = points[i, 0] - hx, points[i, 1] - hy
            sxx, syy = xx + noise[i, 0, 0], yy + noise[i, 1, 1]
            if not free[i] or x * x >= gate * sxx or y * y >= gate * syy or not problem.where.allowed[i, j]:
                continue
            sxy = xy + noise[i, 0, 1]
            distance = (syy * x * x - 2.0 * sxy * x * y + sxx * y * y) / (sxx * syy - sxy * sxy)
            if not distance < gate:
                continue
            counts[i] = _insert(distances[i], found[i], counts[i], distance, j, problem.effort)
    levels = np.flatnonzero(counts)
    bounds, candidates = np.zeros(len(levels) + 1, np.int64), np.empty(counts.sum(), np.int64)
    for l in range(len(levels)):
        count = counts[levels[l]]
        bounds[l + 1] = bounds[l] + count
        candidates[bounds[l] : bounds[l + 1]] = found[levels[l], :count]
    return _Candidates(levels, bounds, candidates)


@compiled
def _insert(distances: Array, found: IntArray, count: int, distance: float, j: int, effort: IntArray) -> int:
    """Enter a candidate by its D²; where there is no room the last one is dropped, and the limit counted as hit."""
    if count == len(found):
        effort[LIMIT] = 1
        if distances[count - 1] <= distance:
            return count
        count -= 1
    place = count
    while place > 0 and distances[place - 1] > distance:
        distances[place], found[place] = distances[place - 1], found[place - 1]
        place -= 1
    distances[place], found[place] = distance, j
    return count + 1


@compiled
def _predicted(pose: Array, covariance: Array, mapped: Mapped, j: int) -> tuple[float, float, float, float, float]:
    """h_j in R, and xx, xy, yy of its covariance H Σ Hᵀ + Cᵀ P_jj C."""
    c, s, P = math.cos(pose[2]), math.sin(pose[2]), mapped.covariances
    dx, dy = mapped.positions[j, 0] - pose[0], mapped.positions[j, 1] - pose[1]
    # in B, with ∂/∂θ = (dy, −dx) of C(F − t): turned into R at the end
    tt, xt, yt = covariance[2, 2], covariance[0, 2], covariance[1, 2]
    xx = covariance[0, 0] - 2.0 * dy * xt + dy * dy * tt + P[j, 0, 0]
    yy = covariance[1, 1] + 2.0 * dx * yt + dx * dx * tt + P[j, 1, 1]
    xy = covariance[0, 1] + dx * xt - dy * yt - dx * dy * tt + P[j, 0, 1]
    rxx = c * c * xx + 2.0 * c * s * xy + s * s * yy
    ryy = s * s * xx - 2.0 * c * s * xy + c * c * yy
    rxy = c * s * (yy - xx) + (c * c - s * s) * xy
    return c * dx + s * dy, -s * dx + c * dy, rxx, rxy, ryy
