"""RS: relocation by random sampling (Neira, Tardós and Castellanos, ICRA 2003), with locality."""

from __future__ import annotations

import math
import time
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.acceptance import min_pairings as by_rule
from slam_gym.association.compatibility import gate_pairings
from slam_gym.association.relocation.answer import Best, answer_of, keep, nothing_found
from slam_gym.association.relocation.constraints import Path
from slam_gym.association.relocation.location import locate_pairings
from slam_gym.association.relocation.tree import JOINT, LEAVES, LIMIT, NODES, TRIES, Problem, next_branch, problem_of
from slam_gym.types import UNPAIRED, Array, IntArray, Landmarks, Locality, Relocation, Scan

_SAMPLE = 3  # measurements of a sample
_STAR = -1  # in place of a candidate: `*` was tried, the candidates are done


class _Located(NamedTuple):
    """The hypothesis being extended, by its number of pairings."""

    poses: Array  # (m + 1, 3)
    covariances: Array  # (m + 1, 3, 3)
    distances: Array  # (m + 1,) D²


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

    Each of `tries` takes three measurements at random and pairs all of them, depth first and without `*`, under the
    location-independent constraints and the locality of the first. Every three pairings that are jointly compatible
    give a pose, from which JCBB decides the other measurements: those compatible with a feature there, jointly with all
    that is already paired, located anew with every pairing (χ²_{2k−3}). Poses that cannot bring as many pairings as the
    best are left at once, which is why a scan from outside the map costs no more than one from inside.

    All samples are bad with probability P_fail after log P_fail / log(1 − P_good³) tries, P_good being the share of
    measurements that come from features of the map: 8 tries for 0.05 and 0.7. `seed` is that of the samples, or the
    generator to draw them from. `min_pairings` replaces the rule of `acceptance`; `node_limit` bounds the nodes of all
    trees together. Raises ValueError for bad numbers in scan or map, for a locality of another map, and for settings
    out of range.
    """
    if tries < 1 or node_limit < 1:
        raise ValueError(f"tries {tries}, node_limit {node_limit}: expected at least 1")
    rng, m, began = np.random.default_rng(seed), len(scan), time.perf_counter()
    drawn = tries if m >= _SAMPLE else 0
    samples = np.array([rng.permutation(m)[:_SAMPLE] for _ in range(drawn)], np.int64).reshape(drawn, _SAMPLE)
    problem = problem_of(scan, landmarks, locality, confidence)
    best = _random_sampling(problem, samples, node_limit)
    if min_pairings is None:
        min_pairings = by_rule(scan, landmarks, confidence=confidence)
    return answer_of(best, problem, min_pairings, time.perf_counter() - began)


@compiled
def _random_sampling(problem: Problem, samples: IntArray, node_limit: int) -> Best:
    """The best of all tries: all ways to pair every measurement of a sample, each extended."""
    m, size, effort = len(problem.allowed), samples.shape[1], problem.effort
    best, tried = nothing_found(m), np.zeros(size + 1, np.int64)
    path = Path(np.empty(m, np.int64), np.empty(m, np.int64))
    for sample in samples:
        effort[TRIES] += effort[LIMIT] == 0
        p = tried[0] = 0
        while p >= 0 and effort[LIMIT] == 0:
            if p == size:
                effort[LEAVES] += 1
                _extend(best, problem, path, p, node_limit)
                p -= 1
                continue
            feature, tried[p] = next_branch(problem, path, p, sample[p], tried[p])
            if feature == UNPAIRED:
                p -= 1
                continue
            if effort[NODES] == node_limit:
                effort[LIMIT] = 1
                break
            effort[NODES] += 1
            path.measurements[p], path.features[p] = sample[p], feature
            p += 1
            tried[p] = 0
    return best


@compiled
def _extend(best: Best, problem: Problem, path: Path, p: int, node_limit: int) -> None:
    """JCBB from the pose of p pairings over the other measurements, every prefix located anew and jointly compatible.

    By level: how many pairings there are above it, and which candidate comes next.
    """
    m, effort = len(problem.allowed), problem.effort
    located = _Located(np.empty((m + 1, 3)), np.empty((m + 1, 3, 3)), np.empty(m + 1))
    if not _locate(located, problem, path, p):
        return
    measured, features = _compatible(problem, path, p, located)
    levels, level = np.unique(measured), 0
    starts, depth = np.append(np.searchsorted(measured, levels), len(measured)), len(levels)
    above, following = np.full(depth + 1, p), np.zeros(depth + 1, np.int64)
    while level >= 0:
        q = above[level]
        if following[level] == _STAR or q + depth - level < best.state[0]:
            level -= 1
            continue
        if level == depth:
            keep(best, path, q, located.poses[q], located.covariances[q], located.distances[q])
            level -= 1
            continue
        chosen, candidate = UNPAIRED, following[level]
        while candidate < starts[level + 1] and chosen == UNPAIRED:
            if not (path.features[:q] == features[candidate]).any():
                path.measurements[q], path.features[q] = levels[level], features[candidate]
                if _locate(located, problem, path, q + 1):
                    chosen = features[candidate]
            candidate += 1
        following[level] = candidate if chosen != UNPAIRED else _STAR
        if effort[NODES] == node_limit:
            effort[LIMIT] = 1
            return
        effort[NODES] += 1
        level += 1
        above[level], following[level] = q + (chosen != UNPAIRED), starts[level]


@compiled
def _locate(located: _Located, problem: Problem, path: Path, k: int) -> bool:
    """Enter pose, covariance and D² of the first k pairings; whether they are jointly compatible."""
    problem.effort[JOINT] += 1
    pose, covariance, scan = located.poses[k], located.covariances[k], problem.scan
    located.distances[k] = locate_pairings(scan.points, scan.noise, problem.mapped, path, k, pose, covariance)
    return bool(located.distances[k] < problem.joint_gates[k])


@compiled
def _compatible(problem: Problem, path: Path, p: int, located: _Located) -> tuple[IntArray, IntArray]:
    """Other measurements and features that are individually compatible at the pose of p pairings, (c,) each.

    By measurement, then D²_ij. Features are local to the first one paired. Pose and features are taken for independent
    here: where a common drift correlates them the gate is too wide, and the joint test decides.
    """
    scan, starts, pose, covariance = problem.scan, problem.starts, located.poses[p], located.covariances[p]
    local, others = np.arange(len(problem.mapped.positions)), np.ones(len(scan.points), np.bool_)
    if len(starts) > 0:
        local = problem.members[starts[path.features[0]] : starts[path.features[0] + 1]]
    others[path.measurements[:p]] = False
    positions, covariances = np.empty((len(local), 2)), np.empty((len(local), 2, 2))
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for k in range(len(local)):
        # h_j with covariance H Σ Hᵀ + Cᵀ P_jj C, in B, with ∂/∂θ = (dy, −dx) of C(F − t): turned into R at the end
        F, P = problem.mapped.positions[local[k]], problem.mapped.covariances[local[k]]
        dx, dy = F[0] - pose[0], F[1] - pose[1]
        tt, xt, yt = covariance[2, 2], covariance[0, 2], covariance[1, 2]
        bxx = covariance[0, 0] - 2.0 * dy * xt + dy * dy * tt + P[0, 0]
        byy = covariance[1, 1] + 2.0 * dx * yt + dx * dx * tt + P[1, 1]
        bxy = covariance[0, 1] + dx * xt - dy * yt - dx * dy * tt + P[0, 1]
        positions[k, 0], positions[k, 1] = c * dx + s * dy, c * dy - s * dx
        covariances[k, 0, 0] = c * c * bxx + 2.0 * c * s * bxy + s * s * byy
        covariances[k, 1, 1] = s * s * bxx - 2.0 * c * s * bxy + c * c * byy
        covariances[k, 0, 1] = covariances[k, 1, 0] = c * s * (byy - bxx) + (c * c - s * s) * bxy
    _, found = gate_pairings(
        scan.points, scan.noise, positions, covariances, np.flatnonzero(others), np.empty(0, np.bool_),
        scan.gates.two, len(local),
    )  # fmt: skip
    features, passed = local[found.rows[found.slots]], np.empty(len(found.slots), np.bool_)
    for k in range(len(features)):
        passed[k] = problem.allowed[found.measured[k], features[k]]
    return found.measured[passed], features[passed]
