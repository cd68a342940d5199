"""Optimal assignment between two point sets with a cutoff: exact, and fast because distant pairs never meet.

Minimises Σ_{(i,j) ∈ γ} d_ij^p + ½ c^p (e + N − 2|γ|) over partial assignments γ, which is the same as minimising
Σ_{(i,j) ∈ γ} (d_ij^p − c^p): only pairs closer than the cutoff c can help. They are gathered through a grid, then
assigned by shortest augmenting paths (Jonker and Volgenant 1987) over that sparse graph, where a row may also stay
unassigned at cost 0. Rows whose nearest column nobody else wants are settled without a search, which in a good map is
almost all of them.
"""

from __future__ import annotations

import math

import numpy as np

from slam_gym._compile import compiled
from slam_gym.types import NONE, Array, BoolArray, IntArray


@compiled
def assign(estimated: Array, true: Array, cutoff: float, p: float) -> tuple[IntArray, float, int]:
    """True point (e,) of each estimated one, or NONE; Σ d^p [m^p] of the pairs; their number.

    `estimated` (e, 2) and `true` (N, 2) [m], C-contiguous; `cutoff` [m]. Raises ValueError for points that are not
    finite.
    """
    starts, columns, costs = _pairs_within(estimated, true, cutoff)
    ceiling = cutoff**p
    for k in range(len(costs)):
        costs[k] = (costs[k] if p == 1.0 else costs[k] ** p) - ceiling
    column_of = _least_cost(starts, columns, costs, len(true))
    total, paired = 0.0, 0
    for i in range(len(estimated)):
        if column_of[i] != NONE:
            j = column_of[i]
            total += math.hypot(estimated[i, 0] - true[j, 0], estimated[i, 1] - true[j, 1]) ** p
            paired += 1
    return column_of, total, paired


@compiled
def _pairs_within(estimated: Array, true: Array, cutoff: float) -> tuple[IntArray, IntArray, Array]:
    """All pairs closer than the cutoff, by estimated point: starts (e + 1,), true points (q,), distances (q,) [m]."""
    x_low, y_low, cell, width, height = _grid(estimated, true, cutoff)
    cell_starts, order = _bin(true, x_low, y_low, cell, width, height)
    starts = np.zeros(len(estimated) + 1, np.int64)
    columns, distances = np.empty(0, np.int64), np.empty(0)
    for filling in (False, True):
        q = 0
        for i in range(len(estimated)):
            x, y = (estimated[i, 0] - x_low) / cell, (estimated[i, 1] - y_low) / cell
            if len(true) and -1.0 <= x < width + 1 and -1.0 <= y < height + 1:
                left, right = max(math.floor(x) - 1, 0), min(math.floor(x) + 1, width - 1)
                for row in range(max(math.floor(y) - 1, 0), min(math.floor(y) + 2, height)):
                    for k in range(cell_starts[row * width + left], cell_starts[row * width + right + 1]):
                        dx, dy = estimated[i, 0] - true[order[k], 0], estimated[i, 1] - true[order[k], 1]
                        if dx * dx + dy * dy < cutoff * cutoff:
                            if filling:
                                columns[q], distances[q] = order[k], math.sqrt(dx * dx + dy * dy)
                            q += 1
            starts[i + 1] = q
        if not filling:
            columns, distances = np.empty(q, np.int64), np.empty(q)
    return starts, columns, distances


@compiled
def _grid(estimated: Array, true: Array, cutoff: float) -> tuple[float, float, float, int, int]:
    """Lower corner, cell size, width and height of a grid over the true points, of O(N) cells not under the cutoff."""
    _extent(estimated, 0), _extent(estimated, 1)
    x_low, x_high = _extent(true, 0)
    y_low, y_high = _extent(true, 1)
    wide, high = x_high - x_low, y_high - y_low
    cell = max(cutoff, math.sqrt(wide / (4 * len(true) + 1) * high), wide / 1024, high / 1024)
    if not math.isfinite(cell):
        raise ValueError("the true positions are too far apart")
    return x_low, y_low, cell, int(wide / cell) + 1, int(high / cell) + 1


@compiled
def _extent(points: Array, axis: int) -> tuple[float, float]:
    low, high = (points[0, axis], points[0, axis]) if len(points) else (0.0, 0.0)
    for j in range(len(points)):
        if not math.isfinite(points[j, axis]):
            raise ValueError("a position is not finite")
        low, high = min(low, points[j, axis]), max(high, points[j, axis])
    return low, high


@compiled
def _bin(points: Array, x_low: float, y_low: float, cell: float, width: int, height: int) -> tuple[IntArray, IntArray]:
    """Counting sort of points (N, 2) into grid cells, row by row: starts (cells + 1,) and the points (N,) in order."""
    where = np.empty(len(points), np.int64)
    starts = np.zeros(width * height + 1, np.int64)
    for j in range(len(points)):
        where[j] = int((points[j, 1] - y_low) / cell) * width + int((points[j, 0] - x_low) / cell)
        starts[where[j] + 1] += 1
    for k in range(width * height):
        starts[k + 1] += starts[k]
    order, free = np.empty(len(points), np.int64), starts.copy()
    for j in range(len(points)):
        order[free[where[j]]] = j
        free[where[j]] += 1
    return starts, order


@compiled
def _least_cost(starts: IntArray, columns: IntArray, costs: Array, n: int) -> IntArray:
    """Column of each row in the partial assignment of least total cost, or NONE (cost 0). All costs are negative.

    Dual variables u ≤ 0 of the rows and v ≤ 0 of the n columns keep u_i + v_j ≤ cost_ij, with equality on the pairs
    assigned; u = 0 for rows and v = 0 for columns left alone. That proves the assignment optimal.
    """
    m = len(starts) - 1
    column_of, row_of = np.full(m, NONE), np.full(n, NONE)
    u, v = np.zeros(m), np.zeros(n)
    for i in range(m):
        nearest = NONE
        for k in range(starts[i], starts[i + 1]):
            if costs[k] < u[i]:
                u[i], nearest = costs[k], columns[k]
        if nearest != NONE and row_of[nearest] == NONE:
            column_of[i], row_of[nearest] = nearest, i
    distance, came_from, done = np.full(n, np.inf), np.full(n, NONE), np.zeros(n, np.bool_)
    for i in range(m):
        if column_of[i] == NONE and u[i] < 0.0:
            _augment(i, starts, columns, costs, column_of, row_of, u, v, distance, came_from, done)
    return column_of


@compiled
def _augment(
    root: int,
    starts: IntArray,
    columns: IntArray,
    costs: Array,
    column_of: IntArray,
    row_of: IntArray,
    u: Array,
    v: Array,
    distance: Array,
    came_from: IntArray,
    done: BoolArray,
) -> None:
    """Settle row `root` along the shortest augmenting path (Dijkstra on reduced costs cost_ij − u_i − v_j ≥ 0).

    The path ends at a free column, or at a row that gives its column up. The last three are workspaces (n,), handed
    back as they came: inf, any, false.
    """
    touched, count = np.empty(len(row_of), np.int64), 0
    end, row_end, length = NONE, root, np.inf  # where the path ends: at column `end`, else at row `row_end`
    i, reached = root, 0.0
    while True:
        if reached - u[i] < length:
            row_end, length = i, reached - u[i]
        for k in range(starts[i], starts[i + 1]):
            j = columns[k]
            to_j = reached + costs[k] - u[i] - v[j]
            if not done[j] and to_j < distance[j]:
                if distance[j] == np.inf:
                    touched[count] = j
                    count += 1
                distance[j], came_from[j] = to_j, i
        best = NONE
        for k in range(count):
            if not done[touched[k]] and (best == NONE or distance[touched[k]] < distance[best]):
                best = touched[k]
        if best == NONE or distance[best] >= length:
            break
        if row_of[best] == NONE:
            end, length = best, distance[best]
            break
        done[best], reached, i = True, distance[best], row_of[best]
    u[root] += length
    for k in range(count):
        j = touched[k]
        if done[j]:
            u[row_of[j]] += length - distance[j]
            v[j] -= length - distance[j]
        distance[j], done[j] = np.inf, False
    if end == NONE:
        end, column_of[row_end], u[row_end] = column_of[row_end], NONE, 0.0
    while end != NONE:  # hand each column on the path to the row that came for it
        row = came_from[end]
        row_of[end] = row
        column_of[row], end = end, column_of[row]
