"""Whether a path that is followed needs no other one, as far as a walk along it can tell."""

from __future__ import annotations

import math

from slam_gym._compile import compiled
from slam_gym.navigation.grid import FREE, WALL, Cells
from slam_gym.navigation.polyline import length_left, next_stretch, on_path, points_ahead
from slam_gym.types import Array

_SURE = 1.0 + 1e-9  # of a length: more than rounding
_NEAR = 3.0  # [m] from its path the robot is, or nothing is sure

Explored = tuple[Cells, Array, float]  # cells, origin (2,) [m] in B, resolution [m]


@compiled
def surely_holds(
    explored: Explored, path: Array, here: Array, clearance: float, spacing: float, ahead: float, longer: float
) -> bool:
    """A robot `here` (2,) in B can go on along its path (p, 2), p ≥ 2, and no way is much shorter. False: who knows.

    All points of the path that lie ahead, some `spacing` [m] apart, are in free cells. The robot can go to the first
    of them and from one to the next, as far as the next `ahead` metres reach, always into the cell beside and
    no nearer to a wall cell than `clearance` [m], centre to centre. And that stretch is less than `longer` times as
    long as the straight line to its end, hence than any other way: it takes a walk to see what else takes a wavefront.
    """
    points = points_ahead(path, here, spacing)
    for q in range(len(points)):
        row, column = _cell(explored, points[q])
        if not _is(FREE, explored[0], row, column):
            return False
    stretch, _ = next_stretch(path, here, ahead)
    end = stretch[len(stretch) - 1]
    straight = math.hypot(end[0] - here[0], end[1] - here[1])
    if on_path(stretch, here).gap > _NEAR or not length_left(stretch, here) * _SURE < longer * straight:
        return False
    return _can_go(explored, here, points_ahead(stretch, here, spacing), end, clearance)


@compiled
def _can_go(explored: Explored, here: Array, points: Array, end: Array, clearance: float) -> bool:
    """From `here` to each of `points` (q, 2) in turn and to the end, from cell to cell beside it, all of them open."""
    first_row, first_column = _cell(explored, here)
    row, column = first_row, first_column
    for q in range(len(points) + 1):
        to_row, to_column = _cell(explored, points[q] if q < len(points) else end)
        rows, columns = abs(to_row - row), abs(to_column - column)
        down, across = 0, 0  # cells done of those
        while down < rows or across < columns:
            if columns * (2 * down + 1) > rows * (2 * across + 1):
                across, column = across + 1, column + (1 if to_column > column else -1)
            else:
                down, row = down + 1, row + (1 if to_row > row else -1)
            if not _is_open(explored, row, column, clearance) and (row != first_row or column != first_column):
                return False
    return True


@compiled
def _is_open(explored: Explored, row: int, column: int, clearance: float) -> bool:
    """A free cell with no wall cell within the clearance, as paths keep it."""
    cells, _, resolution = explored
    limit = (clearance / resolution) ** 2 - 1e-9
    reach = math.ceil(clearance / resolution)
    if not _is(FREE, cells, row, column):
        return False
    for dr in range(-reach, reach + 1):
        for dc in range(-reach, reach + 1):
            if dr * dr + dc * dc < limit and _is(WALL, cells, row + dr, column + dc):
                return False
    return True


@compiled
def _is(kind: int, cells: Cells, row: int, column: int) -> bool:
    return 0 <= row < cells.shape[0] and 0 <= column < cells.shape[1] and bool(cells[row, column] == kind)


@compiled
def _cell(explored: Explored, point: Array) -> tuple[int, int]:
    """Row and column of a point (2,) in B, on the grid or off it."""
    _, origin, resolution = explored
    return math.floor((point[1] - origin[1]) / resolution), math.floor((point[0] - origin[0]) / resolution)
