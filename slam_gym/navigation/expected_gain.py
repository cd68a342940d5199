"""How much would the map improve if the robot looked from over there? One EKF update, foreseen but not carried out."""

from __future__ import annotations

import math

import numpy as np

from slam_gym._jit import compiled
from slam_gym.mapping.linear_algebra import cholesky
from slam_gym.navigation.explored_grid import Cells, ExploredCells, ExploredGrid
from slam_gym.navigation.visibility import passage
from slam_gym.types import Array, IntArray

MAX_FEATURES = 12  # nearest features in view that the foreseen update uses


def expected_reduction(
    mean: Array, covariance: Array, grid: ExploredGrid, places: Array, *, reach: float, sigma: float, drift: Array
) -> Array:
    """(q,) [m²] decrease of Σ_j tr P_jj, over all mapped features, by one look around from each place (q, 2) in B.

    The robot is taken to the place along a known way, P_RR → F P_RR Fᵀ + diag(`drift`²) [m, m, rad], (3,) for all or
    (q, 3), and measures the nearest mapped features within `reach` [m] and in line of sight over the explored `grid`,
    each with a standard deviation of `sigma` [m]. With W = L⁻¹ H P and S = L Lᵀ = H P Hᵀ + R the covariance falls by
    Wᵀ W, so the result is the sum of the squares in the feature columns of W: through the cross-covariances a loop
    closure shows in all of it.

    `mean` (3 + 2n,), `covariance` (3 + 2n, 3 + 2n) of the stochastic map.
    """
    explored = (grid.cells, grid.origin, grid.resolution)
    variances = np.ascontiguousarray(np.broadcast_to(np.square(drift), (len(places), 3)))
    return _expected_reduction(mean, covariance, explored, places, reach, sigma**2, variances)


def features_in_sight(mean: Array, grid: ExploredGrid, places: Array, reach: float) -> IntArray:
    """(q,) features of the state `mean` (3 + 2n,) within `reach` [m] and in line of sight of each of `places` (q, 2).

    As far as walls are known: the unknown hides nothing.
    """
    return _features_in_sight(mean, (grid.cells, grid.origin, grid.resolution), places, reach)


@compiled
def _features_in_sight(x: Array, packed: tuple[Cells, Array, float], places: Array, reach: float) -> IntArray:
    """See `features_in_sight`."""
    explored, out = ExploredCells(*packed), np.zeros(places.shape[0], np.int64)
    for q in range(places.shape[0]):
        out[q] = len(_in_view(x, explored, places[q], reach, len(x)))
    return out


@compiled
def _expected_reduction(
    x: Array, P: Array, packed: tuple[Cells, Array, float], places: Array, reach: float, r: float, drift: Array
) -> Array:
    """See `expected_reduction`; `r` and `drift` are variances."""
    explored, out = ExploredCells(*packed), np.zeros(places.shape[0])
    for q in range(places.shape[0]):
        features = _in_view(x, explored, places[q], reach, MAX_FEATURES)
        if len(features):
            out[q] = _reduction(x, P, places[q], features, r, drift[q])
    return out


@compiled
def _in_view(x: Array, explored: ExploredCells, place: Array, reach: float, most: int) -> IntArray:
    """The nearest features within reach of the place and in line of sight, at most so many."""
    n = (len(x) - 3) // 2
    near, distances, k = np.empty(n, np.int64), np.empty(n), 0
    for j in range(n):
        dx, dy = x[3 + 2 * j] - place[0], x[4 + 2 * j] - place[1]
        if abs(dx) > reach or abs(dy) > reach:  # most of them, and cheaper than the root
            continue
        distance = math.hypot(dx, dy)
        if distance <= reach:
            near[k], distances[k] = j, distance
            k += 1
    side, count = explored.resolution, 0
    from_x, from_y = (place[0] - explored.origin[0]) / side, (place[1] - explored.origin[1]) / side
    nearest = near[np.argsort(distances[:k], kind="mergesort")]
    for j in nearest:
        dx, dy = (x[3 + 2 * j] - place[0]) / side, (x[4 + 2 * j] - place[1]) / side
        if count < most and passage(explored.cells, from_x, from_y, dx, dy, 1.0) > 0.0:  # the unknown hides nothing
            nearest[count] = j
            count += 1
    return nearest[:count]


@compiled
def _reduction(x: Array, P: Array, place: Array, features: IntArray, r: float, drift: Array) -> float:
    """Σ of squares of the feature columns of L⁻¹ H P after the robot has moved to the place.

    In one function: taken apart, with arrays handed on, it is three times as slow.
    """
    d, k = len(x), len(features)
    dx, dy = place[0] - x[0], place[1] - x[1]
    robot = np.empty((3, d))  # rows of the moved robot: F P
    for j in range(d):
        robot[0, j] = P[0, j] - dy * P[2, j]
        robot[1, j] = P[1, j] + dx * P[2, j]
        robot[2, j] = P[2, j]
    for i in range(3):  # F P Fᵀ + drift in the robot's own columns
        xi, yi, ti = robot[i, 0], robot[i, 1], robot[i, 2]
        robot[i, 0], robot[i, 1] = xi - dy * ti, yi + dx * ti
        robot[i, i] += drift[i]
    HP, S = np.empty((2 * k, d)), np.zeros((2 * k, 2 * k))
    for i in range(k):
        f = 3 + 2 * features[i]
        fx, fy = x[f] - place[0], x[f + 1] - place[1]
        for j in range(d):
            own_x = P[f, j] if j > 2 else robot[j, f]
            own_y = P[f + 1, j] if j > 2 else robot[j, f + 1]
            HP[2 * i, j] = own_x - robot[0, j] + fy * robot[2, j]
            HP[2 * i + 1, j] = own_y - robot[1, j] - fx * robot[2, j]
    for i in range(k):
        f = 3 + 2 * features[i]
        fx, fy = x[f] - place[0], x[f + 1] - place[1]
        for row in range(2 * k):
            S[row, 2 * i] = HP[row, f] - HP[row, 0] + fy * HP[row, 2]
            S[row, 2 * i + 1] = HP[row, f + 1] - HP[row, 1] - fx * HP[row, 2]
        S[2 * i, 2 * i] += r
        S[2 * i + 1, 2 * i + 1] += r
    if not cholesky(S):
        return 0.0
    total = 0.0
    for i in range(2 * k):
        for m in range(i):
            for j in range(3, d):
                HP[i, j] -= S[i, m] * HP[m, j]
        for j in range(3, d):
            HP[i, j] /= S[i, i]
            total += HP[i, j] * HP[i, j]
    return total
