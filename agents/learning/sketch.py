"""A drive in outline, some twenty times as fast as an episode: what a goal is worth can be found out by trying it.

The building, the senses and the goals on offer are those of the environment. The robot knows where it is, moves along
its path a stretch at a time, and has mapped every feature that it has once had in sight.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from agents.drivers.base import LOOK_AROUND, Observation
from slam_gym._jit import compiled
from slam_gym.envs.observation import encode_goals
from slam_gym.geometry import compose, observe, wrap_angle
from slam_gym.navigation.explored_grid import ExploredGrid
from slam_gym.navigation.planner import distance_field
from slam_gym.navigation.pursuit import points_ahead
from slam_gym.simulation.driver import APART, ARRIVED, is_free, way_to
from slam_gym.simulation.episode import Episode
from slam_gym.simulation.goals import SLOTS, WORTH_SEEING, Goals, Tried, clearances, frontiers_on_offer
from slam_gym.types import Array, Beams, BoolArray, IntArray
from slam_gym.world.ray_casting import Grid, Packed, WallIndex, cast, pull_back, sees

STRETCH, SPEED = 4, 0.095  # [ticks] between looks, and [m/tick] along a path
TURN, FREE_TURN = 4.0, 0.3  # [ticks/rad] for what a path turns by at once, but for so much [rad]
REPLAN = 4  # [stretches] between looks at whether the path still holds
QUARTER = 8  # [ticks] for a quarter of a turn

Policy = Callable[["Sketch"], int]


class Sketch:
    """One drive, begun where `episode` begins, over `budget` ticks."""

    def __init__(self, episode: Episode, budget: int) -> None:
        self.budget, self.ticks = budget, 0
        self._scenario, self._around = episode.scenario, _surroundings(episode)
        self._counted = episode.site.observable
        self._sightings = np.zeros(len(self._around.features), np.int64)
        self._enough = -(-episode.scenario.slam.map.confirmations // STRETCH)
        side, shape = episode.grid.resolution, np.array(episode.grid.cells.shape[::-1])
        self._grid = ExploredGrid(np.concatenate([episode.grid.origin, episode.grid.origin + side * shape]), side)
        self._tried, self._looked = Tried(), Tried()
        self._look(np.zeros(3))
        self._offer()

    def fork(self) -> Sketch:
        """A drive that goes on from here by itself."""
        other = copy.copy(self)
        other._grid, other._sightings = copy.deepcopy(self._grid), self._sightings.copy()
        other._tried, other._looked = copy.deepcopy(self._tried), copy.deepcopy(self._looked)
        return other

    @property
    def over(self) -> bool:
        return self.ticks >= self.budget

    @property
    def missed(self) -> float:
        """The fraction of the features that are not mapped: what there is of the map error here."""
        return 1.0 - float(self._mapped[self._counted].mean())

    @property
    def _mapped(self) -> BoolArray:
        """(N,) features that were in sight often enough."""
        out: BoolArray = self._sightings >= self._enough
        return out

    @property
    def legal(self) -> BoolArray:
        """(SLOTS,) the goals to choose from: no second look around at one place while there is anything else."""
        legal = self.goals.legal.copy()
        legal[LOOK_AROUND] = self._looked.times(self.goals.positions[:1])[0] == 0 or not legal[1:].any()
        return legal

    def observation(self) -> Observation:
        """What the environment would show, as far as tokens of goals are made of it."""
        seen = observe(self._around.base, self._around.features[self._mapped])
        return {
            "goals": encode_goals(self.goals, self._here),
            "image": self._grid.egocentric(self._here, np.ascontiguousarray(seen)),
            "budget": np.array([1.0 - self.ticks / self.budget], np.float32),
        }

    def step(self, slot: int) -> None:
        """Carry a goal out, and see what is on offer then."""
        before = self.ticks
        if slot == LOOK_AROUND:
            self._look_around()
        else:
            self._drive(self.goals.positions[slot])
        self.ticks = max(self.ticks, before + 1)  # a goal always costs time
        if not self.over:
            self._offer()

    def _offer(self) -> None:
        for clearance in clearances(self._scenario.robot.radius):
            self._field = distance_field(self._grid, self._here[:2], clearance)
            ends = frontiers_on_offer(self._grid, self._field, self._scenario.beams.range, self._tried)
            if len(ends):
                break
        spots, lengths, legal = np.zeros((SLOTS, 2)), np.zeros(SLOTS), np.arange(SLOTS) <= len(ends)
        spots[LOOK_AROUND], spots[1 : 1 + len(ends)] = self._here[:2], ends
        lengths[1 : 1 + len(ends)] = self._field.lengths_to(ends)
        areas = np.where(legal, self._grid.expected_area(spots, self._scenario.beams.range), 0.0)
        self.goals = Goals(spots, lengths, areas, np.zeros(SLOTS), legal)

    def _look(self, here: Array) -> None:
        """Be at a pose (3,) in B, and look."""
        self._here = here
        self._enter(here, look(self._around, here, self._sightings))

    def _enter(self, here: Array, ranges: Array) -> None:
        self._grid.integrate(here, Beams(self._around.bearings, ranges, self._around.reach))

    def _look_around(self) -> None:
        self._looked.add(self._here[:2])
        for _ in range(4):
            if not self.over:
                self.ticks += QUARTER
                self._look(self._here + np.array([0.0, 0.0, 0.5 * math.pi]))

    def _drive(self, goal: Array) -> None:
        asked, path, seen = goal, self._field.path(goal), False
        while len(path) > 1 and not self.over and math.dist(self._here[:2], goal) >= ARRIVED:
            path = self._along(path)
            if len(path) > 1:
                seen = bool(self._grid.expected_area(goal[None], self._around.reach)[0] < WORTH_SEEING)
                path = path[:0] if seen else self._still_open(path, goal)
                goal = path[-1] if len(path) else goal
        if not seen and not self.over:
            self._tried.add(asked)

    def _along(self, path: Array) -> Array:
        """A few stretches along a path (p, 2), p ≥ 2, that begins here; what is left of it."""
        left = self.budget - self.ticks
        driven = drive_along(self._around, self._here, path, REPLAN, ARRIVED, left, self._sightings)
        for here, ranges in zip(driven.poses, driven.ranges):
            self._enter(here, ranges)
        self._here, self.ticks = driven.poses[-1], self.ticks + driven.ticks
        return np.concatenate([self._here[None, :2], path[driven.passed :]])

    def _still_open(self, path: Array, goal: Array) -> Array:
        """The path itself, or where a wall has been drawn across it another one, or as near as will do, or (0, 2)."""
        if is_free(self._grid, points_ahead(path, path[0], APART)):
            return path
        return way_to(self._grid, self._scenario.robot.radius, self._here[:2], goal)


def _surroundings(episode: Episode) -> Surroundings:
    plan, sensor, beams = episode.site.plan, episode.scenario.sensor, episode.scenario.beams
    walls = WallIndex(np.concatenate([plan.walls, episode.world.furniture_segments]))
    part = beams.field_of_view / beams.count
    return Surroundings(
        walls.packed, plan.features.positions, pull_back(plan.features), episode.base, sensor.min_range, sensor.range,
        0.5 * sensor.field_of_view, part * (np.arange(beams.count) + 0.5 * (1 - beams.count)), beams.range,
    )  # fmt: skip


def missed_by(sketch: Sketch, policy: Policy, first: int) -> float:
    """The fraction of the features that are missed at the end of a drive which goes on from here with the goal `first`,
    and then those of a policy. The sketch itself stays where it is."""
    drive = sketch.fork()
    drive.step(first)
    while not drive.over:
        drive.step(policy(drive))
    return drive.missed


# -- the inner loop: along a path, a stretch at a time, and what is in sight at the end of each ------------------------


class Surroundings(NamedTuple):
    """What there is to see, and how far the robot's senses reach."""

    walls: Packed  # furniture among them
    features: Array  # (N, 2) [m] in W
    pull_backs: Array  # (N,) [m]
    base: Array  # (3,) of B in W
    near: float  # [m] of the nearest feature that is seen
    far: float  # [m] of the farthest
    half_view: float  # [rad] to either side of the heading
    bearings: Array  # (b,) [rad] of the beams
    reach: float  # [m] of the beams


class Stretches(NamedTuple):
    """k stretches that have been driven."""

    poses: Array  # (k, 3) in B, at the end of each
    ranges: Array  # (k, b) [m] of the beams there
    ticks: int  # that they took
    passed: int  # waypoints of the path that lie behind


@compiled
def look(around: Surroundings, here: Array, sighted: IntArray) -> Array:
    """Ranges (b,) of the beams from `here` (3,) in B; features in sight are counted in `sighted` (N,)."""
    pose, grid = compose(around.base, here), Grid(*around.walls)
    for i in range(len(around.features)):
        dx, dy = around.features[i, 0] - pose[0], around.features[i, 1] - pose[1]
        if not around.near <= math.hypot(dx, dy) <= around.far:
            continue
        if abs(wrap_angle(math.atan2(dy, dx) - pose[2])) > around.half_view:
            continue
        if sees(grid, pose[0], pose[1], dx, dy, around.pull_backs[i]):
            sighted[i] += 1
    nothing = (np.empty((0, 3)), np.empty((0, 4)))
    return cast(around.walls, pose[:2], pose[2] + around.bearings, around.reach, nothing)


@compiled
def drive_along(
    around: Surroundings, here: Array, path: Array, count: int, arrived: float, ticks: int, sighted: IntArray
) -> Stretches:
    """At most `count` stretches along a path (p, 2) from `here` (3,), its first point, none begun after `ticks` ticks.

    Ends within `arrived` [m] of the end of the path. What comes in sight is counted in `sighted` (N,).
    """
    poses, ranges = np.empty((count, 3)), np.empty((count, len(around.bearings)))
    (x, y, heading), k, used, at, goal = here, 0, 0, 1, path[-1]
    while k < count and used < ticks and at < len(path) and math.hypot(goal[0] - x, goal[1] - y) >= arrived:
        left, turned = STRETCH * SPEED, 0.0
        while left > 1e-9 and at < len(path):
            dx, dy = path[at, 0] - x, path[at, 1] - y
            length = math.hypot(dx, dy)
            if length > 1e-6:
                before, heading = heading, math.atan2(dy, dx)
                turned += max(0.0, abs(wrap_angle(heading - before)) - FREE_TURN)
                part = min(1.0, left / length)
                x, y, left = x + part * dx, y + part * dy, left - part * length
            if left > 1e-9:
                at += 1
        used += STRETCH + round(TURN * turned)
        poses[k] = x, y, heading
        ranges[k] = look(around, poses[k], sighted)
        k += 1
    return Stretches(poses[:k], ranges[:k], used, at)
