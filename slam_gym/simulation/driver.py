"""Carrying out a goal: plan a path over the explored grid, follow it tick by tick, and know when to hand back."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from slam_gym.navigation.explored_grid import FREE, ExploredGrid
from slam_gym.navigation.planner import DistanceField, distance_field
from slam_gym.navigation.pursuit import PursuitSpec, follow, length_left, next_stretch, points_ahead
from slam_gym.simulation.episode import Episode
from slam_gym.simulation.goals import FRONTIERS, LOOK, WORTH_SEEING, clearances
from slam_gym.types import Array

ARRIVED = 0.4  # [m] from the goal
REPLAN = 10  # [ticks] at most between looks at whether the path still holds
KEEP = 1.1  # a path is kept until a fresh one is shorter by more than this factor
APART = 0.2  # [m] between the points at which a path is looked at
AHEAD, AROUND = 15.0, 6.0  # [m] of a path that are replanned at a time, and of the space around them
NEAR_ENOUGH = 1.5  # [m] from a goal that cannot be reached any more, where a place that can be takes its stead
STUCK_TICKS, STUCK_DISTANCE = 25, 0.15  # [ticks], [m] no nearer than this in so many ticks: lost

AfterTick = Callable[[], None]
Command = tuple[float, float]  # fractions in [−1, 1] of the greatest forward and turning speed


def carry_out(
    episode: Episode, slot: int, goal: Array, after_tick: AfterTick, ways: DistanceField | None = None
) -> None:
    """Carry a goal out, tick by tick (see `commands`). `after_tick` is called after every tick."""
    for forward, turn in commands(episode, slot, goal, ways):
        episode.tick(forward, turn)
        after_tick()


def commands(episode: Episode, slot: int, goal: Array, ways: DistanceField | None = None) -> Iterator[Command]:
    """Look around (slot `LOOK`), or drive to `goal` (2,) in B until it is reached, lost or out of date.

    Yields forward and turning speed for one tick after the other; each is to be carried out before the next is asked
    for. A frontier is out of date once there is little left to see from it; a revisit is driven to its end. A goal to
    which no path leads any more, because a wall has been drawn there, gives way to a place nearby. Ends at once when
    the budget is spent. `ways` are those of `Goals`, where nothing has happened since, and save looking for them again.
    """
    return _look_around(episode) if slot == LOOK else _drive(episode, goal, slot <= FRONTIERS, ways)


def _look_around(episode: Episode) -> Iterator[Command]:
    """One full turn on the spot, as the odometry tells it; given up after twice the time that it takes."""
    robot, tick = episode.scenario.robot, episode.scenario.dynamics.tick
    turned = 0.0
    for _ in range(math.ceil(4.0 * math.pi / (robot.max_turn * tick))):
        if episode.over or turned >= 2.0 * math.pi:
            return
        yield 0.0, 1.0
        turned += abs(float(episode.odometry.motion[2]))


def _drive(episode: Episode, goal: Array, frontier: bool, ways: DistanceField | None) -> Iterator[Command]:
    robot = episode.scenario.robot
    pursuit = PursuitSpec(max_speed=robot.max_speed, max_turn=robot.max_turn)
    path, wanted, seen = np.empty((0, 2)), goal, False
    nearest, since = math.inf, 0
    ticks = 0
    while not episode.over:
        pose = episode.slam.map.pose
        if ticks % REPLAN == 0:
            path = _plan(episode, pose, goal, path, None if ticks else ways)
            seen = frontier and ticks > 0 and _out_of_date(episode, goal)
            if len(path) == 0 or seen:
                break
            goal = path[-1]  # another one nearby, where that asked for is no longer open
        left = length_left(path, pose[:2])
        nearest, since = (left, 0) if left < nearest - STUCK_DISTANCE else (nearest, since + 1)
        if math.dist(pose[:2], goal) < ARRIVED or since > STUCK_TICKS:
            break
        episode.path = path
        yield follow(pose, path, pursuit)
        ticks += 1
    episode.path = np.empty((0, 2))
    if frontier and not seen and not episode.over:
        episode.tried.add(wanted)
    if ticks == 0 and not episode.over:
        yield 0.0, 0.0  # a step always costs time, or a lost goal could be asked for for ever


def _plan(episode: Episode, pose: Array, goal: Array, path: Array, ways: DistanceField | None = None) -> Array:
    """A path (p, 2) to the goal, or as near to it as will do, or (0, 2).

    The path that is followed stays, as long as it is open and not much longer than a fresh one: otherwise two ways
    round an obstacle that cost the same would take turns, and the robot would go neither. Only the next stretch of it
    is planned anew, so that a plan takes as long in a large building as in a small one.
    """
    grid = episode.grid
    if len(path) and is_free(grid, points_ahead(path, pose[:2], APART)):
        stretch, rest = next_stretch(path, pose[:2], AHEAD)
        fresh = _replanned(episode, pose, stretch)
        if fresh is stretch:
            return path
        if len(fresh):
            return np.concatenate([fresh, rest])
    return way_to(grid, episode.scenario.robot.radius, pose[:2], goal, ways)


def way_to(grid: ExploredGrid, radius: float, here: Array, goal: Array, ways: DistanceField | None = None) -> Array:
    """A path (p, 2) of a robot of `radius` [m] to a goal, or as near to it as will do, or (0, 2).

    `ways` from here at the first of its `clearances`, where they are known already.
    """
    for clearance in clearances(radius):
        field, ways = ways or distance_field(grid, here, clearance), None
        fresh = field.path(goal)
        if len(fresh):
            return fresh
        nearby = field.nearest(goal)
        if math.dist(nearby, goal) < NEAR_ENOUGH:
            return field.path(nearby)
    return np.empty((0, 2))


def _replanned(episode: Episode, pose: Array, stretch: Array) -> Array:
    """The stretch itself where it holds, another way to its end where that is better, or (0, 2)."""
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
    """No wall has been drawn where any of the points (q, 2) lies."""
    rows, columns = np.floor((points - grid.origin) / grid.resolution).astype(np.int64).T[::-1]
    return bool((grid.cells[rows, columns] == FREE).all())


def _out_of_date(episode: Episode, goal: Array) -> bool:
    """What was to be seen from the frontier has been seen on the way."""
    return float(episode.grid.expected_area(goal[None], episode.scenario.beams.range)[0]) < WORTH_SEEING
