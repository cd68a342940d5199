"""Where a robot of a given radius can go in a floor plan, and which features it can see from there."""

import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from slam_gym.types import Array, BoolArray, IntArray
from slam_gym.world.floor_plan import FloorPlan
from slam_gym.world.ray_casting import NOTHING, Packed, box_distance, pull_back, seen_from

_START_CLEARANCE, _START_GAP = 0.3, 0.05  # [m] least distance of furniture from a robot's first position; from its rim


@dataclass(frozen=True)
class FreeCells:
    """The cells of a plan in which the centre of a disc of a given radius may lie, reachable or not."""

    free: BoolArray  # (h, w), row = y, column = x; its outermost cells lie outside the plan
    origin: Array  # (2,) [m] W, centre of free[0, 0]
    cell: float  # [m] side of a cell

    def centres(self, cells: IntArray) -> Array:
        """(c, 2) [m] W of the given flat indices (c,) into `free`."""
        rows, columns = np.divmod(cells, self.free.shape[1])
        return self.origin + self.cell * np.column_stack([columns, rows])


def free_cells(plan: FloorPlan, radius: float, cell: float = 0.25) -> FreeCells:
    """Cells with no wall of `plan` within `radius` [m] of their centres.

    The side `cell` [m] is reduced where a wall could otherwise lie between two free centres, so that a disc of this
    radius can move straight between any two free cells that share a side. Raises ValueError unless both lengths are
    positive.
    """
    if not (0.0 < radius < math.inf and 0.0 < cell < math.inf):
        raise ValueError(f"radius and cell must be positive lengths [m], not {radius} and {cell}")
    cell = min(cell, 1.9 * radius)
    margin = max(cell, 1.01 * radius)  # the ground around the plan is connected
    origin = plan.bounds[:2] - max(1.5 * cell, margin)
    columns, rows = np.ceil((plan.bounds[2:] + margin - origin) / cell).astype(int) + 1
    free = np.ones((rows, columns), np.bool_)
    left, bottom = origin.tolist()
    xs, ys = left + np.arange(columns) * cell, bottom + np.arange(rows) * cell
    for x1, y1, x2, y2 in plan.walls.tolist():
        near_rows = _between(min(y1, y2) - radius - bottom, max(y1, y2) + radius - bottom, cell)
        near_columns = _between(min(x1, x2) - radius - left, max(x1, x2) + radius - left, cell)
        dx, dy, ex, ey = xs[near_columns] - x1, ys[near_rows, None] - y1, x2 - x1, y2 - y1
        t = np.clip((dx * ex + dy * ey) / max(ex * ex + ey * ey, 1e-300), 0.0, 1.0)
        free[near_rows, near_columns] &= (dx - t * ex) ** 2 + (dy - t * ey) ** 2 >= radius * radius
    return FreeCells(free, origin, cell)


def reachable(plan: FloorPlan, cells: FreeCells) -> Array:
    """(c, 2) [m] W: centres of the free cells of the largest connected part of the plan's rooms.

    Cells are connected through their sides. The size of a part is the number of its cells within rooms, so that the
    open ground around a building is never chosen; where a plan names no rooms, every part but the ground around it
    counts as a room. Furniture can be pushed and is ignored. The result is empty where nothing is free.
    """
    parts = ndimage.label(cells.free)[0].ravel()  # 0 where not free
    flat = np.flatnonzero(parts)
    labels, centres = parts[flat], cells.centres(flat)
    indoors = np.zeros(len(flat), np.bool_)
    for room in plan.rooms:
        indoors |= room.contains(centres)
    if not plan.rooms:
        indoors = labels != parts[0]  # the ground around the plan reaches its outermost cells
    if not indoors.any():
        return np.empty((0, 2))
    return np.asarray(centres[labels == np.argmax(np.bincount(labels[indoors]))])


def observable(plan: FloorPlan, walls: Packed, cells: Array, max_range: float) -> BoolArray:
    """(N,) whether each feature of the plan is seen from one of `cells` (c, 2) [m] within `max_range` [m].

    Only walls hide features here, since furniture and people move.
    """
    features = plan.features
    return seen_from(walls, np.ascontiguousarray(cells), features.positions, pull_back(features), max_range, NOTHING)


def free_start(plan: FloorPlan, cells: Array, radius: float, rng: np.random.Generator) -> Array:
    """A random pose (3,) in W of a robot of this radius [m]: one of `cells` (c, 2) [m] that is at least 0.3 m from all
    furniture, and that the robot does not touch, with any heading.

    Raises ValueError where there is no such cell.
    """
    if len(cells) == 0:
        raise ValueError(f"floor plan {plan.name!r} has no free space for the robot to start in")
    clearance = max(_START_CLEARANCE, radius + _START_GAP)
    for i in rng.permutation(len(cells)):
        x, y = cells[i]
        if box_distance(x, y, plan.furniture) >= clearance:
            return np.array([x, y, rng.uniform(-math.pi, math.pi)])
    raise ValueError(f"floor plan {plan.name!r}: furniture stands within {clearance:g} m of every free place")


def _between(low: float, high: float, cell: float) -> slice:
    """The cells whose centres lie from `low` to `high` [m] beyond the centre of the first cell."""
    return slice(max(math.ceil(low / cell), 0), max(math.floor(high / cell) + 1, 0))
