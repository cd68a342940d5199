"""Explorations of Explore-v0 in `twist` mode, driven over the robot's own map, for benchmarks of what happens inside.

A robot that drove blindly would sit in a corner.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

import slam_gym  # noqa: F401  (registers the environments)
from slam_gym.bench.timing import THREAD, timed
from slam_gym.navigation.planner import distance_field
from slam_gym.navigation.pursuit import follow
from slam_gym.types import Array

REPLAN = 20  # [steps]


class Step(NamedTuple):
    """One step of an exploration."""

    microseconds: float  # of the processor, in `env.step`
    info: dict[str, Any]


def explorer(scenario: Any, **options: Any) -> Any:
    """Explore-v0 without its wrappers, driven by twists."""
    return gym.make("slam_gym/Explore-v0", scenario=scenario, action="twist", **options).unwrapped


def explore(env: Any, seed: int, world: int | None = None) -> Iterator[Step]:
    """An episode, step by step; in test world number `world`, or in one that the seed draws."""
    env.reset(seed=seed, options=None if world is None else {"world": world})
    pilot, over, step = Pilot(seed), False, 0
    while not over:
        action = pilot.action(env.episode, step)
        (_, _, over, _, info), taken = timed(env.step, action, clock=THREAD)
        yield Step(taken, info)
        step += 1


class Pilot:
    """Drives to the nearest frontier, and to a random free place when there is none."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._path = np.empty((0, 2))

    def action(self, episode: Any, step: int) -> Array:
        """The twist (2,) that follows the path, planned anew every so often."""
        pose = episode.slam.map.pose
        if step % REPLAN == 0:
            self._path = self._plan(episode, pose)
        return np.clip(np.array(follow(pose, self._path), np.float32), -1.0, 1.0)

    def _plan(self, episode: Any, pose: Array) -> Array:
        field = distance_field(episode.grid, pose[:2], episode.scenario.robot.radius + 0.05)
        ends = episode.grid.frontiers(field.reachable).centres
        lengths = np.array([field.length_to(end) for end in ends])
        if len(ends) and np.isfinite(lengths).any():
            return field.path(ends[int(np.argmin(lengths))])
        return field.path(field.nearest(pose[:2] + self._rng.normal(0.0, 5.0, 2)))
