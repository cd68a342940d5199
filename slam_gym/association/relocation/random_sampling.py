"""RS: relocation by random sampling (Neira, Tardós and Castellanos, ICRA 2003), with locality."""

from __future__ import annotations

import math
import time
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.relocation.answer import (
    JOINT,
    LEAVES,
    LIMIT,
    NODES,
    TRIES,
    Best,
    allowed_pairings,
    keep,
    location_gates,
    next_branch,
    nothing_found,
    outcome,
    relocation,
)
from slam_gym.association.relocation.arrays import problem_arrays
from slam_gym.association.relocation.constraints import Gates, Mapped, Measured, gates, measured
from slam_gym.association.relocation.location import locate_pairings
from slam_gym.types import NONE, Array, BoolArray, IntArray, Landmarks, Locality, Relocation, Scan

_CANDIDATES = 64  # of a measurement, at one pose


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
    problem = problem_arrays(scan, landmarks, locality)
    rng, m = np.random.default_rng(seed), len(scan)
    drawn = tries(p_fail, p_good, sample) if m >= sample else 0
    samples = np.array([rng.permutation(m)[:sample] for _ in range(drawn)], np.int64).reshape(drawn, sample)
    counters, start = np.zeros(8, np.int64), time.perf_counter()
    joint = location_gates(m, confidence)
    found = _random_sampling(*problem, gates(confidence), joint, samples, node_limit, counters)
    seconds = time.perf_counter() - start
    return relocation(scan, landmarks, found, counters, seconds, confidence=confidence, min_pairings=min_pairings)


def tries(p_fail: float, p_good: float, sample: int) -> int:
    """⌈log P_fail / log(1 − P_good^p)⌉, at least 1."""
    all_good = p_good**sample
    return 1 if all_good >= 1.0 else max(1, math.ceil(math.log(p_fail) / math.log1p(-all_good)))


@compiled
def _random_sampling(
    seen: tuple[Array, Array],
    intrinsic: tuple[Array, Array, IntArray],
    of_map: tuple[Array, Array, Array, IntArray, IntArray, Array],
    of_intrinsic: tuple[Array, Array, IntArray],
    local: tuple[IntArray, IntArray],
    chi2: tuple[float, float],
    joint: Array,
    samples: IntArray,
    node_limit: int,
    counters: IntArray,
) -> tuple[IntArray, Array, Array, float, int]:
    """`outcome` of all tries."""
    scan, m = measured(seen[0], seen[1]), len(seen[0])
    mapped, gate = Mapped(of_map[0], of_map[1], of_map[2], of_map[3], of_map[4], of_map[5]), Gates(chi2[0], chi2[1])
    allowed, best = allowed_pairings(intrinsic, of_intrinsic, gate.one), nothing_found(m)
    traces = mapped.covariances[:, 0, 0] + mapped.covariances[:, 1, 1]
    for t in range(len(samples)):
        if counters[LIMIT] > 0:
            break
        counters[TRIES] += 1
        _try(best, scan, mapped, gate, allowed, traces, local, joint, samples[t], node_limit, counters)
    return outcome(best, joint[m + 1])


@compiled
def _try(
    best: Best,
    scan: Measured,
    mapped: Mapped,
    gate: Gates,
    allowed: BoolArray,
    traces: Array,
    local: tuple[IntArray, IntArray],
    joint: Array,
    sample: IntArray,
    node_limit: int,
    counters: IntArray,
) -> None:
    """All ways to pair every measurement of the sample, each extended."""
    m, size = len(scan.points), len(sample)
    paired, of = np.empty(m, np.int64), np.empty(m, np.int64)
    following, p = np.zeros(size + 1, np.int64), 0
    while p >= 0:
        if p == size:
            counters[LEAVES] += 1
            _extend(best, scan, mapped, gate.two, allowed, local, joint, paired, of, p, node_limit, counters)
            p -= 1
            continue
        i = sample[p]
        chosen, following[p] = next_branch(
            scan, mapped, gate, allowed, traces, local, paired, of, p, i, following[p], counters
        )
        if chosen == NONE:
            p -= 1
            continue
        if counters[NODES] == node_limit:
            counters[LIMIT] = 1
            return
        counters[NODES] += 1
        paired[p], of[p] = i, chosen
        p += 1
        following[p] = 0


class _Path(NamedTuple):
    """The hypothesis being extended, by its number of pairings."""

    poses: Array  # (m + 1, 3)
    covariances: Array  # (m + 1, 3, 3)
    distances: Array  # (m + 1,) D²


@compiled
def _extend(
    best: Best,
    scan: Measured,
    mapped: Mapped,
    gate: float,
    allowed: BoolArray,
    local: tuple[IntArray, IntArray],
    joint: Array,
    paired: IntArray,
    of: IntArray,
    p: int,
    node_limit: int,
    counters: IntArray,
) -> None:
    """JCBB from the pose of p pairings over the other measurements, every prefix located anew and jointly compatible.

    By level: how many pairings there are above it, and which candidate comes next.
    """
    m = len(scan.points)
    path = _Path(np.empty((m + 1, 3)), np.empty((m + 1, 3, 3)), np.empty(m + 1))
    if not _locate(path, scan, mapped, paired, of, p, joint, counters):
        return
    levels, starts, candidates = _compatible(scan, mapped, gate, allowed, local, paired, of, p, path, counters)
    depth, level = len(levels), 0
    above, following = np.full(depth + 1, p), np.zeros(depth + 1, np.int64)
    while level >= 0:
        q = above[level]
        if following[level] == NONE or q + depth - level < best.state[0]:
            level -= 1
            continue
        if level == depth:
            keep(best, paired, of, q, path.poses[q], path.covariances[q], path.distances[q])
            level -= 1
            continue
        position, chosen = starts[level] + following[level], NONE
        while position < starts[level + 1] and chosen == NONE:
            j, used = candidates[position], False
            position += 1
            for a in range(q):
                used = used or of[a] == j
            if used:
                continue
            paired[q], of[q] = levels[level], j
            if _locate(path, scan, mapped, paired, of, q + 1, joint, counters):
                chosen = j
        following[level] = position - starts[level] if chosen != NONE else NONE
        if counters[NODES] == node_limit:
            counters[LIMIT] = 1
            return
        counters[NODES] += 1
        level += 1
        above[level], following[level] = q + (chosen != NONE), 0


@compiled
def _locate(
    path: _Path,
    scan: Measured,
    mapped: Mapped,
    paired: IntArray,
    of: IntArray,
    k: int,
    joint: Array,
    counters: IntArray,
) -> bool:
    """Enter pose, covariance and D² of the first k pairings; whether they are jointly compatible."""
    counters[JOINT] += 1
    pose, covariance = path.poses[k], path.covariances[k]
    path.distances[k] = locate_pairings(scan.points, scan.noise, mapped, paired, of, k, pose, covariance)
    return bool(path.distances[k] < joint[k])


@compiled
def _compatible(
    scan: Measured,
    mapped: Mapped,
    gate: float,
    allowed: BoolArray,
    local: tuple[IntArray, IntArray],
    paired: IntArray,
    of: IntArray,
    p: int,
    path: _Path,
    counters: IntArray,
) -> tuple[IntArray, IntArray, IntArray]:
    """What the measurements left may be paired with at the pose of p pairings, by ascending D²_ij.

    Measurements with a candidate (l,), where theirs begin (l + 1,), features (c,). Pose and features are taken for
    independent here: where a common drift correlates them the gate is too wide, and the joint test decides.
    """
    m, starts, members = len(scan.points), local[0], local[1]
    begin, end = 0, len(mapped.positions)
    if len(starts) > 0:
        begin, end = starts[of[0]], starts[of[0] + 1]
    free = np.ones(m, np.bool_)
    for a in range(p):
        free[paired[a]] = False
    distances, found, counts = np.empty((m, _CANDIDATES)), np.empty((m, _CANDIDATES), np.int64), np.zeros(m, np.int64)
    for position in range(begin, end):
        j = members[position] if len(starts) > 0 else position
        hx, hy, xx, xy, yy = _predicted(path.poses[p], path.covariances[p], mapped, j)
        for i in range(m):
            x, y = scan.points[i, 0] - hx, scan.points[i, 1] - hy
            sxx, syy = xx + scan.noise[i, 0, 0], yy + scan.noise[i, 1, 1]
            if not free[i] or x * x >= gate * sxx or y * y >= gate * syy or not allowed[i, j]:
                continue
            sxy = xy + scan.noise[i, 0, 1]
            distance = (syy * x * x - 2.0 * sxy * x * y + sxx * y * y) / (sxx * syy - sxy * sxy)
            if not distance < gate:
                continue
            counts[i] = _insert(distances[i], found[i], counts[i], distance, j, counters)
    levels = np.flatnonzero(counts)
    bounds, candidates = np.zeros(len(levels) + 1, np.int64), np.empty(counts.sum(), np.int64)
    for l in range(len(levels)):
        count = counts[levels[l]]
        bounds[l + 1] = bounds[l] + count
        candidates[bounds[l] : bounds[l + 1]] = found[levels[l], :count]
    return levels, bounds, candidates


@compiled
def _insert(distances: Array, found: IntArray, count: int, distance: float, j: int, counters: IntArray) -> int:
    """Enter a candidate by its D²; where there is no room the last one is dropped, and the limit counted as hit."""
    if count == len(found):
        counters[LIMIT] = 1
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
