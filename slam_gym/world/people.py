"""People: scripted discs that stroll through the rooms and wait for whatever stands in their way.

A stroll leads to a random place some metres of walking away: a breadth-first path over free cells, straightened. A
person never walks into the robot, another person or furniture; a person who has waited too long goes elsewhere.
"""

import math
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from slam_gym._jit import compiled
from slam_gym.types import Array, BoolArray, IntArray
from slam_gym.world.floor_plan import FloorPlan
from slam_gym.world.ray_casting import Packed, WallGrid, box_distance, outlines, sees, wall_index
from slam_gym.world.reachability import free_cells, reachable

_CLEARANCE = 0.02  # [m] from walls
_MARGIN = 0.1  # [m] kept from furniture and other people
_STROLL = 15.0  # [m] longest path of one stroll
_PAUSE = 3.0  # [s] longest rest between strolls
_PATIENCE = 2.0  # [s] of waiting before another path is tried
_START_DISTANCE = 1.5  # [m] from the robot's first position
_MAX_WAYPOINTS = 64


class People:
    """`count` people of equal `radius` [m] and `speed` [m/s] in `plan`, none of whom starts near `robot` (2,) [m] W.

    `keep` [m] is the least distance from a person's edge to the robot's centre to which a person walks. Raises
    ValueError where the plan has no room for so many people.
    """

    def __init__(
        self, plan: FloorPlan, count: int, radius: float, speed: float, keep: float, robot: Array, rng: Generator
    ) -> None:
        self.discs = np.empty((0, 3))  # (p, 3) [m] x y radius, W
        self.velocities = np.zeros((count, 2))  # [m/s] W, during the present tick
        self._speed, self._keep = speed, keep
        self._paths = np.zeros((count, _MAX_WAYPOINTS, 2))  # [m] W, centres of free cells
        self._ahead = np.ones((count, 2), np.int64)  # next waypoint and number of waypoints
        self._timers = np.zeros((count, 2))  # [s] rest that is left, time waited
        if count:
            obstructed = replace(plan, walls=np.vstack([plan.walls, outlines(plan.furniture)]))
            self._walls = wall_index(obstructed.walls)
            self._cells = free_cells(obstructed, radius + _CLEARANCE)
            self.discs = self._places(plan, count, radius, robot, rng)
            self._passed = self.discs[:, :2].copy()  # (p, 2) [m] W the waypoint last reached

    def walk(self, tick: float, robot: Array, furniture: Array, rng: Generator) -> None:
        """Walk for one `tick` [s] among the `robot` (2,) [m] W and `furniture` (f, 5)."""
        if len(self.discs) == 0:
            return
        crowd = (self.discs, self.velocities, self._paths, self._ahead, self._passed, self._timers)
        if _walk(tick, self._speed, self._keep, robot, furniture, crowd):
            for person in np.flatnonzero(self._ahead[:, 0] >= self._ahead[:, 1]):
                self._plan_stroll(int(person), rng)

    def _places(self, plan: FloorPlan, count: int, radius: float, robot: Array, rng: Generator) -> Array:
        """The first positions of people: discs (count, 3)."""
        centres = reachable(plan, self._cells)
        centres = centres[np.hypot(*(centres - robot).T) >= _START_DISTANCE]
        discs = np.empty((0, 3))
        for x, y in centres[rng.permutation(len(centres))]:
            if (np.hypot(discs[:, 0] - x, discs[:, 1] - y) >= 2.0 * radius + _MARGIN).all():
                discs = np.vstack([discs, [x, y, radius]])
            if len(discs) == count:
                return discs
        raise ValueError(f"floor plan {plan.name!r} has room for {len(discs)} people, not for {count}")

    def _plan_stroll(self, person: int, rng: Generator) -> None:
        choice, rest = rng.random(2)
        last = self._passed[person]  # a person who turns back passes it again
        path = _stroll(self._cells.free, self._cells.origin, self._cells.cell, last, choice)
        radius = self.discs[person, 2]
        self._ahead[person] = 0, _straighten(self._walls, path, radius, self._paths[person])
        self._timers[person] = _PAUSE * rest, 0.0


_Crowd = tuple[Array, Array, Array, IntArray, Array, Array]
"""The arrays of `People`: discs, velocities, paths, ahead, passed, timers."""


@compiled
def _walk(tick: float, speed: float, keep: float, robot: Array, furniture: Array, crowd: _Crowd) -> bool:
    """Move all people, one after another; returns whether somebody needs a new path."""
    discs, velocities, paths, ahead, passed, timers = crowd
    idle = False
    for p in range(discs.shape[0]):
        velocities[p, 0] = velocities[p, 1] = 0.0
        if timers[p, 0] > 0.0:
            timers[p, 0] -= tick
            continue
        while ahead[p, 0] < ahead[p, 1]:
            dx, dy = paths[p, ahead[p, 0], 0] - discs[p, 0], paths[p, ahead[p, 0], 1] - discs[p, 1]
            remaining = math.hypot(dx, dy)
            if remaining > 1e-9:
                step = min(speed * tick / remaining, 1.0)  # fraction of the remaining distance
                if _blocked(p, discs[p, 0] + step * dx, discs[p, 1] + step * dy, keep, robot, furniture, discs):
                    timers[p, 1] += tick
                    if timers[p, 1] > _PATIENCE:
                        ahead[p, 0] = ahead[p, 1]
                else:
                    timers[p, 1] = 0.0
                    velocities[p, 0], velocities[p, 1] = step * dx / tick, step * dy / tick
                    discs[p, 0] += step * dx
                    discs[p, 1] += step * dy
                break
            passed[p, 0], passed[p, 1] = paths[p, ahead[p, 0], 0], paths[p, ahead[p, 0], 1]
            ahead[p, 0] += 1
        idle = idle or ahead[p, 0] >= ahead[p, 1]
    return idle


@compiled
def _blocked(person: int, x: float, y: float, keep: float, robot: Array, furniture: Array, discs: Array) -> bool:
    """Whether a step of `person` to (x, y) comes too near to something, and nearer than before the step."""
    from_x, from_y, radius = discs[person, 0], discs[person, 1], discs[person, 2]
    gap = math.hypot(x - robot[0], y - robot[1])
    if gap < radius + keep and gap < math.hypot(from_x - robot[0], from_y - robot[1]):
        return True
    for q in range(discs.shape[0]):
        gap = math.hypot(x - discs[q, 0], y - discs[q, 1])
        near = radius + discs[q, 2] + _MARGIN
        if q != person and gap < near and gap < math.hypot(from_x - discs[q, 0], from_y - discs[q, 1]):
            return True
    gap = box_distance(x, y, furniture)
    return gap < radius and gap < box_distance(from_x, from_y, furniture)


@compiled
def _stroll(free: BoolArray, origin: Array, cell: float, place: Array, choice: float) -> Array:
    """A path (q, 2) [m] over free cells from that of `place` (2,) to one of the farther half of the cells in reach.

    `choice` in [0, 1) selects the destination.
    """
    rows, columns = free.shape
    start = round((place[1] - origin[1]) / cell) * columns + round((place[0] - origin[0]) / cell)
    parents, steps = np.zeros(rows * columns, np.int64), np.zeros(rows * columns, np.int64)
    queue = np.empty(rows * columns, np.int64)
    steps[start], queue[0], head, tail = 1, start, 0, 1  # steps from the start, plus 1; 0 where not visited
    while head < tail:
        c = queue[head]
        head += 1
        if steps[c] * cell > _STROLL:
            continue
        for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            row, column = c // columns + down, c % columns + right
            n = row * columns + column
            if 0 <= row < rows and 0 <= column < columns and free[row, column] and steps[n] == 0:
                parents[n], steps[n], queue[tail] = c, steps[c] + 1, n
                tail += 1
    c = queue[min(int((0.5 + 0.5 * choice) * tail), tail - 1)]
    path = np.empty((steps[c], 2))
    for k in range(steps[c] - 1, -1, -1):
        path[k, 0], path[k, 1] = origin[0] + cell * (c % columns), origin[1] + cell * (c // columns)
        c = parents[c]
    return path


@compiled
def _straighten(packed: Packed, path: Array, radius: float, waypoints: Array) -> int:
    """Write to `waypoints` points of `path` (q, 2) between which a disc can move straight; returns their number."""
    grid, x, y = WallGrid(*packed), path[0, 0], path[0, 1]
    waypoints[0, 0], waypoints[0, 1] = x, y
    count, here = 1, 0
    while here < len(path) - 1 and count < len(waypoints):
        there = here + 1
        while there < len(path) - 1 and _passable(grid, x, y, path[there + 1, 0], path[there + 1, 1], radius):
            there += 1
        x, y, here = path[there, 0], path[there, 1], there
        waypoints[count, 0], waypoints[count, 1] = x, y
        count += 1
    return count


@compiled
def _passable(grid: WallGrid, x1: float, y1: float, x2: float, y2: float, radius: float) -> bool:
    """Whether a disc can move straight from (x1, y1) to (x2, y2): lines along its centre and both flanks are free, and
    nothing thinner lies between them."""
    dx, dy = x2 - x1, y2 - y1
    length, nothing = math.hypot(dx, dy), (np.empty((0, 3)), np.empty((0, 4)))
    for flank in (-radius, 0.0, radius):
        x, y = x1 - flank * dy / length, y1 + flank * dx / length
        if not sees(grid, nothing, x, y, dx, dy, 0.0):
            return False
    for wall in grid.walls:  # what crosses none of the lines has its ends between them
        x, y = wall[0] - x1, wall[1] - y1
        if 0.0 <= x * dx + y * dy <= length * length and abs(dx * y - dy * x) < radius * length:
            return False
    return True
