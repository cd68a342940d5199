"""Expected information gain: how much one scan from another place would improve the map, by a simulated EKF update."""

from __future__ import annotations

import math

import numpy as np

from slam_gym._jit import compiled
from slam_gym.navigation.explored_grid import Cells, ExploredCells, ExploredGrid
from slam_gym.navigation.visibility import passage
from slam_gym.types import Array, IntArray

MAX_FEATURES = 12  # nearest features in view that the simulated update uses


def expected_reduction(
    mean: Array, covariance: Array, grid: ExploredGrid, places: Array, *, reach: float, sigma: float, drift: Array
) -> Array:
    """(q,) [m²] decrease of Σ_j tr P_jj over all mapped features, by one full-circle scan from each place (q, 2) in B.

    The robot moves to the place along a known path, P_RR → F P_RR Fᵀ + diag(`drift`²) [m, m, rad], (3,) for all or
    (q, 3), and measures the nearest mapped features within `reach` [m] and in line of sight over the explored `grid`,
    each with a standard deviation of `sigma` [m]. With W = L⁻¹ H P and S = L Lᵀ = H P Hᵀ + R the covariance falls by
    Wᵀ W, so the result is the sum of the squares in the feature columns of W: through the cross-covariances, a loop
    closure reduces the variances of all features.

    `mean` (3 + 2n,), `covariance` (3 + 2n, 3 + 2n) of the stochastic map.
    """
    drifts = np.broadcast_to(np.square(drift), (len(places), 3))
    nearest = _in_sight(mean, (grid.cells, grid.origin, grid.resolution), places, reach, MAX_FEATURES)
    gains = [
        _reduction(mean, covariance, place, features[features >= 0], sigma**2, variances)
        for place, features, variances in zip(places, nearest, drifts)
    ]
    return np.array(gains)


def features_in_sight(mean: Array, grid: ExploredGrid, places: Array, reach: float) -> IntArray:
    """(q,) number of features of `mean` (3 + 2n,) within `reach` [m] and in line of sight of each of `places` (q, 2).

    Only known walls block the line of sight; unknown space does not.
    """
    seen = _in_sight(mean, (grid.cells, grid.origin, grid.resolution), places, reach, len(mean) // 2 - 1)
    return np.asarray(np.count_nonzero(seen >= 0, axis=1))


@compiled
def _in_sight(x: Array, packed: tuple[Cells, Array, float], places: Array, reach: float, most: int) -> IntArray:
    """(q, most) the nearest features within reach of each of `places` (q, 2) and in line of sight, padded with −1."""
    explored, n = ExploredCells(*packed), (len(x) - 3) // 2
    side, out = explored.resolution, np.full((len(places), most), -1)
    near, distances = np.empty(n, np.int64), np.empty(n)
    for q in range(len(places)):
        px, py, k, count = places[q, 0], places[q, 1], 0, 0
        for j in range(n):
            dx, dy = x[3 + 2 * j] - px, x[4 + 2 * j] - py
            if abs(dx) > reach or abs(dy) > reach:  # rejects most features, without a root
                continue
            distance = math.hypot(dx, dy)
            if distance <= reach:
                near[k], distances[k] = j, distance
                k += 1
        from_x, from_y = (px - explored.origin[0]) / side, (py - explored.origin[1]) / side
        for j in near[np.argsort(distances[:k], kind="mergesort")]:
            dx, dy = (x[3 + 2 * j] - px) / side, (x[4 + 2 * j] - py) / side
            if count < most and passage(explored.cells, from_x, from_y, dx, dy, 1.0) > 0.0:  # the unknown never blocks
                out[q, count] = j
                count += 1
    return out


def _reduction(x: Array, P: Array, place: Array, features: IntArray, r: float, drift: Array) -> float:
    """Σ of squares of the feature columns of L⁻¹ H P after the robot has moved to the place; `r`, `drift`: variances.

    H is in axes parallel to B, because the heading of the robot at the place does not change the sum.
    """
    k = len(features)
    if k == 0:
        return 0.0
    F, H = np.eye(3), np.zeros((2 * k, 3))
    F[0, 2], F[1, 2] = x[1] - place[1], place[0] - x[0]
    robot = F @ P[:3]  # rows of the robot, after the motion
    robot[:, :3] = robot[:, :3] @ F.T + np.diag(drift)
    rows = (3 + 2 * features[:, None] + [0, 1]).ravel()
    offsets = x[rows].reshape(k, 2) - place
    H[0::2, 0] = H[1::2, 1] = -1.0
    H[0::2, 2], H[1::2, 2] = offsets[:, 1], -offsets[:, 0]
    HP = H @ robot + np.hstack([robot[:, rows].T, P[rows, 3:]])
    S = HP[:, :3] @ H.T + HP[:, rows] + r * np.eye(2 * k)
    try:
        whitened = np.linalg.solve(np.linalg.cholesky(S), HP[:, 3:])
    except np.linalg.LinAlgError:  # not positive definite
        return 0.0
    return float(np.square(whitened).sum())
