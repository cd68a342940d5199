"""Explore-v0 steps per second in `twist` mode, against map size.

One process, one thread, compiled beforehand. Episodes on test worlds are driven by the map's own exploration (nearest
frontier, planned outside the clock); only `env.step` is timed, by the clock of the processor in this thread. Every step
is the whole tick: physics, scan, beams, odometry, EKF with full covariance, association, covisibility, explored grid,
map error, observation, info. Machines differ, and so does what else they do: compare within a run, or runs in turns.

    python benchmarks/step.py [--associator marginal --scenario drift-2]      # two minutes
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd

import slam_gym  # noqa: F401 (registers the environments)
from benchmarks.common import Record, options, table, timed
from slam_gym.simulation.association_runs import nearest_frontier
from slam_gym.simulation.driver import Command, commands
from slam_gym.simulation.goals import Places, propose

SMALL = 100  # features: the headline is of steps in maps of up to so many
EDGES = (0, 25, 50, 75, 100, 125, 150, 200, 300, 500, 1000)  # of the classes of map size


def commands_of(episode: Any) -> Iterator[Command]:
    """What drives to one nearest frontier after the other."""
    rng, places = np.random.default_rng(0), Places()
    while True:
        goals = propose(episode.scenario, episode.slam.map, episode.grid, places, episode.tried)
        slot = nearest_frontier(goals, rng)
        yield from commands(episode, slot, goals.positions[slot])


def explore(env: Any, world: int) -> Iterator[float]:
    """An episode in a test world: the time [µs] of each step."""
    env.reset(seed=world, options={"world": world})
    over, driven = False, commands_of(env.episode)
    while not over:
        (_, _, over, _, _), taken = timed(env.step, np.array(next(driven), np.float32))
        yield taken


def row(name: str, steps: pd.DataFrame) -> Record:
    middle = steps["µs"].median()
    return {"mapped features": name, "steps": len(steps), "median µs": middle, "mean µs": steps["µs"].mean(),
            "steps/s": 1e6 / middle}  # fmt: skip


def main() -> None:
    a = options(__doc__, episodes=5, scenario="office", associator="jcbb")
    overrides = {"budget": 60} if a.quick else {}
    arguments = {"associator": a.associator, "overrides": overrides, "action": "twist", "split": "test"}
    env = gym.make("slam_gym/Explore-v0", scenario=a.scenario, **arguments).unwrapped
    list(explore(env, 0))  # compiles
    worlds = range(1 if a.quick else a.episodes)
    steps = pd.DataFrame(
        {"µs": taken, "features": env.episode.slam.map.n} for world in worlds for taken in explore(env, world)
    )
    rows = [row("all", steps), row(f"up to {SMALL}", steps[steps["features"] <= SMALL])]
    classes = steps.groupby(pd.cut(steps["features"], EDGES), observed=True)
    table("Steps by the size of the map", rows + [row(str(size), own) for size, own in classes if len(own) >= 50])


if __name__ == "__main__":
    main()
