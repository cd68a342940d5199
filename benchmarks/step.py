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
from slam_gym.simulation.association_runs import nearest_frontier
from slam_gym.simulation.driver import Command, commands
from slam_gym.simulation.goals import Places, propose

SMALL = 100  # features: the headline is of steps in maps of up to so many
EDGES = (0, 25, 50, 75, 100, 125, 150, 200, 300, 500, 1000)  # of the classes of map size
BURST = 40  # steps, and calls of each peer, in turns


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
        for k, taken in enumerate(explore(env, world)):
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
    arguments = {"associator": a.associator, "overrides": overrides, "action": "twist", "split": "test"}
    env = gym.make("slam_gym/Explore-v0", scenario=a.scenario, **arguments).unwrapped
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
