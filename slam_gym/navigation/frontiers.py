"""Frontiers (Yamauchi 1997): the borders of known free space with unknown space, from which more can be seen."""

import math

import numpy as np
from numpy.typing import NDArray

from slam_gym._jit import compiled
from slam_gym.navigation.explored_grid import FREE, UNKNOWN, Cells, ExploredGrid
from slam_gym.types import Array, BoolArray, IntArray

Labels = NDArray[np.int32]  # (h, w) ON_FRONTIER, or the component of a frontier cell, or the last to visit a cell
ON_FRONTIER = -1
_RINGS = 2  # greatest distance in cells from a frontier to the cell that represents it


def frontiers(grid: ExploredGrid, reachable: BoolArray, min_length: float = 0.6, span: float = 3.0) -> Array:
    """(q, 2) [m] in B, the centre of each frontier at least `min_length` [m] long.

    A frontier is a set of 8-connected free cells with an unknown 4-neighbour; its length is its number of unknown
    neighbours times the side of a cell. A frontier that extends further than `span` [m] from its first cell is split
    there, because one centre could not represent it. The centre is that of the `reachable` (h, w) cell nearest to the
    frontier's centroid; frontiers without such a cell are left out.
    """
    side = grid.resolution
    cells_found = find_frontiers(grid.cells, reachable, min_length / side - 1e-9, span / side)
    return grid.origin + (cells_found[:, :2] + 0.5) * side


def find_frontiers(cells: Cells, reachable: BoolArray, min_border: float, span: float) -> IntArray:
    """(q, 3) column and row of the cell that represents each frontier, and number of unknown cells beside it."""
    unknown = np.pad(cells == UNKNOWN, 1)
    beside = unknown[:-2, 1:-1] | unknown[2:, 1:-1] | unknown[1:-1, :-2] | unknown[1:-1, 2:]
    labels = np.where((cells == FREE) & beside, np.int32(ON_FRONTIER), np.int32(0))
    return _components(cells, labels, reachable, min_border, span)


@compiled
def _components(cells: Cells, labels: Labels, reachable: BoolArray, min_border: float, span: float) -> IntArray:
    """`find_frontiers`, given `labels` of ON_FRONTIER for the cells of all frontiers, and 0 elsewhere."""
    h, w = cells.shape
    queue = np.empty((h * w, 2), dtype=np.int32)
    rows, count, component = np.empty((h * w, 3), dtype=np.int64), 0, 0
    for r in range(h):
        for c in range(w):
            if labels[r, c] == ON_FRONTIER:
                component += 1
                end, border = _grow(cells, labels, queue, (r, c), component, span)
                if border >= min_border:
                    row, column = _representative(cells, labels, reachable, queue, end, component)
                    if row >= 0:
                        rows[count, 0], rows[count, 1], rows[count, 2] = column, row, border
                        count += 1
    return rows[:count]


@compiled
def _grow(
    cells: Cells, labels: Labels, queue: Labels, first: tuple[int, int], component: int, span: float
) -> tuple[int, int]:
    """Collect in `queue` the 8-connected frontier cells within `span` of the first.

    Returns their number, and the number of unknown cells beside them.
    """
    (h, w), (row, column) = labels.shape, first
    queue[0, 0], queue[0, 1] = row, column
    labels[row, column] = component
    head, end, border = 0, 1, 0
    while head < end:
        r0, c0 = queue[head, 0], queue[head, 1]
        head += 1
        for r in range(max(0, r0 - 1), min(h, r0 + 2)):
            for c in range(max(0, c0 - 1), min(w, c0 + 2)):
                if labels[r, c] == ON_FRONTIER and math.hypot(r - row, c - column) <= span:
                    labels[r, c] = component
                    queue[end, 0], queue[end, 1] = r, c
                    end += 1
                elif cells[r, c] == UNKNOWN and (r == r0 or c == c0) and labels[r, c] != component:
                    labels[r, c] = component
                    border += 1
    return end, border


@compiled
def _representative(
    cells: Cells, labels: Labels, reachable: BoolArray, queue: Labels, end: int, component: int
) -> tuple[int, int]:
    """The reachable cell of queue[:end] nearest to their centroid, (−1, −1) if there is none.

    Where none of them is reachable, because walls are too near, free cells around them are searched.
    """
    (h, w), seen, row, column = labels.shape, -1 - component, 0.0, 0.0
    for i in range(end):
        row, column = row + queue[i, 0] / end, column + queue[i, 1] / end
    best, best_row, best_column = math.inf, -1, -1
    bounds = np.zeros(_RINGS + 3, dtype=np.int64)  # ring k is queue[bounds[k]:bounds[k + 1]]
    bounds[1] = end
    for ring in range(1 + _RINGS):
        for i in range(bounds[ring], bounds[ring + 1]):
            r, c = queue[i, 0], queue[i, 1]
            distance = math.hypot(r - row, c - column)
            if reachable[r, c] and distance < best:
                best, best_row, best_column = distance, r, c
        if best_row >= 0:
            break
        for i in range(bounds[ring], bounds[ring + 1]):  # add the free cells beside them that lie on no frontier
            for dr, dc in ((-1, 0), (1, 0), (0, -1), (0, 1)):
                r, c = queue[i, 0] + dr, queue[i, 1] + dc
                if not (0 <= r < h and 0 <= c < w) or cells[r, c] != FREE:
                    continue
                if labels[r, c] <= 0 and labels[r, c] != ON_FRONTIER and labels[r, c] != seen:
                    labels[r, c] = seen
                    queue[end, 0], queue[end, 1] = r, c
                    end += 1
        bounds[ring + 2] = end
    return best_row, best_column
