"""Explore-v0 steps per second in `twist` mode, against map size, beside what a step is compared with.

One process, one thread, compiled beforehand. Episodes on test worlds are driven by the map's own exploration (nearest
frontier, planned outside the clock); only `env.step` is timed. Every step is the whole tick: physics, scan, beams,
odometry, EKF with full covariance, association, covisibility, explored grid, map error, observation, info.

Times are those of the processor in this thread. Machines differ, and so does what else they do: between the steps, so
that whatever it is falls on all of them, steps of Gymnasium's CartPole are timed, and one symmetric rank-20 product
with 203 columns by BLAS, the floor of what an update of 100 features with ten pairings takes.

    python benchmarks/step.py [--associator marginal --scenario drift-2]      # two minutes
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd
from scipy.linalg.blas import dsyrk

import slam_gym  # noqa: F401 (registers the environments)
from benchmarks.common import Record, options, table, timed
from slam_gym.navigation.planner import distance_field
from slam_gym.navigation.pursuit import follow
from slam_gym.types import Array

SMALL = 100  # features: the headline is of steps in maps of up to so many
EDGES = (0, 25, 50, 75, 100, 125, 150, 200, 300, 500, 1000)  # of the classes of map size
REPLAN = 20  # [steps]
BURST = 40  # steps, and calls of each peer, in turns


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
        lengths = field.lengths_to(ends)
        if len(ends) and np.isfinite(lengths).any():
            return field.path(ends[int(np.argmin(lengths))])
        return field.path(field.nearest(pose[:2] + self._rng.normal(0.0, 5.0, 2)))


def explorer(scenario: Any, **arguments: Any) -> Any:
    """Explore-v0 without its wrappers, driven by twists in test worlds."""
    return gym.make("slam_gym/Explore-v0", scenario=scenario, action="twist", split="test", **arguments).unwrapped


def explore(env: Any, world: int) -> Iterator[tuple[float, dict[str, Any]]]:
    """An episode in a test world: the time [µs] and the info of each step."""
    env.reset(seed=world, options={"world": world})
    pilot, over, step = Pilot(world), False, 0
    while not over:
        (_, _, over, _, info), taken = timed(env.step, pilot.action(env.episode, step))
        yield taken, info
        step += 1


def stepped(name: str) -> Callable[[], object]:
    """A random step of an environment without its wrappers, which is reset when need be."""
    env = gym.make(name).unwrapped
    env.reset(seed=0)
    actions = itertools.cycle(env.action_space.sample() for _ in range(97))

    def step() -> None:
        _, _, terminated, truncated, _ = env.step(next(actions))
        if terminated or truncated:
            env.reset()

    return step


def peers() -> dict[str, Callable[[], object]]:
    """What steps are compared with."""
    factor = np.asfortranarray(np.random.default_rng(0).standard_normal((203, 20)))
    product = partial(dsyrk, -1.0, factor, beta=1.0, c=np.eye(203, order="F"), overwrite_c=True)
    return {"CartPole": stepped("CartPole-v1"), "rank-20 product": product}


def drive(env: Any, worlds: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Time and map size of every step of explorations of test worlds; times [µs] of the peers, in turns with them."""
    beside, steps, others = peers(), [], []
    for world in range(worlds):
        for k, (taken, _) in enumerate(explore(env, world)):
            steps.append({"µs": taken, "features": env.episode.slam.map.n})
            if k % BURST == 0:
                others.append({name: timed(lambda call=call: [call() for _ in range(BURST)])[1] / BURST
                               for name, call in beside.items()})  # fmt: skip
    return pd.DataFrame(steps), pd.DataFrame(others)


def row(name: str, steps: pd.DataFrame) -> Record:
    middle = steps["µs"].median()
    return {"mapped features": name, "steps": len(steps), "median µs": middle, "mean µs": steps["µs"].mean(),
            "steps/s": 1e6 / middle}  # fmt: skip


def main() -> None:
    a = options(__doc__, episodes=5, scenario="office", associator="jcbb")
    overrides = {"budget": 60} if a.quick else {}
    env = explorer(a.scenario, associator=a.associator, overrides=overrides)
    list(explore(env, 0))  # compiles
    steps, others = drive(env, 1 if a.quick else a.episodes)
    small = steps[steps["features"] <= SMALL]
    rows = [row("all", steps), row(f"up to {SMALL}", small)]
    classes = steps.groupby(pd.cut(steps["features"], EDGES), observed=True)
    table("Steps by the size of the map", rows + [row(str(size), own) for size, own in classes if len(own) >= 50])
    medians = {"step": small["µs"].median()} | others.median().to_dict()
    rows = [{"what": name, "median µs": µs, "in a step": medians["step"] / µs} for name, µs in medians.items()]
    table(f"Steps in maps of up to {SMALL} features beside others", rows)


if __name__ == "__main__":
    main()
