"""Walls in a uniform grid of cells, each of which knows the walls that touch it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.types import Array, IntArray

PADDING = 1e-6  # [cells] walls are entered in every cell this close to them, against rounding at the borders
_MAX_CELLS = 1 << 20  # larger buildings get larger cells


class Grid(NamedTuple):
    """Walls, and for each cell of a uniform grid the walls that touch it, in compressed rows."""

    walls: Array  # (s, 4) [m] x1 y1 x2 y2
    starts: IntArray  # (rows·columns + 1,) cell c = row·columns + column holds members[starts[c]:starts[c + 1]]
    members: IntArray  # rows of `walls`
    xmin: float  # [m]
    ymin: float  # [m]
    cell: float  # [m] side of a cell
    columns: int
    rows: int


Packed = tuple[Array, IntArray, IntArray, float, float, float, int, int]
"""A `Grid` as a plain tuple: numba recognises one in .5 µs at a call from Python, a named one in 3 µs."""

_EMPTY = np.empty(0, np.int64)


def wall_grid(walls: Array, cell: float = 1.0) -> Packed:
    """The grid of walls (s, 4) [m]; `cell` [m] is the side of its cells, doubled until a million of them suffice.

    Raises ValueError where walls are not finite or of another shape, or `cell` is not positive.
    """
    walls = np.array(walls, dtype=np.float64, order="C")
    if walls.ndim != 2 or walls.shape[1] != 4:
        raise ValueError(f"walls must have shape (s, 4), not {walls.shape}")
    if not np.isfinite(walls).all():
        raise ValueError(f"walls[{int(np.argmin(np.isfinite(walls).all(axis=1)))}] is not finite")
    if not (math.isfinite(cell) and cell > 0.0):
        raise ValueError(f"cell must be a positive length [m], not {cell}")
    ends = walls.reshape(-1, 2) if len(walls) else np.zeros((1, 2))
    low, extent = ends.min(axis=0), np.ptp(ends, axis=0)
    while np.prod(extent // cell + 1.0) > _MAX_CELLS:
        cell *= 2.0
    columns, rows = (extent // cell).astype(int) + 1
    placed = (float(low[0]), float(low[1]), float(cell), int(columns), int(rows))
    starts, members = _enter_walls((walls, _EMPTY, _EMPTY, *placed))
    return (walls, starts, members, *placed)


@compiled
def _enter_walls(packed: Packed) -> tuple[IntArray, IntArray]:
    """Which walls touch which cell: `starts` and `members` of the grid, by counting, then filling."""
    grid = Grid(*packed)
    pad, cells = PADDING * grid.cell, grid.rows * grid.columns
    starts, filled = np.zeros(cells + 1, np.int64), np.zeros(cells, np.int64)
    members = np.empty(0, np.int64)
    for filling in range(2):
        for w in range(grid.walls.shape[0]):
            low, high = min(grid.walls[w, 0], grid.walls[w, 2]), max(grid.walls[w, 0], grid.walls[w, 2])
            first = max(math.floor((low - pad - grid.xmin) / grid.cell), 0)
            last = min(math.floor((high + pad - grid.xmin) / grid.cell), grid.columns - 1)
            for column in range(first, last + 1):
                bottom, top = _rows_of(grid, w, column)
                for row in range(bottom, top + 1):
                    c = row * grid.columns + column
                    if filling == 1:
                        members[starts[c] + filled[c]] = w
                        filled[c] += 1
                    else:
                        starts[c + 1] += 1
        if filling == 0:
            for c in range(cells):
                starts[c + 1] += starts[c]
            members = np.empty(starts[cells], np.int64)
    return starts, members


@compiled
def _rows_of(grid: Grid, wall: int, column: int) -> tuple[int, int]:
    """First and last row of the cells of `column` that a wall touches."""
    x, y = grid.walls[wall, 0], grid.walls[wall, 1]
    dx, dy = grid.walls[wall, 2] - x, grid.walls[wall, 3] - y
    pad = PADDING * grid.cell
    enter, leave = 0.0, 1.0
    if abs(dx) > pad:
        left = (grid.xmin + column * grid.cell - pad - x) / dx
        right = (grid.xmin + (column + 1) * grid.cell + pad - x) / dx
        enter, leave = max(0.0, min(left, right)), min(1.0, max(left, right))
    y1, y2 = y + enter * dy, y + leave * dy
    first = math.floor((min(y1, y2) - pad - grid.ymin) / grid.cell)
    last = math.floor((max(y1, y2) + pad - grid.ymin) / grid.cell)
    return max(first, 0), min(last, grid.rows - 1)
