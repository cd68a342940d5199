"""Explore-v0 steps per second in `twist` mode, against map size, and where the time of a step goes.

One process, one thread, compiled beforehand. Episodes on test worlds are driven by the map's own exploration (nearest
frontier, planned outside the clock); only `env.step` is timed. Every step is the whole tick: physics, scan, beams,
odometry, EKF with full covariance, JCBB, covisibility, explored grid, map error, observation, info. The parts are timed
in a second pass by wrapping their calls, which adds about a microsecond to each.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

from slam_gym.bench.exploration import explore, explorer
from slam_gym.bench.records import Record, column, means, medians
from slam_gym.bench.report import Report
from slam_gym.bench.timing import timed
from slam_gym.envs import explore as explore_module
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.metrics.association import Identities
from slam_gym.navigation.sweeps import MovableSweeps
from slam_gym.simulation.episode import Episode
from slam_gym.world.physics import World
from slam_gym.world.sensor import Sensor

SMALL = 100  # features: the headline is of steps in maps of up to so many
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
    "explored grid": ((MovableSweeps, "enter"),),
    "decisions judged": ((Identities, "update"),),
    "map error, coverage": ((Episode, "map_error"), (Episode, "coverage")),
    "observation": tuple((explore_module, f"encode_{name}") for name in ("scan", "features", "uncertainty", "image")),
}
_EDGES = (0, 25, 50, 75, 100, 125, 150, 200, 300, 500, 1000)  # of the classes of map size
_FEWEST = 50  # steps that a class is shown from


def drive(env: Any, episodes: int, seed: int) -> list[Record]:
    """Time [µs] and number of mapped features of every step of explorations of test worlds 0, 1, …"""
    return [
        {"µs": step.microseconds, "features": env.episode.slam.map.n}
        for number in range(episodes)
        for step in explore(env, seed + number, world=number)
    ]


@contextmanager
def timed_parts(spent: dict[str, float]) -> Iterator[None]:
    """Add the time [µs] of the calls in `PARTS` to `spent` while the context lasts."""

    def wrapped(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            answer, microseconds = timed(partial(function, *arguments, **named))
            spent[name] += microseconds
            return answer

        return call

    places = [(name, owner, attribute) for name, calls in PARTS.items() for owner, attribute in calls]
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
    parts = {**spent, "association and the rest": total - sum(spent.values())}
    return [{"part": part, "µs a step": µs / len(steps), "of the step": µs / total} for part, µs in parts.items()]


def run(
    report: Report, *, episodes: int = 5, scenario: str = "office", associator: str = "jcbb", seed: int = 0
) -> None:
    """Two passes over the same episodes: whole steps, and their parts.

    Arguments:
        episodes: test worlds 0 … N−1
        scenario: by name
        associator: by name
        seed: of everything random
    """
    env = explorer(scenario, split="test", associator=associator)
    drive(env, 1, seed)  # compiles
    report.table("Steps by the size of the map", by_size(drive(env, episodes, seed)), "step")
    spent: dict[str, float] = defaultdict(float)
    with timed_parts(spent):
        steps = drive(env, episodes, seed)
    report.table("Parts of a step", by_part(spent, steps), "step_parts")
