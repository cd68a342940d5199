"""Map joining: two statistically independent stochastic maps become one (Tardós, Neira, Newman and Leonard, IJRR 2002).

Map A, in base B_A, ends with its robot at R_A, which is the base of map B: x_B is given in the frame of R_A. The joined
state, all in B_A, is

    x = (R_A ⊕ R_B; F_A; R_A ⊕ F_B),    P = J_A P_A J_Aᵀ + J_B P_B J_Bᵀ,

where J_A, J_B are the Jacobians of x with respect to x_A and x_B. Features that both maps hold are then matched, an
update with the noise-free measurement F_a − F_b = 0 makes them equal, and one of each pair is deleted.

Many maps are joined at once by least squares (`join_all`): each map is a measurement (R_i; F_i), of covariance P_i, of
the next base and of its features, relative to its own base. The solution is exact except for rounding, linearised at
the result, and sparse: only maps that share features or follow each other are coupled.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag, cho_solve
from scipy.sparse import csc_array

from slam_gym.geometry import wrap_angle
from slam_gym.mapping import ekf
from slam_gym.mapping.linear_algebra import ROUNDING, aligned_zeros, cholesky, padded, subtract_squares, whiten
from slam_gym.mapping.smoothing import FactorGraph, Smoothed, dead_reckoning
from slam_gym.mapping.stochastic_map import MapState, StochasticMap
from slam_gym.mapping.update import corrected, express_at, heading_correction, left_jacobian_inverse
from slam_gym.types import UNKNOWN_KIND, Array, IntArray

UNKNOWN_POSE = np.diag([10.0**2, 10.0**2, math.pi**2 / 3.0])
"""[m², m², rad²] Uninformative covariance of a pose, or of the relation of two maps, before it is estimated."""
_MIN_VARIANCE = 1e-12  # [m²], [rad²] added to the variances of a local map that is joined with others


def join(a: StochasticMap, b: StochasticMap, base: Array | None = None, *, robot_of_a: bool = False) -> StochasticMap:
    """Join two maps in the base of `a`: the features of `a`, then those of `b`, without matching them.

    The base of `b` is the robot pose of `a`, or the pose `base` (3,), of uninformative covariance, which `equate` then
    determines. With `robot_of_a`, which leaves no heading to correct, or without right-invariant errors, it must be
    right to a degree. The directions from which features of `b` were seen turn by the heading of this pose. The robot
    is that of `b`, or, with `base`, that of `a` if `robot_of_a`; the settings are those of `a`. Neither map is changed.
    Raises ValueError where both maps use an id.
    """
    first, second = a.state, b.state
    common = np.intersect1d(first.counted[ekf.IDS], second.counted[ekf.IDS])
    if len(common):
        raise ValueError(f"ids: both maps have features {common[:5].tolist()}")
    if base is None:
        mean, covariance = joined_estimate(first.mean, first.covariance, second.mean, second.covariance)
    else:  # for the equations, the base of b is one more robot of a
        mean_a, P_a = np.concatenate([base, first.mean]), block_diag(UNKNOWN_POSE, first.covariance)
        mean, covariance = joined_estimate(mean_a, P_a, second.mean, second.covariance)
        entries = np.delete(np.arange(len(mean)), np.arange(3) + (0 if robot_of_a else 3))  # without the other robot
        mean, covariance = mean[entries], covariance[np.ix_(entries, entries)]
    step, next_id = max(first.step, second.step), max(first.next_id, second.next_id)
    heading = float(first.mean[2] if base is None else base[2])  # of the base of b
    counted = np.concatenate([first.counted, directions_turned(second.counted, heading)], axis=1)
    sized = np.concatenate([first.sized, second.sized], axis=1)
    return StochasticMap.of_state(a.spec, MapState(mean, covariance, counted, sized, step, next_id))


def join_all(maps: Sequence[StochasticMap], names: Sequence[IntArray]) -> Smoothed:
    """Join maps in the base of the first; the base of each map is the last robot pose of the map before it.

    Features with the same name are one: `names` (n_i,) are those of the features of each map, distinct within a map.
    The poses are the bases of the maps, then the pose of the robot. Every variance is raised by (1 µm)², because a
    robot that has not moved since its map began knows its pose exactly. Raises ValueError where the iterations run out.
    """
    count, sizes = len(maps), [m.n for m in maps]
    ids, feature = np.unique(np.concatenate(names), return_inverse=True)
    rows, columns, values = [], [], []
    for number, (m, first) in enumerate(zip(maps, 3 * count + 2 * np.cumsum([0, *sizes]))):
        entries = np.concatenate([3 * number + np.arange(3), first + np.arange(2 * m.n)])
        values.append(np.linalg.inv(m.covariance + _MIN_VARIANCE * np.eye(len(entries))).ravel())
        rows.append(np.repeat(entries, len(entries)))
        columns.append(np.tile(entries, len(entries)))
    total = 3 * count + 2 * sum(sizes)
    at = np.concatenate(rows), np.concatenate(columns)
    information = csc_array((np.concatenate(values), at), shape=(total, total))
    motions, points = np.array([m.pose for m in maps]), np.concatenate([m.positions for m in maps])
    graph = FactorGraph(motions, points, np.repeat(np.arange(count), sizes), feature, information)
    return graph.optimum(dead_reckoning(motions), ids)


def joined_map(maps: Sequence[StochasticMap], names: Sequence[IntArray]) -> StochasticMap:
    """`join_all` as one map with full covariance. Time and memory grow with the cube and the square of its size.

    A name is the id of the oldest of the features with this name; ids ascend from map to map. Each feature takes over
    the sightings, directions, size and kind from all maps. The settings are those of the first map, the robot is that
    of the last.
    """
    best, states = join_all(maps, names), [m.state for m in maps]
    headings = best.poses[:, 2].tolist()
    turned = [directions_turned(state.counted, heading) for state, heading in zip(states, headings)]
    counted = np.concatenate(turned, axis=1)
    sized = np.concatenate([state.sized for state in states], axis=1)
    ids, named = counted[ekf.IDS], np.concatenate(names)
    kept, dropped = np.flatnonzero(ids == named), np.flatnonzero(ids != named)
    take_over(counted, sized, np.searchsorted(ids, named[dropped]), dropped)
    mean = np.concatenate([best.poses[-1], best.positions.ravel()])
    state = MapState(
        mean, best.covariance([len(maps)], best.ids), counted[:, kept], sized[:, kept], maps[-1].step, maps[-1].next_id
    )
    return StochasticMap.of_state(maps[0].spec, state)


def directions_turned(counted: IntArray, heading: float) -> IntArray:
    """The `counted` (6, n) of a map in a frame in which its base has the `heading` [rad]."""
    out, by = counted.copy(), round(heading / (2.0 * math.pi) * ekf.SECTORS) % ekf.SECTORS
    low = (1 << (ekf.SECTORS - by)) - 1
    out[ekf.DIRECTIONS] = ((out[ekf.DIRECTIONS] & low) << by) | (out[ekf.DIRECTIONS] >> (ekf.SECTORS - by))
    return out


def joined_estimate(mean_a: Array, P_a: Array, mean_b: Array, P_b: Array) -> tuple[Array, Array]:
    """x (3 + 2(n_a + n_b),) and P of the joined state, from x_A (3 + 2n_a,), x_B (3 + 2n_b,) and their covariances."""
    (x0, y0, heading), d, rest = mean_a[:3], len(mean_b), len(mean_a) - 3
    c, s = math.cos(heading), math.sin(heading)
    xs = np.concatenate([[0], np.arange(3, d, 2)])  # entries of the x coordinates of robot and features of B
    ys = xs + 1
    moved = mean_b.copy()
    moved[xs] = x0 + c * mean_b[xs] - s * mean_b[ys]
    moved[ys] = y0 + s * mean_b[xs] + c * mean_b[ys]
    moved[2] = wrap_angle(heading + mean_b[2])
    M = np.zeros((d, 3))  # ∂(R_A ⊕ x_B)/∂R_A; the Jacobian with respect to x_B is the rotation of each point
    M[xs, 0] = M[ys, 1] = M[2, 2] = 1.0
    M[xs, 2], M[ys, 2] = y0 - moved[ys], moved[xs] - x0
    turned = P_b.copy()
    turned[xs], turned[ys] = c * P_b[xs] - s * P_b[ys], s * P_b[xs] + c * P_b[ys]
    x_columns, y_columns = turned[:, xs].copy(), turned[:, ys].copy()
    turned[:, xs], turned[:, ys] = c * x_columns - s * y_columns, s * x_columns + c * y_columns
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
    """Fuse the features pairs[i, 0] and pairs[i, 1], (k, 2), and return the new map, which keeps the first of each.

    An equality update, after which the second features are deleted; the first take over their sightings, directions,
    sizes, kinds and older ids. Raises ValueError where a feature does not exist or would be deleted twice, or where S
    is singular.
    """
    pairs = np.ascontiguousarray(pairs, dtype=np.int64).reshape(-1, 2)
    kept, dropped = pairs[:, 0], pairs[:, 1]
    if len(pairs) and (pairs.min() < 0 or pairs.max() >= m.n):
        raise ValueError(f"pairs: {pairs.tolist()} in a map of {m.n} features")
    if len(np.unique(dropped)) < len(dropped) or len(np.intersect1d(kept, dropped)):
        raise ValueError(f"pairs: {pairs.tolist()} delete a feature twice, or one that is to be kept")
    state = m.state
    mean, covariance = equality_update(state.mean, state.covariance, pairs, m.spec.right_invariant)
    take_over(state.counted, state.sized, kept, dropped)
    fused = StochasticMap.of_state(m.spec, replace(state, mean=mean, covariance=covariance))
    fused.remove(dropped)
    return fused


def take_over(counted: IntArray, sized: Array, kept: IntArray, dropped: IntArray) -> None:
    """Merge what is known of feature dropped[i] into feature kept[i], both (k,); nothing is deleted.

    The older id stays, sightings and directions add up, sizes are averaged by their variances, and a known kind
    replaces an unknown one. `counted` and `sized` are those of `MapState`, changed in place.
    """
    ids, seen, first_seen, last_seen, kinds, directions = counted
    sizes, variances = sized
    for a, b in zip(kept.tolist(), dropped.tolist()):
        ids[a] = min(ids[a], ids[b])
        seen[a] += seen[b]
        first_seen[a] = min(first_seen[a], first_seen[b])
        last_seen[a] = max(last_seen[a], last_seen[b])
        directions[a] |= directions[b]
        kinds[a] = kinds[b] if kinds[a] == UNKNOWN_KIND else kinds[a]
        if np.isfinite(sizes[a]) and np.isfinite(sizes[b]):
            total = variances[a] + variances[b]
            gain = variances[a] / total if total > 0.0 else 0.0
            sizes[a] += gain * (sizes[b] - sizes[a])
            variances[a] *= 1.0 - gain
        elif np.isfinite(sizes[b]):
            sizes[a], variances[a] = sizes[b], variances[b]


def equality_update(mean: Array, P: Array, pairs: IntArray, invariant: bool) -> tuple[Array, Array]:
    """x (d,) and P (d, d) given F_a = F_b for all pairs (k, 2) at once; P becomes singular, as both are then equal.

    H = [… I … −I …], ν = −H x, S = H P Hᵀ = L Lᵀ, W = L⁻¹ H P; x ← x + Wᵀ L⁻¹ ν, P ← P − Wᵀ W. Raises ValueError where
    S is not positive definite, as when two features are known exactly.

    It is linear in x and P, unless the errors are right-`invariant`: then δ = K V(δθ)⁻¹ ν moves x along the group, as
    in `mapping.update`, so that the error of the heading may be large.
    """
    if not len(pairs):
        return mean.copy(), P.copy()
    d, side = len(mean), padded(len(mean))
    first, second = (3 + 2 * pairs[:, column, None] + np.arange(2) for column in (0, 1))
    first, second = first.ravel(), second.ravel()
    W, posterior = np.zeros((len(first), side)), aligned_zeros(side, side)
    W[:, :d], posterior[:d, :d] = P[first] - P[second], P
    S = np.ascontiguousarray(W[:, first] - W[:, second])
    S[np.diag_indices(len(S))] += ROUNDING * (P[first, first] + P[second, second])
    if not cholesky(S):
        raise ValueError("pairs: the covariance of their differences is singular")
    nu = mean[second] - mean[first]
    if invariant:
        turn = heading_correction(nu.reshape(-1, 2), cho_solve((S, True), W[:, 2]))
        nu = left_jacobian_inverse(nu.reshape(-1, 2), turn).ravel()
    whiten(S, W, nu)
    _, out = corrected(mean, W, nu, d, invariant)
    subtract_squares(posterior, W)
    if invariant:
        express_at(posterior, d, mean, out)
    out[2] = wrap_angle(out[2])
    return out, ekf.symmetric(posterior, d)
