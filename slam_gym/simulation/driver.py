"""Carrying out a goal: plan a path over the explored grid, follow it tick by tick, and stop when the goal has ended."""

import math
from collections.abc import Iterator

import numpy as np

from slam_gym.navigation.explored_grid import FREE, ExploredGrid
from slam_gym.navigation.planner import DistanceField, distance_field
from slam_gym.navigation.pursuit import follow, length_left, next_stretch, points_ahead
from slam_gym.simulation.episode import Episode
from slam_gym.simulation.goals import FRONTIERS, LOOK, WORTH_SEEING, clearances
from slam_gym.types import Array

ARRIVED = 0.4  # [m] distance from the goal at which it is reached
REPLAN = 10  # [ticks] between checks of the path
KEEP = 1.1  # a path is kept until a new one is shorter by more than this factor
APART = 0.2  # [m] between the points at which a path is checked
AHEAD, AROUND = 15.0, 6.0  # [m] length of the path that is replanned at once, and margin of the space around it
NEAR_ENOUGH = 1.5  # [m] from an unreachable goal to a reachable place that may replace it
IN_VAIN = 5  # attempts at a goal after which a robot that stands near it squeezes through a narrow passage
STUCK_TICKS, STUCK_DISTANCE = 25, 0.15  # [ticks], [m] a goal is given up if so many ticks bring the robot less near

Command = tuple[float, float]  # fractions in [−1, 1] of the maximal forward and turning speed


def commands(episode: Episode, slot: int, goal: Array, ways: DistanceField | None = None) -> Iterator[Command]:
    """Look around (slot `LOOK`), or drive to `goal` (2,) in B until it is reached, given up or out of date.

    Yields forward and turning speed, tick by tick; the caller must carry out each before it requests the next. A
    frontier is out of date once little unknown space is visible from it; a revisit never is. If no path leads to the
    goal any more, because a wall has been detected there, a place nearby replaces it. The iterator ends at once when
    the budget is spent. `ways` are those of `Goals`, if nothing has happened since, and save their computation.
    """
    return _look_around(episode) if slot == LOOK else _drive(episode, goal, slot <= FRONTIERS, ways)


def _look_around(episode: Episode) -> Iterator[Command]:
    """One full turn on the spot, by odometry; it is given up after twice the time of a full turn."""
    robot, tick = episode.scenario.robot, episode.scenario.dynamics.tick
    turned = 0.0
    for _ in range(math.ceil(4.0 * math.pi / (robot.max_turn * tick))):
        if episode.over or turned >= 2.0 * math.pi:
            return
        yield 0.0, 1.0
        turned += abs(float(episode.odometry.motion[2]))


def _drive(episode: Episode, goal: Array, frontier: bool, ways: DistanceField | None) -> Iterator[Command]:
    robot, reach = episode.scenario.robot, episode.scenario.beams.range
    speed, turn = float(robot.max_speed), float(robot.max_turn)
    path, requested, seen = np.empty((0, 2)), goal, False
    nearest, stalled = math.inf, 0
    half_turn, way = math.pi / turn, 2.0 * STUCK_DISTANCE / speed  # [s] a slow robot takes longer than most
    patience = max(STUCK_TICKS, math.ceil((half_turn + way) / episode.scenario.dynamics.tick))
    ticks = 0
    while not episode.over:
        pose = episode.slam.map.pose
        if ticks % REPLAN == 0:
            path = _plan(episode, pose, goal, path, None if ticks else ways)
            seen = bool(frontier and ticks and episode.grid.expected_area(goal[None], reach)[0] < WORTH_SEEING)
            if len(path) == 0 or seen:
                break
            goal = path[-1]  # a place nearby, if the goal itself is no longer reachable
        remaining = length_left(path, pose[:2])
        nearest, stalled = (remaining, 0) if remaining < nearest - STUCK_DISTANCE else (nearest, stalled + 1)
        if math.dist(pose[:2], goal) < ARRIVED or stalled > patience:
            break
        episode.path = path
        yield follow(pose, path, speed, turn)
        ticks += 1
    episode.path = np.empty((0, 2))
    if frontier and not seen and not episode.over:
        episode.tried.add(requested)
    if ticks == 0 and not episode.over:
        yield 0.0, 0.0  # a step always costs time; otherwise an unreachable goal could be chosen for ever


def _plan(episode: Episode, pose: Array, goal: Array, path: Array, ways: DistanceField | None = None) -> Array:
    """A path (p, 2) to the goal, or to a place less than `NEAR_ENOUGH` from it, or (0, 2).

    The present path is kept as long as it is free and not much longer than a new one: otherwise the robot would
    alternate between two paths of equal cost around an obstacle, and follow neither. Only the next part of the path is
    replanned, so that planning takes no longer in a large building than in a small one.
    """
    grid = episode.grid
    if len(path) and is_free(grid, points_ahead(path, pose[:2], APART)):
        stretch, rest = next_stretch(path, pose[:2], AHEAD)
        fresh = _replanned(episode, pose, stretch)
        if fresh is stretch:
            return path
        if len(fresh):
            return np.concatenate([fresh, rest])
    least = ARRIVED if episode.tried.times(goal[None])[0] >= IN_VAIN else 0.0
    return way_to(grid, episode.scenario.robot.radius, pose[:2], goal, ways, least)


def way_to(
    grid: ExploredGrid,
    radius: float,
    here: Array,
    goal: Array,
    ways: DistanceField | None = None,
    least: float = 0.0,
) -> Array:
    """A path (p, 2) from `here` to `goal`, or to a place less than `NEAR_ENOUGH` from it, or (0, 2).

    `radius` [m] is that of the robot; `ways` are the paths from `here` at the first of its `clearances`, if known. A
    place near the goal must be at `least` so far [m] from `here`, or else the way leads through narrow passages.
    """
    for clearance in clearances(radius):
        field, ways = ways or distance_field(grid, here, clearance), None
        fresh = field.path(goal)
        if len(fresh):
            return fresh
        nearby = field.nearest(goal)
        if math.dist(nearby, goal) < NEAR_ENOUGH and math.dist(nearby, here) >= least:
            return field.path(nearby)
    return np.empty((0, 2))


def _replanned(episode: Episode, pose: Array, stretch: Array) -> Array:
    """The stretch itself if it is still good, a better path to its end if there is one, or (0, 2)."""
    within = np.concatenate([stretch.min(axis=0) - AROUND, stretch.max(axis=0) + AROUND])
    clearance = clearances(episode.scenario.robot.radius)[0]
    field = distance_field(episode.grid, pose[:2], clearance, within)
    fresh = field.path(stretch[-1])
    if len(fresh):
        open_ = np.isfinite(field.lengths_to(points_ahead(stretch, pose[:2], APART))).all()
        if open_ and length_left(stretch, pose[:2]) < KEEP * length_left(fresh, pose[:2]):
            return stretch
    return fresh


def is_free(grid: ExploredGrid, points: Array) -> bool:
    """Whether the cells of all points (q, 2) are free."""
    rows, columns = np.floor((points - grid.origin) / grid.resolution).astype(np.int64).T[::-1]
    return bool((grid.cells[rows, columns] == FREE).all())
