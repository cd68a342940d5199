"""Explore-v0 steps per second in `twist` mode, against map size, and where the time of a step goes.

One process, one thread, compiled beforehand. Episodes on test worlds are driven by the map's own exploration (nearest
frontier, planned outside the clock), since a blind drive would sit in a corner; only `env.step` is timed. Every step is
the whole tick: physics, scan, beams, odometry, EKF with full covariance, JCBB, covisibility, explored grid, map error,
observation, info. The parts are timed in a second pass by wrapping their calls, which adds about a microsecond to each.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import gymnasium as gym
import numpy as np
from threadpoolctl import threadpool_limits

import slam_gym  # noqa: F401  (registers the environments)
from slam_gym.envs import explore
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.metrics.association import Identities
from slam_gym.navigation.explored_grid import ExploredGrid
from slam_gym.navigation.planner import distance_field
from slam_gym.navigation.pursuit import follow
from slam_gym.simulation import episode as episode_module
from slam_gym.types import Array
from slam_gym.world.physics import World
from slam_gym.world.sensor import Sensor

REPLAN = 20  # [steps]
PARTS: dict[str, tuple[tuple[Any, str], ...]] = {
    "physics": ((World, "tick"),),
    "scan": ((Sensor, "scan"),),
    "beams": ((Sensor, "beams"),),
    "odometry": ((Sensor, "odometry"),),
    "EKF predict": ((StochasticMap, "predict"),),
    "EKF predict features": ((StochasticMap, "prediction"),),
    "EKF update": ((StochasticMap, "update"),),
    "EKF add, remove": ((StochasticMap, "add"), (StochasticMap, "unconfirmed"), (StochasticMap, "remove")),
    "covisibility": tuple((CovisibilityGraph, name) for name in ("local_to", "add", "see_together", "keep")),
    "explored grid": ((ExploredGrid, "integrate"),),
    "decisions judged": ((Identities, "update"),),
    "map error, coverage": ((episode_module.Episode, "map_error"), (episode_module.Episode, "coverage")),
    "observation": tuple((explore, f"encode_{name}") for name in ("scan", "features", "uncertainty", "image")),
}


class Pilot:
    """Drives to the nearest frontier, and to a random free place when there is none."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._path = np.empty((0, 2))

    def action(self, env: Any, step: int) -> Array:
        """The twist (2,) that follows the path, planned anew every so often."""
        episode = env.episode
        pose = episode.slam.map.pose
        if step % REPLAN == 0:
            field = distance_field(episode.grid, pose[:2], episode.scenario.robot.radius + 0.05)
            ends = episode.grid.frontiers(field.reachable).centres
            lengths = np.array([field.length_to(end) for end in ends])
            if len(ends) and np.isfinite(lengths).any():
                self._path = field.path(ends[int(np.argmin(lengths))])
            else:
                self._path = field.path(field.nearest(pose[:2] + self._rng.normal(0.0, 5.0, 2)))
        return np.clip(np.array(follow(pose, self._path), np.float32), -1.0, 1.0)


def drive(env: Any, episodes: int, seed: int) -> tuple[Array, Array]:
    """Time [µs] and number of mapped features of every step of some episodes, (steps,) each."""
    times, features = [], []
    for number in range(episodes):
        pilot, over, step = Pilot(seed + number), False, 0
        env.reset(seed=seed + number, options={"world": number})
        while not over:
            action = pilot.action(env, step)
            start = time.perf_counter()
            _, _, over, _, _ = env.step(action)
            times.append(1e6 * (time.perf_counter() - start))
            features.append(env.episode.slam.map.n)
            step += 1
    return np.array(times), np.array(features)


@contextmanager
def timed_parts(spent: dict[str, float]) -> Iterator[None]:
    """Add the time [µs] of the calls in `PARTS`, and of the associator, to `spent` while the context lasts."""
    original = []

    def wrapped(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            start = time.perf_counter()
            try:
                return function(*arguments, **named)
            finally:
                spent[name] += 1e6 * (time.perf_counter() - start)

        return call

    for name, calls in PARTS.items():
        for owner, attribute in calls:
            function = getattr(owner, attribute)
            original.append((owner, attribute, function))
            setattr(owner, attribute, wrapped(name, function))
    try:
        yield
    finally:
        for owner, attribute, function in original:
            setattr(owner, attribute, function)


def main(argv: list[str] | None = None) -> None:
    """Print steps per second, the curve over map size, and the parts of a step."""
    parser = argparse.ArgumentParser(prog="python -m slam_gym.bench step", description=__doc__)
    parser.add_argument("--episodes", type=int, default=5, help="episodes, test worlds 0 … N−1 (default 5)")
    parser.add_argument("--scenario", default="office")
    parser.add_argument("--associator", default="jcbb")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(argv)
    settings = {"scenario": arguments.scenario, "split": "test", "action": "twist"}
    with threadpool_limits(limits=1):
        env: Any = gym.make("slam_gym/Explore-v0", associator=arguments.associator, **settings).unwrapped
        drive(env, 1, arguments.seed)  # compiles
        times, features = drive(env, arguments.episodes, arguments.seed)
        spent: dict[str, float] = defaultdict(float)
        with timed_parts(spent):
            whole, _ = drive(env, arguments.episodes, arguments.seed)
    _report(times, features, spent, whole)


def _report(times: Array, features: Array, spent: dict[str, float], whole: Array) -> None:
    small = features <= 100
    print(
        f"{len(times)} steps; up to 100 features: {1e6 / np.median(times[small]):.0f} steps/s (median step "
        f"{np.median(times[small]):.0f} µs, mean {times[small].mean():.0f}); all: {1e6 / np.median(times):.0f} steps/s"
    )
    print("\n mapped features   median µs   steps/s")
    edges = np.array([0, 25, 50, 75, 100, 125, 150, 200, 300, 500, 1000])
    for low, high in itertools.pairwise(edges):
        inside = times[(features > low) & (features <= high)]
        if len(inside) >= 50:
            print(f"   {low + 1:5d} – {high:4d}    {np.median(inside):8.0f}  {1e6 / np.median(inside):8.0f}")
    print("\n part                     µs a step   share")
    rows = [*spent.items(), ("association and the rest", whole.sum() - sum(spent.values()))]
    for name, total in rows:
        print(f" {name:24s} {total / len(whole):9.1f}   {100.0 * total / whole.sum():4.1f} %")
