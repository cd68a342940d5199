"""A simplified drive, some ten times as fast as an episode, to find the value of a goal by trying it.

Building, sensors and goals are those of the environment. The robot knows its pose, moves along its path in stretches,
and maps every feature that was in sight often enough.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from agents.drivers.base import LOOK_AROUND, Observation
from slam_gym.envs.observation import encode_goals
from slam_gym.geometry import compose, observe, wrap_angles
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.navigation.explored_grid import ExploredGrid
from slam_gym.navigation.pursuit import next_stretch, points_ahead
from slam_gym.simulation.driver import APART, ARRIVED, is_free, way_to
from slam_gym.simulation.episode import Episode
from slam_gym.simulation.goals import WORTH_SEEING, Places, Tried, propose
from slam_gym.types import Array, BoolArray
from slam_gym.world.ray_casting import wall_index
from slam_gym.world.sensor import Sensor

STRETCH, SPEED = 4, 0.095  # [ticks] between looks, and [m/tick] along a path
TURN, FREE_TURN = 4.0, 0.3  # [ticks/rad] for a corner of a path, without the first so many [rad]
REPLAN = 4  # [stretches] between checks of whether the path is still free
QUARTER = 8  # [ticks] for a quarter of a turn


class Sketch:
    """One drive of `budget` ticks, which begins where `episode` begins."""

    def __init__(self, episode: Episode, budget: int) -> None:
        self.budget, self.ticks = budget, 0
        self._begun, scenario, plan = episode, episode.scenario, episode.site.plan
        walls = wall_index(np.concatenate([plan.walls, episode.world.furniture_segments]))
        perfect = replace(scenario.sensor, detection=1.0, clutter=0.0, max_features=len(plan.features))
        self._sensor = Sensor(plan, walls, perfect, replace(scenario.beams, sigma=0.0), scenario.odometry)
        self._noise = np.random.default_rng(0)  # of the measured positions, which are not used
        self._sightings = np.zeros(len(plan.features), np.int64)
        side, shape = episode.grid.resolution, np.array(episode.grid.cells.shape[::-1])
        self._grid = ExploredGrid(np.concatenate([episode.grid.origin, episode.grid.origin + side * shape]), side)
        self._tried, self._looked = Tried(), Tried()
        self._look(np.zeros(3))
        self._offer()

    def fork(self) -> Sketch:
        """An independent copy, which continues from here."""
        unchanging = self._begun, self._sensor, self.goals
        return copy.deepcopy(self, {id(part): part for part in unchanging})

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
        return self._sightings * STRETCH >= self._begun.scenario.slam.map.confirmations

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
        _, truth = self._sensor.scan(pose, self._noise)
        self._sightings[truth.sources] += 1
        self._grid.integrate(here, self._sensor.beams(pose, self._noise))

    def _look_around(self) -> None:
        self._looked.add(self._here[:2])
        for _ in range(4):
            if not self.over:
                self.ticks += QUARTER
                self._look(self._here + np.array([0.0, 0.0, 0.5 * math.pi]))

    def _drive(self, goal: Array) -> None:
        requested, radius, seen = goal, self._begun.scenario.robot.radius, False
        path = way_to(self._grid, radius, self._here[:2], goal, self.goals.ways)
        while len(path) > 1 and not self.over and math.dist(self._here[:2], goal) >= ARRIVED:
            for _ in range(REPLAN):
                if len(path) > 1 and not self.over and math.dist(self._here[:2], path[-1]) >= ARRIVED:
                    path = self._stretch(path)
            if len(path) > 1:
                reach = self._begun.scenario.beams.range
                seen = bool(self._grid.expected_area(goal[None], reach)[0] < WORTH_SEEING)
                if seen:
                    path = path[:0]
                elif not is_free(self._grid, points_ahead(path, path[0], APART)):  # a new wall is in the way
                    path = way_to(self._grid, radius, self._here[:2], goal)
                goal = path[-1] if len(path) else goal
        if not seen and not self.over:
            self._tried.add(requested)

    def _stretch(self, path: Array) -> Array:
        """Drive one stretch along a path (p, 2), p ≥ 2, that begins here, and sense at its end; returns the rest."""
        driven, rest = next_stretch(path, path[0], STRETCH * SPEED)
        dx, dy = np.diff(driven, axis=0).T
        legs = np.hypot(dx, dy) > 1e-6
        headings = np.array([self._here[2], *np.arctan2(dy[legs], dx[legs])])
        turns = np.abs(wrap_angles(np.diff(headings)))
        self.ticks += STRETCH + round(TURN * np.maximum(0.0, turns - FREE_TURN).sum())
        self._look(np.array([*driven[-1], headings[-1]]))
        return np.concatenate([driven[-1:], rest])


def missed_by(sketch: Sketch, policy: Callable[[Sketch], int], first: int) -> float:
    """The fraction of the features that are not mapped at the end of a drive that continues with the goal `first`, and
    then with those of a policy. The sketch itself does not change."""
    drive = sketch.fork()
    drive.step(first)
    while not drive.over:
        drive.step(policy(drive))
    return drive.missed
