"""Explore-v0 steps per second in `twist` mode, against map size.

One process with one thread, after compilation. Episodes in test worlds are driven to the nearest frontier, whose
planning is not timed; only `env.step` is, in CPU time of this thread. Every step is a whole tick: physics, scan, beams,
odometry, EKF with full covariance, association, covisibility, explored grid, map error, observation, info. Machines and
their load differ, so compare within a run, or alternate runs.

    python benchmarks/step.py [--associator marginal --scenario drift-2]      # two minutes
"""

from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd

import slam_gym  # noqa: F401 (registers the environments)
from benchmarks.common import Record, options, table, timed
from slam_gym.simulation.association_runs import drive, nearest_frontier

SMALL = 100  # features; the headline is for steps in maps of at most this size
EDGES = (0, 25, 50, 75, 100, 125, 150, 200, 300, 500, 1000)  # of the classes of map size


def explore(env: Any, world: int) -> Iterator[float]:
    """Run an episode in a test world; yields the time [µs] of each step."""
    env.reset(seed=world, options={"world": world})
    over, driven = False, drive(env.episode, nearest_frontier, np.random.default_rng(0))
    while not over:
        (_, _, over, _, _), microseconds = timed(env.step, np.array(next(driven), np.float32))
        yield microseconds


def row(name: str, steps: pd.DataFrame) -> Record:
    middle = steps["µs"].median()
    return {"mapped features": name, "steps": len(steps), "median µs": middle, "mean µs": steps["µs"].mean(),
            "steps/s": 1e6 / middle}  # fmt: skip


if __name__ == "__main__":
    a = options(__doc__, episodes=5, scenario="office", associator="jcbb")
    overrides = {"budget": 60} if a.quick else {}
    arguments = {"associator": a.associator, "overrides": overrides, "action": "twist", "split": "test"}
    env = gym.make("slam_gym/Explore-v0", scenario=a.scenario, **arguments).unwrapped
    list(explore(env, 0))  # compiles
    worlds = range(1 if a.quick else a.episodes)
    steps = pd.DataFrame(
        {"µs": time, "features": env.episode.slam.map.n} for world in worlds for time in explore(env, world)
    )
    rows = [row("all", steps), row(f"up to {SMALL}", steps[steps["features"] <= SMALL])]
    classes = steps.groupby(pd.cut(steps["features"], EDGES), observed=True)
    table("Steps by the size of the map", rows + [row(str(size), group) for size, group in classes if len(group) >= 50])
