"""Map joining: two statistically independent stochastic maps become one (Tardós, Neira, Newman and Leonard, IJRR 2002).

Map A, in base B_A, ends with its robot at R_A; map B has its base there: x_B is given in the frame of R_A. The joined
state, all in B_A, with x_R the robot of B, is

    x = (R_A ⊕ R_B; F_A; R_A ⊕ F_B),    P = J_A P_A J_Aᵀ + J_B P_B J_Bᵀ,

where J_A, J_B are the Jacobians of x by x_A and x_B. Features that both maps hold are then matched, made equal by an
update with the noise-free measurement F_a − F_b = 0, and one of each pair is deleted.

Many maps are joined at once by least squares (`join_all`): each is a measurement (R_i; F_i), of covariance P_i, of the
next base and of its features as seen from its own base. That is exact but for rounding, linearised at the result, and
sparse: two maps have to do with each other where they share features, or where one follows the other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import csc_array

from slam_gym.geometry import wrap_angle
from slam_gym.mapping import ekf
from slam_gym.mapping.linear_algebra import ROUNDING, aligned_zeros, cholesky, padded, subtract_squares, whiten
from slam_gym.mapping.smoothing import FactorGraph, Smoothed, dead_reckoning
from slam_gym.mapping.stochastic_map import MapState, StochasticMap
from slam_gym.types import UNKNOWN_KIND, Array, IntArray

UNKNOWN_POSE = np.diag([10.0**2, 10.0**2, math.pi**2 / 3.0])
"""[m², m², rad²] Covariance of a pose, or of the relation of two maps, before it is found: it says nothing."""
_AT_LEAST = 1e-12  # [m²], [rad²] of a local map that is joined with others


def join(a: StochasticMap, b: StochasticMap) -> StochasticMap:
    """Both maps in the base of `a`: the features of `a`, then those of `b`, none of them matched yet.

    The robot is that of `b`, whose base is the robot of `a`; the settings are those of `a`. Raises ValueError where
    both have given an id.
    """
    first, second = a.state, b.state
    twice = np.intersect1d(first.counted[ekf.IDS], second.counted[ekf.IDS])
    if len(twice):
        raise ValueError(f"ids: both maps have features {twice[:5].tolist()}")
    mean, covariance = joined_estimate(first.mean, first.covariance, second.mean, second.covariance)
    step, next_id = max(first.step, second.step), max(first.next_id, second.next_id)
    counted = np.concatenate([first.counted, second.counted], axis=1)
    sized = np.concatenate([first.sized, second.sized], axis=1)
    return StochasticMap.of_state(a.spec, MapState(mean, covariance, counted, sized, step, next_id))


def join_at(a: StochasticMap, b: StochasticMap, base: Array) -> StochasticMap:
    """Both maps in the base of `a`, that of `b` at the pose `base` (3,), of which nothing is known for certain.

    What is known of it comes with `equate`. Neither map is changed. Raises as `join`.
    """
    placed = a.copy()
    placed.place(base, UNKNOWN_POSE)
    return join(placed, b)


def join_all(maps: Sequence[StochasticMap], names: Sequence[IntArray]) -> Smoothed:
    """All maps in the base of the first, each of which has its base where the robot of the one before it ended.

    Features of one name are one: `names` has those (n_i,) of the features of each map, different within a map. The
    poses are the bases of the maps, then that of the robot. To every variance (1 µm)² is added, for a robot that has
    not moved since its map began knows its pose exactly. Raises ValueError where the iterations run out.
    """
    count, sizes = len(maps), [m.n for m in maps]
    ids, feature = np.unique(np.concatenate(names), return_inverse=True)
    rows, columns, values = [], [], []
    for number, (m, first) in enumerate(zip(maps, 3 * count + 2 * np.cumsum([0, *sizes]))):
        entries = np.concatenate([3 * number + np.arange(3), first + np.arange(2 * m.n)])
        values.append(np.linalg.inv(m.covariance + _AT_LEAST * np.eye(len(entries))).ravel())
        rows.append(np.repeat(entries, len(entries)))
        columns.append(np.tile(entries, len(entries)))
    total = 3 * count + 2 * sum(sizes)
    at = np.concatenate(rows), np.concatenate(columns)
    information = csc_array((np.concatenate(values), at), shape=(total, total))
    motions, points = np.array([m.pose for m in maps]), np.concatenate([m.positions for m in maps])
    graph = FactorGraph(motions, points, np.repeat(np.arange(count), sizes), feature, information)
    return graph.optimum(dead_reckoning(motions), ids)


def joined_map(maps: Sequence[StochasticMap], names: Sequence[IntArray]) -> StochasticMap:
    """`join_all` as one map with its full covariance, whose time and memory grow with the cube and square of its size.

    Names are ids, each that of the oldest of the features of this name; ids ascend from map to map. What was known of
    a feature in all maps goes to it; settings are those of the first map, the robot is that of the last.
    """
    best, states = join_all(maps, names), [m.state for m in maps]
    counted = np.concatenate([state.counted for state in states], axis=1)
    sized = np.concatenate([state.sized for state in states], axis=1)
    ids, named = counted[ekf.IDS], np.concatenate(names)
    kept, dropped = np.flatnonzero(ids == named), np.flatnonzero(ids != named)
    take_over(counted, sized, np.searchsorted(ids, named[dropped]), dropped)
    mean = np.concatenate([best.poses[-1], best.positions.ravel()])
    state = MapState(
        mean, best.covariance([len(maps)], best.ids), counted[:, kept], sized[:, kept], maps[-1].step, maps[-1].next_id
    )
    return StochasticMap.of_state(maps[0].spec, state)


def joined_estimate(mean_a: Array, P_a: Array, mean_b: Array, P_b: Array) -> tuple[Array, Array]:
    """x (3 + 2(n_a + n_b),) and P of the joined state, from x_A (3 + 2n_a,), x_B (3 + 2n_b,) and their covariances."""
    (x0, y0, heading), d, rest = mean_a[:3], len(mean_b), len(mean_a) - 3
    c, s = math.cos(heading), math.sin(heading)
    along = np.concatenate([[0], np.arange(3, d, 2)])  # where x coordinates of the robot and features of B are
    across = along + 1
    moved = mean_b.copy()
    moved[along] = x0 + c * mean_b[along] - s * mean_b[across]
    moved[across] = y0 + s * mean_b[along] + c * mean_b[across]
    moved[2] = wrap_angle(heading + mean_b[2])
    M = np.zeros((d, 3))  # ∂(R_A ⊕ x_B)/∂R_A; by x_B it is the rotation of each point
    M[along, 0] = M[across, 1] = M[2, 2] = 1.0
    M[along, 2], M[across, 2] = y0 - moved[across], moved[along] - x0
    turned = P_b.copy()
    turned[along], turned[across] = c * P_b[along] - s * P_b[across], s * P_b[along] + c * P_b[across]
    x_columns, y_columns = turned[:, along].copy(), turned[:, across].copy()
    turned[:, along], turned[:, across] = c * x_columns - s * y_columns, s * x_columns + c * y_columns
    of_b = M @ P_a[:3, :3] @ M.T + turned
    between = M @ P_a[:3, 3:]
    mean = np.concatenate([moved[:3], mean_a[3:], moved[3:]])
    P = np.empty((rest + d, rest + d))
    P[:rest, :rest] = P_a[3:, 3:]
    P[rest:, :rest], P[:rest, rest:], P[rest:, rest:] = between, between.T, of_b
    order = np.concatenate([rest + np.arange(3), np.arange(rest), np.arange(rest + 3, rest + d)])
    P = P[np.ix_(order, order)]
    return mean, 0.5 * (P + P.T)


def equate(m: StochasticMap, pairs: IntArray) -> StochasticMap:
    """The map in which features pairs[i, 0] and pairs[i, 1], (k, 2), are one: the first of each is left.

    Equality update, then the second features are deleted; what was known of them (sightings, size, kind) goes to the
    first. Raises ValueError where a feature does not exist or is to be deleted twice, or where S is singular.
    """
    pairs = np.ascontiguousarray(pairs, dtype=np.int64).reshape(-1, 2)
    kept, dropped = pairs[:, 0], pairs[:, 1]
    if len(pairs) and (pairs.min() < 0 or pairs.max() >= m.n):
        raise ValueError(f"pairs: {pairs.tolist()} in a map of {m.n} features")
    if len(np.unique(dropped)) < len(dropped) or len(np.intersect1d(kept, dropped)):
        raise ValueError(f"pairs: {pairs.tolist()} delete a feature twice, or one that is to be kept")
    state = m.state
    mean, covariance = equality_update(state.mean, state.covariance, pairs)
    take_over(state.counted, state.sized, kept, dropped)
    equal = StochasticMap.of_state(m.spec, replace(state, mean=mean, covariance=covariance))
    equal.remove(dropped)
    return equal


def take_over(counted: IntArray, sized: Array, kept: IntArray, dropped: IntArray) -> None:
    """Feature kept[i] takes over what was known of its duplicate dropped[i], both (k,); nothing is deleted.

    Sightings add up, sizes are averaged by their variances, and an unknown kind gives way to a known one. `counted` and
    `sized` are those of `MapState`, changed in place.
    """
    seen, first_seen, last_seen, kinds = (counted[row] for row in (ekf.SEEN, ekf.FIRST_SEEN, ekf.LAST_SEEN, ekf.KINDS))
    sizes, variances = sized
    for a, b in zip(kept.tolist(), dropped.tolist()):
        seen[a] += seen[b]
        first_seen[a] = min(first_seen[a], first_seen[b])
        last_seen[a] = max(last_seen[a], last_seen[b])
        kinds[a] = kinds[b] if kinds[a] == UNKNOWN_KIND else kinds[a]
        if np.isfinite(sizes[a]) and np.isfinite(sizes[b]):
            total = variances[a] + variances[b]
            gain = variances[a] / total if total > 0.0 else 0.0
            sizes[a] += gain * (sizes[b] - sizes[a])
            variances[a] *= 1.0 - gain
        elif np.isfinite(sizes[b]):
            sizes[a], variances[a] = sizes[b], variances[b]


def equality_update(mean: Array, P: Array, pairs: IntArray) -> tuple[Array, Array]:
    """x (d,) and P (d, d) given F_a = F_b for all pairs (k, 2) at once; P is left singular, for they are equal now.

    H = [… I … −I …], ν = −H x, S = H P Hᵀ = L Lᵀ, W = L⁻¹ H P; x ← x + Wᵀ L⁻¹ ν, P ← P − Wᵀ W. Raises ValueError where
    S is not positive definite, as when two features are known exactly.
    """
    if not len(pairs):
        return mean.copy(), P.copy()
    d, side = len(mean), padded(len(mean))
    first, second = (3 + 2 * pairs[:, column, None] + np.arange(2) for column in (0, 1))
    first, second = first.ravel(), second.ravel()
    W, left = np.zeros((len(first), side)), aligned_zeros(side, side)
    W[:, :d], left[:d, :d] = P[first] - P[second], P
    S = np.ascontiguousarray(W[:, first] - W[:, second])
    S[np.diag_indices(len(S))] += ROUNDING * (P[first, first] + P[second, second])
    if not cholesky(S):
        raise ValueError("pairs: the covariance of what is to be equal is singular")
    nu = mean[second] - mean[first]
    whiten(S, W, nu)
    out = mean + (W[:, :d] * nu[:, None]).sum(axis=0)
    out[2] = wrap_angle(out[2])
    subtract_squares(left, W)
    return out, ekf.symmetric(left, d)
