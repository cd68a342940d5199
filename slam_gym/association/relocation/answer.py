"""What the searches without a prior share: which branches are legal, the best hypotheses so far, and the answer."""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.compatibility import chi2_gate
from slam_gym.association.relocation.acceptance import min_pairings as by_rule
from slam_gym.association.relocation.constraints import (
    Gates,
    Mapped,
    Measured,
    binary_test,
    far_apart,
    orientation_test,
    unary_test,
)
from slam_gym.association.relocation.location import locate_pairings
from slam_gym.geometry import wrap_angle
from slam_gym.types import NONE, Array, BoolArray, Effort, IntArray, Landmarks, Relocation, Scan

NODES, UNARY, BINARY, ORIENTATION, LEAVES, JOINT, TRIES, LIMIT = range(8)
"""Entries of the counters (8,) that every search keeps."""

_RIVALS = 256  # hypotheses with as many pairings as the best that are kept


class Best(NamedTuple):
    """The hypotheses with most pairings, all of them jointly compatible: those of equal number are rivals."""

    features: IntArray  # (r, m) map feature of each measurement, or NONE
    poses: Array  # (r, 3) [m, m, rad] in B
    covariances: Array  # (r, 3, 3)
    distances: Array  # (r,) D²
    state: IntArray  # (3,) number of pairings, of rivals, and which of them has the least D²


@functools.lru_cache(maxsize=256)
def location_gates(pairings: int, confidence: float) -> Array:
    """χ²_{2k−3,conf} for k = 0 … pairings, inf for k < 2; and at the end χ²_{3,conf}, of a pose. (pairings + 2,)."""
    gates = [math.inf if k < 2 else chi2_gate(2 * k - 3, confidence) for k in range(pairings + 1)]
    return np.array([*gates, chi2_gate(3, confidence)])


def relocation(
    scan: Scan,
    landmarks: Landmarks,
    found: tuple[IntArray, Array, Array, float, int],
    counters: IntArray,
    seconds: float,
    *,
    confidence: float,
    min_pairings: int | None,
) -> Relocation:
    """The answer: the best hypothesis as `outcome` gives it, under the rule or under the `min_pairings` given."""
    features, pose, covariance, distance, ties = found
    if min_pairings is None:
        min_pairings = by_rule(scan, landmarks, confidence=confidence)
    counts = [int(count) for count in counters]
    effort = Effort(
        nodes=counts[NODES],
        unary_tests=counts[UNARY],
        binary_tests=counts[BINARY],
        orientation_tests=counts[ORIENTATION],
        joint_tests=counts[JOINT],
        leaves=counts[LEAVES],
        tries=counts[TRIES],
        limit_hit=counts[LIMIT] > 0,
        seconds=seconds,
    )
    dof = max(2 * int((features != NONE).sum()) - 3, 0)
    return Relocation(features, pose, covariance, distance, dof, min_pairings, ties > 0, ties, effort)


@compiled
def nothing_found(measurements: int) -> Best:
    """No hypothesis yet; one pairing is what any other must beat."""
    return Best(
        np.full((_RIVALS, measurements), NONE),
        np.empty((_RIVALS, 3)),
        np.empty((_RIVALS, 3, 3)),
        np.empty(_RIVALS),
        np.array([1, 0, 0]),
    )


@compiled
def offer(
    best: Best,
    scan: Measured,
    mapped: Mapped,
    paired: IntArray,
    of: IntArray,
    k: int,
    gates: Array,
    counters: IntArray,
) -> bool:
    """Locate and test the hypothesis of k pairings, and keep it if it has as many as the best; whether it holds."""
    if k < 2:
        return False
    pose, covariance = np.empty(3), np.empty((3, 3))
    counters[JOINT] += 1
    distance = locate_pairings(scan.points, scan.noise, mapped, paired, of, k, pose, covariance)
    if not distance < gates[k]:
        return False
    keep(best, paired, of, k, pose, covariance, distance)
    return True


@compiled
def keep(best: Best, paired: IntArray, of: IntArray, k: int, pose: Array, covariance: Array, distance: float) -> None:
    """Enter a located hypothesis if it has as many pairings as the best and is not there yet."""
    state = best.state
    if k < state[0]:
        return
    if k > state[0]:
        state[0], state[1], state[2] = k, 0, 0
    for r in range(state[1]):
        same = True
        for a in range(k):
            same = same and best.features[r, paired[a]] == of[a]
        if same:
            return
    least = state[1] == 0 or distance < best.distances[state[2]]
    if state[1] == _RIVALS and not least:
        return
    r = state[2] if state[1] == _RIVALS else state[1]
    state[1] = min(state[1] + 1, _RIVALS)
    best.features[r] = NONE
    for a in range(k):
        best.features[r, paired[a]] = of[a]
    best.poses[r], best.covariances[r], best.distances[r] = pose, covariance, distance
    if least:
        state[2] = r


@compiled
def outcome(best: Best, gate: float) -> tuple[IntArray, Array, Array, float, int]:
    """Features, pose, covariance and D² of the rival with the least D², and how many rivals are elsewhere.

    Two poses are one place when their difference is compatible with both covariances together, `gate` being χ²_3. All
    NONE and NaN where nothing was found.
    """
    if best.state[1] == 0:
        return np.full(best.features.shape[1], NONE), np.full(3, np.nan), np.full((3, 3), np.nan), 0.0, 0
    b, ties = best.state[2], 0
    for r in range(best.state[1]):
        if r != b and not one_place(best.poses[b], best.covariances[b], best.poses[r], best.covariances[r], gate):
            ties += 1
    return best.features[b].copy(), best.poses[b].copy(), best.covariances[b].copy(), best.distances[b], ties


@compiled
def one_place(pose: Array, covariance: Array, other: Array, of_other: Array, gate: float) -> bool:
    """Whether δᵀ(Σ_1 + Σ_2)⁻¹δ < gate for the difference δ of two poses (3,)."""
    x, y, t = pose[0] - other[0], pose[1] - other[1], wrap_angle(pose[2] - other[2])
    S = covariance + of_other
    lxx = math.sqrt(S[0, 0])
    lyx, ltx = S[1, 0] / lxx, S[2, 0] / lxx
    lyy = math.sqrt(max(S[1, 1] - lyx * lyx, 1e-300))
    lty = (S[2, 1] - ltx * lyx) / lyy
    ltt = math.sqrt(max(S[2, 2] - ltx * ltx - lty * lty, 1e-300))
    u = x / lxx
    v = (y - lyx * u) / lyy
    w = (t - ltx * u - lty * v) / ltt
    return bool(u * u + v * v + w * w < gate)


@compiled
def allowed_pairings(
    intrinsic: tuple[Array, Array, IntArray], of_map: tuple[Array, Array, IntArray], gate: float
) -> BoolArray:
    """The unary constraints (m, n), looked up for every test that is counted."""
    sizes, variances, kinds = intrinsic
    of_sizes, of_variances, of_kinds = of_map
    allowed = np.empty((len(sizes), len(of_sizes)), np.bool_)
    for i in range(len(sizes)):
        for j in range(len(of_sizes)):
            allowed[i, j] = unary_test(
                sizes[i], variances[i], kinds[i], of_sizes[j], of_variances[j], of_kinds[j], gate
            )
    return allowed


@compiled
def follows(
    scan: Measured,
    mapped: Mapped,
    gates: Gates,
    paired: IntArray,
    of: IntArray,
    p: int,
    i: int,
    j: int,
    counters: IntArray,
) -> bool:
    """Whether pairing (i, j) satisfies the constraints with all of the p pairings already made."""
    for a in range(p):
        if of[a] == j:
            return False
        counters[BINARY] += 1
        if not binary_test(scan, mapped, gates, paired[a], of[a], i, j):
            return False
    for a in range(1, p):
        counters[ORIENTATION] += 1
        if not orientation_test(scan, mapped, gates, paired[0], of[0], paired[a], of[a], i, j):
            return False
    return True


@compiled
def next_branch(
    scan: Measured,
    mapped: Mapped,
    gates: Gates,
    allowed: BoolArray,
    traces: Array,
    local: tuple[IntArray, IntArray],
    paired: IntArray,
    of: IntArray,
    p: int,
    i: int,
    tried: int,
    counters: IntArray,
) -> tuple[int, int]:
    """The next feature that measurement i may be paired with after the p pairings, or NONE; candidates tried by then.

    Candidates are the features local to the first one paired, or all; the first `tried` of them are done with.
    `allowed` (m, n) are the unary constraints, `traces` (n,) [m²] those of the features' covariances.
    """
    starts, members = local
    restricted, positions = p > 0 and len(starts) > 0, mapped.positions
    begin, end = 0, len(traces)
    if restricted:
        begin, end = starts[of[0]], starts[of[0] + 1]
    x0, y0, trace, distance, spread = 0.0, 0.0, 0.0, 0.0, 0.0
    if p > 0:
        x0, y0, trace = positions[of[0], 0], positions[of[0], 1], traces[of[0]]
        distance, spread = scan.distances[i, paired[0]], scan.spreads[i, paired[0]]
    for position in range(begin + tried, end):
        j = members[position] if restricted else position
        counters[UNARY] += 1
        if not allowed[i, j]:
            continue
        if p > 0:  # what `follows` would do first, with all at hand: it settles most pairings
            x, y = positions[j, 0] - x0, positions[j, 1] - y0
            if far_apart(distance - math.sqrt(x * x + y * y), spread, traces[j], trace, gates.two):
                counters[BINARY] += of[0] != j
                continue
        if follows(scan, mapped, gates, paired, of, p, i, j, counters):
            return j, position + 1 - begin
    return NONE, end - begin
