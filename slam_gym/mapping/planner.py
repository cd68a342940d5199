"""Paths over the explored grid: a compiled wavefront that prefers the middle of passages."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam_gym._compile import compiled
from slam_gym.mapping.coverage import CoverageGrid
from slam_gym.mapping.grid import FREE, WALL, Cells, border_crossings
from slam_gym.mapping.pursuit import PursuitSpec, follow
from slam_gym.types import Array, BoolArray, IntArray

__all__ = ["CROWDING", "MARGIN", "STEPS", "Field", "PursuitSpec", "distance_field", "follow"]

MARGIN = 0.4  # [m] beyond the clearance, up to which paths pay for being near a wall
CROWDING = 8.0  # what a metre right at a wall costs more than one in the open
STEPS = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, -1), (-1, 1))  # rows, columns; straight ones first

Steps = NDArray[np.int8]  # (h, w) index into STEPS of the step by which a path enters each cell
_LENGTHS = tuple(math.hypot(dr, dc) for dr, dc in STEPS)
_BUCKETS = 1 << math.ceil(math.log2(math.sqrt(2.0) * (1.0 + CROWDING) + 2.0))  # hold the dearest step, and wrap around


@dataclass(frozen=True, slots=True)
class Field:
    """The least-cost paths from one start to every cell (see `distance_field`). Cells as in `CoverageGrid`."""

    start: Array  # (2,) [m] in B
    lengths: Array  # (h, w) [m] length of the path from the start; inf where none leads
    costs: Array  # (h, w) [cells] cost of that path; a cell's side costs 1 in the open
    weights: Array  # (h, w) cost per length in each cell, ≥ 1; inf in walls and in the unknown
    steps: Steps  # (h, w) index into STEPS of the path's last step; −1 at the start and where no path leads
    origin: Array  # (2,) [m] in B
    resolution: float  # [m]

    def cell(self, point: Array) -> tuple[int, int] | None:
        """Row and column of the cell that holds `point` (2,) in B; None off the grid."""
        return _cell_of(point, self.origin, self.resolution, self.lengths.shape)

    def length_to(self, point: Array) -> float:
        """Length [m] of the path to the cell that holds `point` (2,) in B; inf if none leads there."""
        cell = self.cell(point)
        return math.inf if cell is None else float(self.lengths[cell])

    def nearest(self, point: Array) -> Array:
        """Centre (2,) in B of the reachable cell nearest to `point` (2,); the start where no cell is reachable."""
        rows, columns = np.nonzero(np.isfinite(self.lengths))
        if len(rows) == 0:
            return self.start.copy()
        centres = self.origin + (np.stack([columns, rows], axis=1) + 0.5) * self.resolution
        centre: Array = centres[np.argmin(((centres - point) ** 2).sum(axis=1))]
        return centre

    def path(self, goal: Array) -> Array:
        """Waypoints (p, 2) in B from the start to `goal` (2,), shortened; (0, 2) if no path leads to the goal's cell.

        A straight line replaces a stretch of the cell-by-cell path where it costs no more, so that corners are cut in
        the open but the middle of a passage is kept.
        """
        cell = self.cell(goal)
        if cell is None or not np.isfinite(self.costs[cell]):
            return np.empty((0, 2))
        cells = _shortened(self.costs, self.weights, _trace(self.steps, *cell))
        inner = self.origin + (cells[1:-1, ::-1] + 0.5) * self.resolution
        return np.concatenate([self.start[None], inner, np.asarray(goal, dtype=np.float64)[None]])


def distance_field(grid: CoverageGrid, start: Array, clearance: float) -> Field:
    """Least-cost paths from `start` (2,) in B over the free cells of `grid`, 8-connected.

    Walls and the unknown are closed, and so are cells nearer than `clearance` [m] to a wall cell, centre to centre. At
    a distance d < clearance + MARGIN, a length costs 1 + CROWDING (1 − d / (clearance + MARGIN))² times what it costs
    in the open. A start within the clearance can leave it, but no path enters it again; a start off the grid
    reaches nothing. Raises ValueError for a clearance that is negative or not finite.
    """
    if not 0.0 <= clearance < math.inf:
        raise ValueError(f"clearance: expected a finite length ≥ 0 [m], got {clearance}")
    start = np.array(start, dtype=np.float64)
    weights, closed = _crowding(grid.cells, clearance / grid.resolution, (clearance + MARGIN) / grid.resolution)
    cell = _cell_of(start, grid.origin, grid.resolution, grid.cells.shape)
    row, column = cell or (-1, -1)  # off the grid: a corner of the border, from which no step leads
    lengths, costs, steps = _wavefront(weights, closed, row + 1, column + 1, grid.resolution)
    inner = np.s_[1:-1, 1:-1]
    return Field(start, lengths[inner], costs[inner], weights[inner], steps[inner], grid.origin, grid.resolution)


def _cell_of(point: Array, origin: Array, resolution: float, shape: tuple[int, ...]) -> tuple[int, int] | None:
    column, row = (float(point[0]) - origin[0]) / resolution, (float(point[1]) - origin[1]) / resolution
    return (int(row), int(column)) if 0.0 <= row < shape[0] and 0.0 <= column < shape[1] else None


@compiled
def _squares_to_walls(cells: Cells, radius: int) -> IntArray:
    """Squared distance [cells²] (h, w) to the nearest wall cell, exact up to `radius`, larger beyond it.

    First along the rows, then the least sum of squares over the column.
    """
    h, w = cells.shape
    gaps = np.full((h, w), radius + 1)
    for r in range(h):
        for c in range(w):
            gaps[r, c] = 0 if cells[r, c] == WALL else (min(radius, gaps[r, c - 1]) + 1 if c > 0 else radius + 1)
        for c in range(w - 2, -1, -1):
            gaps[r, c] = min(gaps[r, c], gaps[r, c + 1] + 1)
    squares = np.full((h, w), (radius + 1) ** 2)
    for r in range(h):
        for other in range(max(0, r - radius), min(h, r + radius + 1)):
            for c in range(w):
                squares[r, c] = min(squares[r, c], gaps[other, c] ** 2 + (other - r) ** 2)
    return squares


@compiled
def _crowding(cells: Cells, clearance: float, reach: float) -> tuple[Array, BoolArray]:
    """Cost of a metre in each cell and whether it is closed, within a border of impassable cells (h + 2, w + 2).

    Lengths in cells.
    """
    h, w = cells.shape
    squares = _squares_to_walls(cells, math.ceil(reach))
    table = 1.0 + CROWDING * (1.0 - np.minimum(1.0, np.sqrt(np.arange((math.ceil(reach) + 1) ** 2 + 1)) / reach)) ** 2
    weights, closed = np.full((h + 2, w + 2), math.inf), np.zeros((h + 2, w + 2), dtype=np.bool_)
    for r in range(h):
        for c in range(w):
            if cells[r, c] == FREE:
                weights[r + 1, c + 1] = table[squares[r, c]]
                closed[r + 1, c + 1] = squares[r, c] < clearance * clearance - 1e-9
    return weights, closed


@compiled
def _wavefront(
    weights: Array, closed: BoolArray, row: int, column: int, resolution: float
) -> tuple[Array, Array, Steps]:
    """Lengths [m], costs [cells] and last steps of the least-cost paths from a cell; arrays with a border.

    Dijkstra with buckets as wide as the cheapest step, 1: no step ends in the bucket that it started from, so the order
    within a bucket does not matter (Denardo and Fox 1979). A cell may wait in several buckets; the first one counts. A
    step costs its length times the mean weight of its ends; a diagonal one needs both cells that it passes between.
    """
    shape, stride = weights.shape, weights.shape[1]
    weights, closed = weights.ravel(), closed.ravel()
    lengths, costs = np.full(weights.size, math.inf), np.full(weights.size, math.inf)
    steps, settled = np.full(weights.size, -1, dtype=np.int8), np.zeros(weights.size, dtype=np.bool_)
    offsets = np.array([dr * stride + dc for dr, dc in STEPS])
    waiting = np.empty((8 * weights.size + 1, 2), dtype=np.int32)  # cell and the entry below it in its bucket
    tops = np.full(_BUCKETS, -1)
    start = row * stride + column
    lengths[start] = costs[start] = 0.0
    tops[0], waiting[0, 0], waiting[0, 1], entries = 0, start, -1, 1
    front, idle = 0, 0  # the bucket being emptied, and how many before it were empty
    while idle < _BUCKETS:
        entry = tops[front & (_BUCKETS - 1)]
        if entry < 0:
            front, idle = front + 1, idle + 1
            continue
        node, idle = waiting[entry, 0], 0
        tops[front & (_BUCKETS - 1)] = waiting[entry, 1]
        if settled[node]:
            continue
        settled[node] = True
        weight = min(weights[node], 1.0 + CROWDING)  # of a start in a wall or in the unknown
        for k in range(8):
            length, other = _LENGTHS[k], node + offsets[k]
            cost = costs[node] + 0.5 * length * (weight + weights[other])
            if cost >= costs[other] or (closed[other] and not closed[node] and node != start):
                continue
            if k >= 4 and max(weights[node + offsets[k - 4]], weights[node + offsets[(k - 3) % 4]]) == math.inf:
                continue
            costs[other], lengths[other], steps[other] = cost, lengths[node] + length * resolution, k
            bucket = int(cost) & (_BUCKETS - 1)
            waiting[entries, 0], waiting[entries, 1], tops[bucket] = other, tops[bucket], entries
            entries += 1
    return lengths.reshape(shape), costs.reshape(shape), steps.reshape(shape)


@compiled
def _trace(steps: Steps, row: int, column: int) -> IntArray:
    """Cells (p, 2) [row, column] from the start of the wavefront to the cell given."""
    count, r, c = 1, row, column
    while steps[r, c] >= 0:
        dr, dc = STEPS[steps[r, c]]
        count, r, c = count + 1, r - dr, c - dc
    cells = np.empty((count, 2), dtype=np.int64)
    for i in range(count - 1, -1, -1):
        cells[i, 0], cells[i, 1] = row, column
        if i > 0:
            dr, dc = STEPS[steps[row, column]]
            row, column = row - dr, column - dc
    return cells


@compiled
def _line_cost(costs: Array, weights: Array, a: IntArray, b: IntArray) -> float:
    """Cost [cells] of the straight line between the centres of two cells; inf if it leaves the cells reached."""
    dx, dy = float(b[1] - a[1]), float(b[0] - a[0])
    length = math.hypot(dx, dy)
    step_x, next_x, stride_x = border_crossings(a[1] + 0.5, dx / length)
    step_y, next_y, stride_y = border_crossings(a[0] + 0.5, dy / length)
    row, column, entered, cost = a[0], a[1], 0.0, 0.0
    while entered < length - 1e-9:
        if max(costs[row, column], weights[row, column]) == math.inf:
            return math.inf
        left = min(next_x, next_y, length)
        cost += (left - entered) * weights[row, column]
        entered = left
        if next_x < next_y:
            column, next_x = column + step_x, next_x + stride_x
        else:
            row, next_y = row + step_y, next_y + stride_y
    return cost


@compiled
def _shortened(costs: Array, weights: Array, cells: IntArray) -> IntArray:
    """Of the cells (p, 2) of a path those that remain when straight lines replace whatever they do not make dearer."""
    kept = np.empty_like(cells)
    kept[0], count, anchor = cells[0], 1, 0
    for i in range(1, len(cells)):
        walked = costs[cells[i, 0], cells[i, 1]] - costs[cells[anchor, 0], cells[anchor, 1]]
        if i > anchor + 1 and _line_cost(costs, weights, cells[anchor], cells[i]) > walked + 1e-9:
            anchor = i - 1
            kept[count] = cells[anchor]
            count += 1
    if len(cells) > 1:
        kept[count] = cells[-1]
        count += 1
    return kept[:count]
