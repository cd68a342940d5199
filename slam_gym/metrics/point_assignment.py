"""Optimal assignment between two point sets with a cutoff: exact, and fast because distant pairs are never considered.

Minimises Σ_{(i,j) ∈ γ} d_ij^p + ½ c^p (e + N − 2|γ|) over partial assignments γ, which is the same as minimising
Σ_{(i,j) ∈ γ} (d_ij^p − c^p): only pairs closer than the cutoff c reduce it. They are collected along x, then assigned
by shortest augmenting paths (Jonker and Volgenant 1987) over this sparse graph, where a row may also stay unassigned at
cost 0. A row whose nearest column is still free is assigned to it without a search, in a good map almost all rows.
"""

import math
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.types import UNPAIRED, Array, IntArray

_NONE = -1  # the row of an unassigned column, the column of an unassigned row


Index = tuple[Array, IntArray, Array, float]
"""True points (N, 2) [m], their order (N,) along x, their x [m] in that order, and the cutoff [m] of an assignment."""


class _Pairs(NamedTuple):
    """The pairs that may be assigned, row by row: the pairs of row i are starts[i]:starts[i + 1]."""

    starts: IntArray  # (e + 1,)
    columns: IntArray  # (q,)
    costs: Array  # (q,) negative


def indexed(true: Array, cutoff: float) -> Index:
    """The index of true points (N, 2) [m], C-contiguous, for `assign`. Raises ValueError where one is not finite."""
    if not np.isfinite(true).all():
        raise ValueError("a position is not finite")
    order = np.argsort(true[:, 0], kind="stable")
    return true, order, true[:, 0][order], cutoff


@compiled
def assign(estimated: Array, index: Index, p: float) -> tuple[IntArray, float, int]:
    """The optimal assignment of points `estimated` (e, 2) [m], C-contiguous, to the true points of an index.

    Returns the true point (e,) of each estimated point, or UNPAIRED; the sum of d^p [m^p] over the pairs; and the
    number of pairs. Raises ValueError for points that are not finite.
    """
    true, _, _, cutoff = index
    pairs = _pairs_within(estimated, index)
    ceiling = cutoff**p
    for k in range(len(pairs.costs)):
        pairs.costs[k] = (pairs.costs[k] if p == 1.0 else pairs.costs[k] ** p) - ceiling
    true_of = _least_cost(pairs, len(true))
    total, paired = 0.0, 0
    for i in range(len(estimated)):
        if true_of[i] != UNPAIRED:
            j = true_of[i]
            distance = math.hypot(estimated[i, 0] - true[j, 0], estimated[i, 1] - true[j, 1])
            total += distance if p == 1.0 else distance**p
            paired += 1
    return true_of, total, paired


@compiled
def _pairs_within(estimated: Array, index: Index) -> _Pairs:
    """All pairs closer than the cutoff, with their distances [m] as costs."""
    true, order, x, cutoff = index
    first = np.searchsorted(x, estimated[:, 0] - cutoff)
    last = np.searchsorted(x, estimated[:, 0] + cutoff, side="right")
    starts, q = np.zeros(len(estimated) + 1, np.int64), 0
    room = (last - first).sum()
    columns, distances = np.empty(room, np.int64), np.empty(room)
    for i in range(len(estimated)):
        if not math.isfinite(estimated[i, 0] + estimated[i, 1]):
            raise ValueError("a position is not finite")
        for k in range(first[i], last[i]):
            j = order[k]
            dx, dy = estimated[i, 0] - true[j, 0], estimated[i, 1] - true[j, 1]
            if dx * dx + dy * dy < cutoff * cutoff:
                columns[q], distances[q] = j, math.sqrt(dx * dx + dy * dy)
                q += 1
        starts[i + 1] = q
    return _Pairs(starts, columns[:q], distances[:q])


@compiled
def _least_cost(pairs: _Pairs, n: int) -> IntArray:
    """The column of each row, or _NONE (cost 0), in the partial assignment to n columns of least total cost.

    The dual variables u ≤ 0 of the rows and v ≤ 0 of the columns prove optimality: u_i + v_j ≤ cost_ij, with equality
    for assigned pairs, and u = 0 for unassigned rows and v = 0 for unassigned columns.
    """
    m = len(pairs.starts) - 1
    column_of, row_of, u, v = np.full(m, _NONE), np.full(n, _NONE), np.zeros(m), np.zeros(n)
    for i in range(m):
        nearest = _NONE
        for k in range(pairs.starts[i], pairs.starts[i + 1]):
            if pairs.costs[k] < u[i]:
                u[i], nearest = pairs.costs[k], pairs.columns[k]
        if nearest != _NONE and row_of[nearest] == _NONE:
            column_of[i], row_of[nearest] = nearest, i
    for i in range(m):
        if column_of[i] == _NONE and u[i] < 0.0:
            _augment(i, pairs, column_of, row_of, u, v)
    return column_of


@compiled
def _augment(root: int, pairs: _Pairs, column_of: IntArray, row_of: IntArray, u: Array, v: Array) -> None:
    """Assign row `root` along the shortest augmenting path (Dijkstra on reduced costs cost_ij − u_i − v_j ≥ 0).

    The path ends at a free column, or at a row that becomes unassigned.
    """
    n = len(row_of)
    distance, came_from, done = np.full(n, np.inf), np.full(n, _NONE), np.zeros(n, np.bool_)  # by column
    end, row_end, length = _NONE, root, np.inf  # where the path ends: at column `end`, else at row `row_end`
    i, reached = root, 0.0
    while True:
        if reached - u[i] < length:
            row_end, length = i, reached - u[i]
        for k in range(pairs.starts[i], pairs.starts[i + 1]):
            j = pairs.columns[k]
            to_j = reached + pairs.costs[k] - u[i] - v[j]
            if not done[j] and to_j < distance[j]:
                distance[j], came_from[j] = to_j, i
        best = _NONE
        for j in range(n):
            if not done[j] and (best == _NONE or distance[j] < distance[best]):
                best = j
        if best == _NONE or distance[best] >= length:
            break
        if row_of[best] == _NONE:
            end, length = best, distance[best]
            break
        done[best], reached, i = True, distance[best], row_of[best]
    u[root] += length
    for j in range(n):
        if done[j]:
            u[row_of[j]] += length - distance[j]
            v[j] -= length - distance[j]
    if end == _NONE:
        end, column_of[row_end], u[row_end] = column_of[row_end], _NONE, 0.0
    while end != _NONE:  # assign each column on the path to the row before it
        row = came_from[end]
        row_of[end] = row
        column_of[row], end = end, column_of[row]
