"""Optimal assignment between two point sets with a cutoff: exact, and fast because distant pairs are never considered.

Minimises Σ_{(i,j) ∈ γ} d_ij^p + ½ c^p (e + N − 2|γ|) over partial assignments γ, which is the same as minimising
Σ_{(i,j) ∈ γ} (d_ij^p − c^p): only pairs closer than the cutoff c reduce it. They are collected along x. Then the rows
(estimated points) enter one after the other, each along the shortest augmenting path of this sparse graph. A row whose
nearest column (true point) is still free takes it without a search, in a good map almost all rows.
"""

import math

import numpy as np

from slam_gym._jit import compiled
from slam_gym.types import UNPAIRED, Array, IntArray

_NONE = -1  # the pair of an unassigned row, the row of an unassigned column
_ROUNDING = 1e-12  # of a sum of costs, which are between −1 and 0

Index = tuple[Array, IntArray, Array, float]
"""True points (N, 2) [m], their order (N,) along x, their x [m] in that order, and the cutoff [m] of an assignment."""


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
    starts, columns, powers = _pairs_within(estimated, index)
    if p != 1.0:
        powers = powers**p
    pair_of = _least_cost(starts, columns, powers / index[3] ** p - 1.0, len(index[0]))
    true_of, total, paired = np.full(len(estimated), UNPAIRED), 0.0, 0
    for i in range(len(estimated)):
        if pair_of[i] != _NONE:
            true_of[i] = columns[pair_of[i]]
            total += powers[pair_of[i]]
            paired += 1
    return true_of, total, paired


@compiled
def _pairs_within(estimated: Array, index: Index) -> tuple[IntArray, IntArray, Array]:
    """The columns (q,) and distances (q,) [m] of all pairs closer than the cutoff, row by row; those of row i are
    starts[i]:starts[i + 1] (e + 1,)."""
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
    return starts, columns[:q], distances[:q]


@compiled
def _least_cost(starts: IntArray, columns: IntArray, costs: Array, n: int) -> IntArray:
    """The pair of each row, or _NONE (cost 0), in the partial assignment to n columns of least total cost.

    The assignment of the rows so far is optimal, so no path that frees a column costs less than 0, and none from the
    next row costs less than its nearest column, if that is free.
    """
    pair_of, row_of = np.full(len(starts) - 1, _NONE), np.full(n, _NONE)
    for i in range(len(pair_of)):
        nearest = _NONE
        for k in range(starts[i], starts[i + 1]):
            if nearest == _NONE or costs[k] < costs[nearest]:
                nearest = k
        if nearest == _NONE:
            continue
        if row_of[columns[nearest]] == _NONE:
            pair_of[i], row_of[columns[nearest]] = nearest, i
        else:
            _augment(i, starts, columns, costs, pair_of, row_of)
    return pair_of


@compiled
def _augment(root: int, starts: IntArray, columns: IntArray, costs: Array, pair_of: IntArray, row_of: IntArray) -> None:
    """Assign row `root` along the shortest augmenting path, if one costs less than 0 (Bellman and Ford with a queue).

    The path ends at a free column, or at one whose row becomes unassigned. Only ways below the cost of the best path so
    far are followed, since the rest of a path never costs less than 0.
    """
    n = len(row_of)
    length, row_before, pair_before = np.full(n, np.inf), np.full(n, _NONE), np.full(n, _NONE)  # of the way to a column
    end, shortest, queue = _NONE, 0.0, [root]
    for i in queue:
        reached = 0.0 if i == root else length[columns[pair_of[i]]] - costs[pair_of[i]]
        for k in range(starts[i], starts[i + 1]):
            j, holder = columns[k], row_of[columns[k]]
            if reached + costs[k] < min(length[j] - _ROUNDING, shortest):
                length[j], row_before[j], pair_before[j] = reached + costs[k], i, k
                whole = length[j] - (costs[pair_of[holder]] if holder != _NONE else 0.0)
                if whole < shortest:
                    end, shortest = j, whole
                if holder != _NONE:
                    queue.append(holder)
    if end != _NONE and row_of[end] != _NONE:
        pair_of[row_of[end]] = _NONE
    while end != _NONE:  # assign each column on the path to the row before it
        row, left = row_before[end], pair_of[row_before[end]]
        row_of[end], pair_of[row] = row, pair_before[end]
        end = columns[left] if left != _NONE else _NONE
