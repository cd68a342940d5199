"""Explore-v0 steps per second in `twist` mode, against map size, and where the time of a step goes.

One process, one thread, compiled beforehand. Episodes on test worlds are driven by the map's own exploration (nearest
frontier, planned outside the clock); only `env.step` is timed. Every step is the whole tick: physics, scan, beams,
odometry, EKF with full covariance, JCBB, covisibility, explored grid, map error, observation, info. The parts are timed
in a second pass by wrapping their calls, which adds about a microsecond to each; those that never come are left out.

Times are those of the processor in this thread. Machines differ, and so does what else they do: between the steps, so
that whatever it is falls on all of them, steps are timed of Gymnasium's CartPole, of MiniGrid's empty room if that is
installed, and one symmetric rank-20 product with 203 columns by BLAS, which is the floor of what an update of 100
features with ten pairings takes.
"""

from __future__ import annotations

import importlib
import itertools
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from scipy.linalg.blas import dsyrk

from slam_gym.bench.exploration import explore, explorer
from slam_gym.bench.records import Record, column, means, medians
from slam_gym.bench.report import Report
from slam_gym.bench.timing import THREAD, timed
from slam_gym.envs import explore as explore_module
from slam_gym.envs.explore import ExploreEnv
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.metrics.association import Identities
from slam_gym.navigation.keyframes import Keyframes
from slam_gym.simulation.episode import Episode
from slam_gym.simulation.judged import JudgedSlam
from slam_gym.slam import kernels
from slam_gym.slam import slam as slam_module
from slam_gym.slam.slam import Slam
from slam_gym.world.physics import World
from slam_gym.world.sensor import Sensor

SMALL = 100  # features: the headline is of steps in maps of up to so many
PARTS: dict[str, tuple[tuple[Any, str], ...]] = {
    "physics": ((World, "tick"),),
    "odometry, scan, beams": ((Sensor, "sense"),),
    "from prediction to update, at once": ((slam_module, "attempt"),),
    "features that are forgotten": ((Slam, "_forget"),),
    "loops": ((Slam, "close_loops"),),
    "decisions judged": ((Identities, "judge"),),
    "explored grid": ((Keyframes, "enter"),),
    "pose, map error, coverage": ((Episode, "_log"), (Episode, "_appraise")),
    "observation": ((explore_module, "observe"),),
    "info": ((ExploreEnv, "_info"),),
}
ON_THE_PAGE: dict[str, tuple[tuple[Any, str], ...]] = {
    "EKF predict, features in reach": ((StochasticMap, "prediction"),),
    "ambiguous features": ((kernels, "unambiguous"), (kernels, "hold_back")),
    "association": ((JudgedSlam, "associate"),),
    "EKF update, new features, covisibility": ((Slam, "_learn"),),
}
"""Instead of all that is taken at once, where the associator is none that `slam.at_once` knows."""
_EDGES = (0, 25, 50, 75, 100, 125, 150, 200, 300, 500, 1000)  # of the classes of map size
_BURST = 40  # steps, and calls of a peer, in turns
_FEWEST = 50  # steps that a class is shown from


def drive(env: Any, episodes: int, seed: int, beside: Callable[[], object] | None = None) -> list[Record]:
    """Time [µs] and number of mapped features of every step of explorations of test worlds 0, 1, …

    `beside` is called after every step.
    """
    steps = []
    for number in range(episodes):
        for step in explore(env, seed + number, world=number):
            steps.append({"µs": step.microseconds, "features": env.episode.slam.map.n})
            if beside is not None:
                beside()
    return steps


class Peers:
    """What steps are compared with, each timed as it runs by itself: many times, one right after the other.

    In turns with as many steps, since what runs in between has to be fetched anew, by the step as by its peers.
    """

    def __init__(self) -> None:
        self._calls: dict[str, Callable[[], object]] = {"CartPole": _stepped("CartPole-v1")}
        try:
            importlib.import_module("minigrid")  # registers its environments
            self._calls["MiniGrid"] = _stepped("MiniGrid-Empty-8x8-v0")
        except ImportError:
            pass
        W = np.asfortranarray(np.random.default_rng(0).standard_normal((203, 20)))
        P = np.eye(203, order="F")
        self._calls["rank-20 product, 203 columns"] = partial(dsyrk, -1.0, W, beta=1.0, c=P, overwrite_c=True)
        self._steps = 0
        self._taken: dict[str, list[float]] = {name: [] for name in self._calls}

    def __call__(self) -> None:
        self._steps += 1
        for name, call in self._calls.items() if self._steps % _BURST == 0 else ():
            self._taken[name].append(timed(_often, call, clock=THREAD).microseconds / _BURST)

    def table(self, step: float) -> list[Record]:
        """Medians [µs] beside that of a `step`, and how many of them a step takes."""
        rows = {"step": step} | {name: float(np.median(taken)) for name, taken in self._taken.items()}
        return [
            {"what": name, "median µs": µs, "a second": 1e6 / µs, "in a step": step / µs, "ratio": µs / step}
            for name, µs in rows.items()
        ]


def _often(call: Callable[[], object]) -> None:
    for _ in range(_BURST):
        call()


def _stepped(name: str) -> Callable[[], object]:
    """A random step of an environment without its wrappers, which is reset when need be."""
    env = gym.make(name).unwrapped
    env.reset(seed=0)
    actions = itertools.cycle(env.action_space.sample() for _ in range(97))

    def step() -> None:
        _, _, terminated, truncated, _ = env.step(next(actions))
        if terminated or truncated:
            env.reset()

    return step


@contextmanager
def timed_parts(spent: dict[str, float]) -> Iterator[None]:
    """Add the time [µs] of the calls in `PARTS` and `ON_THE_PAGE` to `spent` while the context lasts."""

    def wrapped(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            answer, microseconds = timed(partial(function, *arguments, **named), clock=THREAD)
            spent[name] += microseconds
            return answer

        return call

    places = [(name, owner, attribute) for name, calls in (PARTS | ON_THE_PAGE).items() for owner, attribute in calls]
    original = [(owner, attribute, getattr(owner, attribute)) for _, owner, attribute in places]
    for name, owner, attribute in places:
        setattr(owner, attribute, wrapped(name, getattr(owner, attribute)))
    try:
        yield
    finally:
        for owner, attribute, function in original:
            setattr(owner, attribute, function)


def by_size(steps: Sequence[Record]) -> list[Record]:
    """Steps per second by size of the map, from the median."""
    classes = {"all": steps, f"up to {SMALL}": [step for step in steps if step["features"] <= SMALL]}
    for low, high in itertools.pairwise(_EDGES):
        inside = [step for step in steps if low < step["features"] <= high]
        if len(inside) >= _FEWEST:
            classes[f"{low + 1} – {high}"] = inside
    rows = []
    for name, chosen in classes.items():
        middle, mean = (of(chosen, "µs")["µs"] for of in (medians, means))
        rows.append({"mapped features": name, "steps": len(chosen), "median µs": middle, "mean µs": mean})
        rows[-1]["steps/s"] = 1e6 / middle
    return rows


def by_part(spent: Mapping[str, float], steps: Sequence[Record]) -> list[Record]:
    """Where the time of a step goes."""
    total = float(column(steps, "µs").sum())
    parts = {**spent, "the rest": total - sum(spent.values())}
    return [{"part": part, "µs a step": µs / len(steps), "of the step": µs / total} for part, µs in parts.items()]


def run(
    report: Report, *, episodes: int = 5, scenario: str = "office", associator: str = "jcbb", seed: int = 0
) -> None:
    """Two passes over the same episodes: whole steps beside their peers, and their parts.

    Arguments:
        episodes: test worlds 0 … N−1
        scenario: by name
        associator: by name
        seed: of everything random
    """
    env = explorer(scenario, split="test", associator=associator)
    drive(env, 1, seed)  # compiles
    peers = Peers()
    steps = drive(env, episodes, seed, peers)
    report.table("Steps by the size of the map", by_size(steps), "step")
    small = medians([step for step in steps if step["features"] <= SMALL], "µs")["µs"]
    report.table(f"Steps in maps of up to {SMALL} features beside others", peers.table(small), "step_peers")
    spent: dict[str, float] = defaultdict(float)
    with timed_parts(spent):
        steps = drive(env, episodes, seed)
    report.table("Parts of a step", by_part(spent, steps), "step_parts")
