"""GCBB: geometric constraints branch and bound (Neira, Tardós and Castellanos, ICRA 2003), with locality."""

from __future__ import annotations

import time

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.relocation.answer import (
    LEAVES,
    LIMIT,
    NODES,
    Best,
    allowed_pairings,
    location_gates,
    next_branch,
    nothing_found,
    offer,
    outcome,
    relocation,
)
from slam_gym.association.relocation.arrays import problem_arrays
from slam_gym.association.relocation.constraints import Gates, Mapped, gates, measured
from slam_gym.types import NONE, Array, IntArray, Landmarks, Locality, Relocation, Scan

_STAR = -1  # in place of a candidate: `*` comes next, the candidates are done


def gcbb(
    scan: Scan,
    landmarks: Landmarks,
    locality: Locality | None = None,
    *,
    confidence: float = 0.99,
    min_pairings: int | None = None,
    node_limit: int = 1_000_000,
    rivals: bool = True,
    outwards: bool = False,
) -> Relocation:
    """The jointly compatible hypothesis with most pairings, of all that satisfy the location-independent constraints.

    Depth first through the interpretation tree, level i deciding measurement i: a feature is a legal branch where the
    unary constraint holds and the binary one with every pairing already made, and where it goes round with the first
    pairing and every other in the same sense; `*` comes last. After the first pairing only features local to its own
    are offered. A node is visited if pairings so far + levels left > pairings of the best. A leaf that may beat the
    best is located, and believed if D² < χ²_{2k−3}.

    With `rivals`, nodes that may equal the best are visited too: the least D² of all hypotheses with most pairings is
    returned, and `ties` tells how many of the others are at another pose. Without, the search is that of the source,
    the first of them is returned, and nothing is known of ties.

    Levels follow the scan. With `outwards` they go from its centre out: a measurement amid the others is more likely to
    begin with a feature that was seen together with all of theirs, so that less is lost to a strict locality.

    `min_pairings` replaces the rule of `acceptance`. Where `node_limit` ends the search, `effort.limit_hit` says so and
    the best hypothesis until then is returned. Raises ValueError for bad numbers in scan or map, and for a locality of
    another map.
    """
    if node_limit < 1:
        raise ValueError(f"node_limit: {node_limit} is less than 1")
    problem = problem_arrays(scan, landmarks, locality)
    (points, noise), (sizes, variances, kinds) = problem.seen, problem.intrinsic
    levels = _from_centre(points) if outwards else np.arange(len(points))
    problem = problem._replace(
        seen=(points[levels], noise[levels]), intrinsic=(sizes[levels], variances[levels], kinds[levels])
    )
    counters, start = np.zeros(8, np.int64), time.perf_counter()
    found = _gcbb(*problem, gates(confidence), location_gates(len(scan), confidence), node_limit, rivals, counters)
    seconds = time.perf_counter() - start
    found[0][levels] = found[0].copy()
    return relocation(scan, landmarks, found, counters, seconds, confidence=confidence, min_pairings=min_pairings)


def _from_centre(points: Array) -> IntArray:
    """Measurements (m,), those nearest to their mean first."""
    if not len(points):
        return np.empty(0, np.int64)
    order: IntArray = np.argsort(((points - points.mean(axis=0)) ** 2).sum(axis=1), kind="stable")
    return order


@compiled
def _gcbb(
    seen: tuple[Array, Array],
    intrinsic: tuple[Array, Array, IntArray],
    of_map: tuple[Array, Array, Array, IntArray, IntArray, Array],
    of_intrinsic: tuple[Array, Array, IntArray],
    local: tuple[IntArray, IntArray],
    chi2: tuple[float, float],
    joint: Array,
    node_limit: int,
    rivals: bool,
    counters: IntArray,
) -> tuple[IntArray, Array, Array, float, int]:
    """`outcome` of the search. By level: how many pairings there are above it, and which candidate comes next."""
    scan, m = measured(seen[0], seen[1]), len(seen[0])
    mapped, gate = Mapped(of_map[0], of_map[1], of_map[2], of_map[3], of_map[4], of_map[5]), Gates(chi2[0], chi2[1])
    traces = mapped.covariances[:, 0, 0] + mapped.covariances[:, 1, 1]
    allowed = allowed_pairings(intrinsic, of_intrinsic, gate.one)
    best = nothing_found(m)
    paired, of = np.empty(m, np.int64), np.empty(m, np.int64)
    above, following = np.zeros(m + 1, np.int64), np.zeros(m + 1, np.int64)
    level = 0
    while level >= 0:
        p = above[level]
        if following[level] == _STAR or not _promises(best, p + m - level, rivals):
            level -= 1
            continue
        if level == m:
            counters[LEAVES] += 1
            offer(best, scan, mapped, paired, of, p, joint, counters)
            level -= 1
            continue
        chosen, following[level] = next_branch(
            scan, mapped, gate, allowed, traces, local, paired, of, p, level, following[level], counters
        )
        if chosen == NONE:
            following[level] = _STAR
        if chosen == NONE and not _promises(best, p + m - level - 1, rivals):
            continue
        if counters[NODES] == node_limit:
            counters[LIMIT] = 1
            break
        counters[NODES] += 1
        if chosen != NONE:
            paired[p], of[p] = level, chosen
            p += 1
        level += 1
        above[level], following[level] = p, 0
    return outcome(best, joint[m + 1])


@compiled
def _promises(best: Best, bound: int, rivals: bool) -> bool:
    """Whether so many pairings would beat the best; or equal it, where that is asked."""
    return bool(bound > best.state[0] or (rivals and best.state[1] > 0 and bound == best.state[0]))
