"""A simplified drive, some ten times as fast as an episode, to find the value of a goal by trying it.

Building, sensors and goals are those of the environment. The robot knows its pose, moves along its path in stretches,
and maps every feature that was in sight often enough.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable

import numpy as np

from agents.drivers.base import LOOK_AROUND, Observation
from slam_gym.envs.observation import encode_goals
from slam_gym.geometry import compose, observe, wrap_angle
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.navigation.explored_grid import ExploredGrid
from slam_gym.navigation.pursuit import points_ahead
from slam_gym.simulation.driver import APART, ARRIVED, is_free, way_to
from slam_gym.simulation.episode import Episode
from slam_gym.simulation.goals import WORTH_SEEING, Places, Tried, propose
from slam_gym.types import Array, Beams, BoolArray
from slam_gym.world.ray_casting import WallIndex, pull_back

STRETCH, SPEED = 4, 0.095  # [ticks] between looks, and [m/tick] along a path
TURN, FREE_TURN = 4.0, 0.3  # [ticks/rad] for a corner of a path, without the first so many [rad]
REPLAN = 4  # [stretches] between checks of whether the path is still free
QUARTER = 8  # [ticks] for a quarter of a turn

Policy = Callable[["Sketch"], int]


class Sketch:
    """One drive of `budget` ticks, which begins where `episode` begins."""

    def __init__(self, episode: Episode, budget: int) -> None:
        self.budget, self.ticks = budget, 0
        self._begun, beams = episode, episode.scenario.beams
        self._radius = episode.scenario.robot.radius
        self._bearings = beams.field_of_view / beams.count * (np.arange(beams.count) + 0.5 * (1 - beams.count))
        self._pull_backs = pull_back(episode.site.plan.features)
        self._walls = WallIndex(np.concatenate([episode.site.plan.walls, episode.world.furniture_segments]))
        self._sightings = np.zeros(len(episode.site.plan.features), np.int64)
        side, shape = episode.grid.resolution, np.array(episode.grid.cells.shape[::-1])
        self._grid = ExploredGrid(np.concatenate([episode.grid.origin, episode.grid.origin + side * shape]), side)
        self._tried, self._looked = Tried(), Tried()
        self._look(np.zeros(3))
        self._offer()

    def fork(self) -> Sketch:
        """An independent copy, which continues from here."""
        other = copy.copy(self)
        other._grid, other._sightings = copy.deepcopy(self._grid), self._sightings.copy()
        other._tried, other._looked = copy.deepcopy(self._tried), copy.deepcopy(self._looked)
        return other

    @property
    def over(self) -> bool:
        return self.ticks >= self.budget

    @property
    def missed(self) -> float:
        """The fraction of the observable features that are not mapped, which takes the place of the map error."""
        return 1.0 - float(self._mapped[self._begun.site.observable].mean())

    @property
    def _mapped(self) -> BoolArray:
        """(N,) the features that were in sight often enough to be mapped."""
        out: BoolArray = self._sightings * STRETCH >= self._begun.scenario.slam.map.confirmations
        return out

    @property
    def legal(self) -> BoolArray:
        """(SLOTS,) the legal goals; a second look around at the same place only where no other goal is legal."""
        legal = self.goals.legal.copy()
        legal[LOOK_AROUND] = self._looked.times(self.goals.positions[:1])[0] == 0 or not legal[1:].any()
        return legal

    def observation(self) -> Observation:
        """The parts of the environment's observation from which the tokens of goals are made."""
        seen = observe(self._begun.base, self._begun.site.plan.features.positions[self._mapped])
        return {
            "goals": encode_goals(self.goals, self._here),
            "image": self._grid.egocentric(self._here, np.ascontiguousarray(seen)),
            "budget": np.array([1.0 - self.ticks / self.budget], np.float32),
        }

    def step(self, slot: int) -> None:
        """Carry out a goal, and compute the next goals."""
        before = self.ticks
        if slot == LOOK_AROUND:
            self._look_around()
        else:
            self._drive(self.goals.positions[slot])
        self.ticks = max(self.ticks, before + 1)  # a goal always costs time
        if not self.over:
            self._offer()

    def _offer(self) -> None:
        """Compute the goals that the environment offers to a robot with an exact pose and no revisits."""
        robot = StochasticMap()
        robot.place(self._here, np.zeros((3, 3)))
        self.goals = propose(self._begun.scenario, robot, self._grid, Places(), self._tried)

    def _look(self, here: Array) -> None:
        """Move to a pose (3,) in B, and sense there."""
        self._here, pose = here, compose(self._begun.base, here)
        sensor, features = self._begun.scenario.sensor, self._begun.site.plan.features.positions
        dx, dy = (features - pose[:2]).T
        distances, turns = np.hypot(dx, dy), np.arctan2(dy, dx) - pose[2]
        ahead = np.abs(np.remainder(turns + math.pi, math.tau) - math.pi) <= 0.5 * sensor.field_of_view
        near = np.flatnonzero((sensor.min_range <= distances) & (distances <= sensor.range) & ahead)
        self._sightings[near[self._walls.visible(pose[:2], features[near], self._pull_backs[near])]] += 1
        reach = self._begun.scenario.beams.range
        ranges = self._walls.cast(pose[:2], pose[2] + self._bearings, reach)
        self._grid.integrate(here, Beams(self._bearings, ranges, reach))

    def _look_around(self) -> None:
        self._looked.add(self._here[:2])
        for _ in range(4):
            if not self.over:
                self.ticks += QUARTER
                self._look(self._here + np.array([0.0, 0.0, 0.5 * math.pi]))

    def _drive(self, goal: Array) -> None:
        asked, path, seen = goal, way_to(self._grid, self._radius, self._here[:2], goal, self.goals.ways), False
        while len(path) > 1 and not self.over and math.dist(self._here[:2], goal) >= ARRIVED:
            for _ in range(REPLAN):
                if len(path) > 1 and not self.over and math.dist(self._here[:2], path[-1]) >= ARRIVED:
                    path = self._stretch(path)
            if len(path) > 1:
                reach = self._begun.scenario.beams.range
                seen = bool(self._grid.expected_area(goal[None], reach)[0] < WORTH_SEEING)
                path = path[:0] if seen else self._still_open(path, goal)
                goal = path[-1] if len(path) else goal
        if not seen and not self.over:
            self._tried.add(asked)

    def _stretch(self, path: Array) -> Array:
        """Drive one stretch along a path (p, 2), p ≥ 2, that begins here, and sense at its end; returns the rest."""
        (x, y, heading), left, turned = self._here.tolist(), STRETCH * SPEED, 0.0
        while left > 1e-9 and len(path) > 1:
            dx, dy = float(path[1, 0]) - x, float(path[1, 1]) - y
            length = math.hypot(dx, dy)
            if length > 1e-6:
                before, heading = heading, math.atan2(dy, dx)
                turned += max(0.0, abs(wrap_angle(heading - before)) - FREE_TURN)
                part = min(1.0, left / length)
                x, y, left = x + part * dx, y + part * dy, left - part * length
            if left > 1e-9:
                path = path[1:]
        self.ticks += STRETCH + round(TURN * turned)
        self._look(np.array([x, y, heading]))
        return np.concatenate([self._here[None, :2], path[1:]])

    def _still_open(self, path: Array, goal: Array) -> Array:
        """The path or, where a new wall blocks it, another one to the goal or near it; (0, 2) where there is none."""
        if is_free(self._grid, points_ahead(path, path[0], APART)):
            return path
        return way_to(self._grid, self._radius, self._here[:2], goal)


def missed_by(sketch: Sketch, policy: Policy, first: int) -> float:
    """The fraction of the features that are not mapped at the end of a drive that continues with the goal `first`, and
    then with those of a policy. The sketch itself does not change."""
    drive = sketch.fork()
    drive.step(first)
    while not drive.over:
        drive.step(policy(drive))
    return drive.missed
