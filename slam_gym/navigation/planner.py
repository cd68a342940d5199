"""Paths over the explored grid: a compiled wavefront that prefers the middle of passages."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_gym._jit import compiled
from slam_gym.geometry import cells_along
from slam_gym.navigation.explored_grid import FREE, WALL, Cells, ExploredGrid
from slam_gym.types import Array, BoolArray, IntArray

MARGIN = 0.4  # [m] beyond the clearance, within which a path costs more near a wall
CROWDING = 8.0  # additional cost of a metre right at a wall, relative to a metre in the open
STEPS = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, -1), (-1, 1))  # rows, columns; straight steps first

Levels = NDArray[np.int32]  # (h, w) 0 = impassable, else 1 + squared distance to the nearest wall [cells²]
Steps = NDArray[np.int8]  # (h, w) index into STEPS of the step by which a path enters each cell
_ROWS, _COLUMNS = zip(*STEPS)
_LENGTHS = tuple(math.hypot(dr, dc) for dr, dc in STEPS)


@dataclass(frozen=True, slots=True)
class DistanceField:
    """The least-cost paths from one start to every cell (see `distance_field`). Cells as in `ExploredGrid`."""

    start: Array  # (2,) [m] in B
    lengths: Array  # (h, w) [m] length of the path from the start; inf where there is none
    costs: Array  # (h, w) [cells] cost of that path; the side of a cell costs 1 in the open
    levels: Levels  # (h, w) index into `weights` of each cell
    weights: Array  # cost per length at each level, ≥ 1; inf at level 0: walls and unknown cells
    steps: Steps  # (h, w) index into STEPS of the path's last step; −1 at the start and where there is no path
    origin: Array  # (2,) [m] in B
    resolution: float  # [m]

    @property
    def reachable(self) -> BoolArray:
        """(h, w) whether a path leads to each cell."""
        return np.isfinite(self.lengths)

    def cell(self, point: Array) -> tuple[int, int] | None:
        """Row and column of the cell that contains `point` (2,) in B; None outside the grid."""
        return _cell_of(point, self.origin, self.resolution, self.lengths.shape)

    def lengths_to(self, points: Array) -> Array:
        """(q,) [m] lengths of the paths to the cells that contain `points` (q, 2) in B; inf where there is no path."""
        columns, rows = (points - self.origin).T / self.resolution
        h, w = self.lengths.shape
        inside = (rows >= 0.0) & (rows < h) & (columns >= 0.0) & (columns < w)
        out = np.full(len(points), math.inf)
        out[inside] = self.lengths[rows[inside].astype(np.int64), columns[inside].astype(np.int64)]
        return out

    def nearest(self, point: Array) -> Array:
        """Centre (2,) in B of the reachable cell nearest to `point` (2,); the start where no cell is reachable."""
        rows, columns = np.nonzero(self.reachable)
        if len(rows) == 0:
            return self.start.copy()
        centres = self.origin + (np.stack([columns, rows], axis=1) + 0.5) * self.resolution
        return np.asarray(centres[np.argmin(((centres - point) ** 2).sum(axis=1))])

    def along_each(self, goals: Array, spacing: float) -> tuple[Array, IntArray]:
        """Points (p, 2) in B on the paths to `goals` (q, 2), path after path, and their number on each path (q,).

        Neighbours on a path are about `spacing` [m] apart; the last one is in the goal's cell.
        """
        stride, paths = max(1, round(spacing / self.resolution)), []
        for goal in goals:
            cell = self.cell(goal)
            if cell is None or not math.isfinite(self.costs[cell]):
                paths.append(np.empty((0, 2), np.int64))
            else:
                paths.append(_trace(self.steps, *cell)[::-stride][::-1])
        cells = np.concatenate([np.empty((0, 2), np.int64), *paths])
        counts = np.array([len(path) for path in paths], np.int64)
        return self.origin + (cells[:, ::-1] + 0.5) * self.resolution, counts

    def path(self, goal: Array) -> Array:
        """Waypoints (p, 2) in B from the start to `goal` (2,), shortened; (0, 2) if no path leads to the goal's cell.

        A straight line replaces a part of the cell-by-cell path where it costs no more, so that the path cuts corners
        in the open but stays in the middle of passages.
        """
        cell = self.cell(goal)
        if cell is None or not np.isfinite(self.costs[cell]):
            return np.empty((0, 2))
        cells = _trace(self.steps, *cell)
        cells = cells[_shortened(self.costs, self.levels, self.weights, cells)]
        inner = self.origin + (cells[1:-1, ::-1] + 0.5) * self.resolution
        return np.concatenate([self.start[None], inner, np.asarray(goal, dtype=np.float64)[None]])


def distance_field(grid: ExploredGrid, start: Array, clearance: float, within: Array | None = None) -> DistanceField:
    """Compute the least-cost paths from `start` (2,) in B over the free cells of `grid`, 8-connected.

    With `within` (4,) [m] xmin, ymin, xmax, ymax in B, the field contains only the cells in this rectangle, and takes
    no longer in a large building.

    No path leads through walls, unknown cells, or cells nearer than `clearance` [m] to a wall cell, centre to centre.
    At a distance d < clearance + MARGIN, a length costs 1 + CROWDING (1 − d / (clearance + MARGIN))² times its cost in
    the open. A path may start within the clearance and leave it, but cannot enter it again; a start outside the grid
    reaches nothing. Raises ValueError for a clearance that is negative or not finite.
    """
    if not 0.0 <= clearance < math.inf:
        raise ValueError(f"clearance: expected a finite length ≥ 0 [m], got {clearance}")
    start = np.array(start, dtype=np.float64)
    cells, origin = (grid.cells, grid.origin) if within is None else _window(grid, within)
    levels, weights = _levels(cells, (clearance + MARGIN) / grid.resolution)
    first_open = 1 + math.ceil((clearance / grid.resolution) ** 2 - 1e-9)
    cell = _cell_of(start, origin, grid.resolution, cells.shape)
    row, column = cell or (-1, -1)  # outside the grid: a corner of the border, from which no step leads
    shape, stride = levels.shape, levels.shape[1]
    offsets = np.array([dr * stride + dc for dr, dc in STEPS])
    seed = (row + 1) * stride + column + 1
    dearest = math.sqrt(2.0) * (1.0 + CROWDING)
    buckets = 1 << math.ceil(math.log2(dearest + 2.0))  # more than a step costs: used cyclically
    flat: Any = _wavefront(levels.ravel(), weights, first_open, offsets, seed, grid.resolution, buckets)
    lengths, costs, steps = (values.reshape(shape)[1:-1, 1:-1] for values in flat)
    return DistanceField(start, lengths, costs, levels[1:-1, 1:-1], weights, steps, origin, grid.resolution)


def _window(grid: ExploredGrid, within: Array) -> tuple[Cells, Array]:
    """The cells of the grid in the rectangle `within` (4,) [m] in B, at least one, and their origin (2,) [m] in B."""
    bounds = np.floor((np.asarray(within, dtype=np.float64).reshape(2, 2) - grid.origin) / grid.resolution)
    (left, low), (right, high) = np.clip(bounds, 0.0, np.array(grid.cells.shape[::-1]) - 1.0).astype(np.int64)
    cells = np.ascontiguousarray(grid.cells[low : high + 1, left : right + 1])
    cells.flags.writeable = False  # as `ExploredGrid.cells`; a writable array would be compiled for separately
    return cells, grid.origin + np.array([left, low]) * grid.resolution


def _cell_of(point: Array, origin: Array, resolution: float, shape: tuple[int, ...]) -> tuple[int, int] | None:
    column, row = (float(point[0]) - origin[0]) / resolution, (float(point[1]) - origin[1]) / resolution
    return (int(row), int(column)) if 0.0 <= row < shape[0] and 0.0 <= column < shape[1] else None


@compiled
def _levels(cells: Cells, reach: float) -> tuple[Levels, Array]:
    """Levels of the cells, with a border of impassable cells (h + 2, w + 2), and weights of the levels.

    Walls raise the cost up to `reach` [cells] away. Squared distances to them are exact up to there, and larger beyond:
    first the distances along each row, then the least sum of squares over each column.
    """
    h, w = cells.shape
    radius = math.ceil(reach)
    row_squares = np.empty((h, w), dtype=np.int32)
    for r in range(h):
        gap = radius + 1
        for c in range(w):
            gap = 0 if cells[r, c] == WALL else min(radius, gap) + 1
            row_squares[r, c] = gap
        for c in range(w - 1, -1, -1):
            gap = min(row_squares[r, c], gap + 1)
            row_squares[r, c] = gap * gap
    levels = np.zeros((h + 2, w + 2), dtype=np.int32)
    squares = np.empty(w, dtype=np.int32)  # [cells²] from the cells of a row to the nearest wall
    for r in range(h):
        squares[:] = (radius + 1) ** 2
        for other in range(max(0, r - radius), min(h, r + radius + 1)):
            column_square = np.int32((other - r) ** 2)
            for c in range(w):
                squares[c] = min(squares[c], row_squares[other, c] + column_square)
        for c in range(w):
            if cells[r, c] == FREE:
                levels[r + 1, c + 1] = 1 + squares[c]
    weights = np.full((radius + 1) ** 2 + 2, math.inf)
    for level in range(1, weights.shape[0]):
        weights[level] = 1.0 + CROWDING * (1.0 - min(1.0, math.sqrt(level - 1) / reach)) ** 2
    return levels, weights


@compiled
def _wavefront(
    levels: Levels, weights: Array, first_open: int, offsets: IntArray, start: int, resolution: float, buckets: int
) -> tuple[Array, Array, Steps]:
    """Lengths [m], costs [cells] and last steps of the least-cost paths from a cell, in flat arrays with a border.

    Dijkstra's algorithm with buckets as wide as the cheapest step, 1: no step ends in the bucket where it started, so
    the order within a bucket does not matter (Denardo and Fox 1979). A cell may wait in several buckets; the first one
    counts. A step costs its length times the mean weight of its ends; a diagonal step requires that both cells between
    which it passes are passable. Levels below `first_open` are closed to paths from higher levels.
    """
    size = levels.shape[0]
    lengths, costs = np.full(size, math.inf), np.full(size, math.inf)
    steps, settled = np.full(size, -1, dtype=np.int8), np.zeros(size, dtype=np.bool_)
    waiting = np.empty((8 * size + 1, 2), dtype=np.int32)  # cell, and the next entry of its bucket
    tops = np.full(buckets, -1)
    costs[start] = 0.0
    tops[0], waiting[0, 0], waiting[0, 1], entries = 0, start, -1, 1
    front, idle = 0, 0  # the current bucket, and the number of empty buckets before it
    while idle < buckets:
        entry = tops[front & (buckets - 1)]
        if entry < 0:
            front, idle = front + 1, idle + 1
            continue
        node, idle = waiting[entry, 0], 0
        tops[front & (buckets - 1)] = waiting[entry, 1]
        if settled[node]:
            continue
        settled[node] = True
        last = steps[node]
        lengths[node] = 0.0 if last < 0 else lengths[node - offsets[last]] + _LENGTHS[last] * resolution
        weight = weights[levels[node]] if levels[node] > 0 else 1.0 + CROWDING  # a start in a wall or unknown cell
        lowest = 1 if last < 0 or levels[node] < first_open else first_open
        for k in range(8):
            other = node + offsets[k]
            cost = costs[node] + 0.5 * _LENGTHS[k] * (weight + weights[levels[other]])
            if cost >= costs[other] or levels[other] < lowest:
                continue
            if k >= 4 and (levels[node + offsets[k - 4]] == 0 or levels[node + offsets[(k - 3) % 4]] == 0):
                continue
            costs[other], steps[other] = cost, k
            bucket = int(cost) & (buckets - 1)
            waiting[entries, 0], waiting[entries, 1], tops[bucket] = other, tops[bucket], entries
            entries += 1
    return lengths, costs, steps


@compiled
def _trace(steps: Steps, row: int, column: int) -> IntArray:
    """Cells (p, 2) [row, column] of the path from the start of the wavefront to a cell."""
    cells, first = np.empty((steps.size, 2), dtype=np.int64), steps.size - 1
    cells[first, 0], cells[first, 1] = row, column
    while steps[row, column] >= 0:
        k, first = steps[row, column], first - 1
        row, column = row - _ROWS[k], column - _COLUMNS[k]
        cells[first, 0], cells[first, 1] = row, column
    return cells[first:].copy()


@compiled
def _line_cost(costs: Array, levels: Levels, weights: Array, r0: int, c0: int, r1: int, c1: int) -> float:
    """Cost [cells] of the straight line between the centres of two cells; inf if it leaves the reachable cells."""
    dx, dy = float(c1 - c0), float(r1 - r0)
    length = math.hypot(dx, dy)
    cost = 0.0
    for row, column, r_in, r_out in cells_along(c0 + 0.5, r0 + 0.5, dx / length, dy / length, length):
        if costs[row, column] == math.inf:
            return math.inf
        cost += (r_out - r_in) * weights[levels[row, column]]
    return cost


@compiled
def _shortened(costs: Array, levels: Levels, weights: Array, cells: IntArray) -> BoolArray:
    """(p,) which cells of a path (p, 2) remain once straight lines replace all parts that they do not make dearer."""
    kept = np.zeros(cells.shape[0], dtype=np.bool_)
    kept[0] = kept[-1] = True
    anchor = 0
    for i in range(2, cells.shape[0]):
        r0, c0, r1, c1 = cells[anchor, 0], cells[anchor, 1], cells[i, 0], cells[i, 1]
        if _line_cost(costs, levels, weights, r0, c0, r1, c1) > costs[r1, c1] - costs[r0, c0] + 1e-9:
            anchor = i - 1
            kept[anchor] = True
    return kept
