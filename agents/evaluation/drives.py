"""Associators in the loop: the same driver on the same test worlds, with each of them in turn."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import gymnasium as gym
import numpy as np

import slam_gym  # noqa: F401  (registers the environments)
from agents.drivers.base import make_agent
from agents.evaluation.associators import CEILING, Key, Task, find_associator, row
from agents.evaluation.results import Column, Record
from agents.evaluation.rollout import ENV_ID, run_episode
from slam_gym.scenarios import Scenario, get_scenario
from slam_gym.types import Hypothesis, Prediction, Scan

COLUMNS = (
    Column("precision", "precision", 3, "higher"),
    Column("recall", "recall", 3, "higher"),
    Column("f1", "F1", 3, "higher"),
    Column("exact", "exact", 3, "higher"),
    Column("duplicates", "dupl.", 1, "lower"),
    Column("nodes", "nodes", 0),
    Column("microseconds", "µs/scan", 0, "lower"),
    Column("map_error", "map error", 3, "lower"),
    Column("anees", "ANEES", 2),
)
RELOCATION = (
    Column("recovered", "recovered", 2, "higher"),
    Column("relocations_wrong", "wrong reloc.", 1, "lower"),
    Column("ticks_astray", "ticks astray", 0, "lower"),
)


class Metered:
    """An associator, and what its calls take since the last `reset`."""

    def __init__(self, associate: Callable[..., Hypothesis]) -> None:
        self.func = getattr(associate, "func", associate)  # whose calls these are, for those who know it
        self._associate = associate
        self.reset()

    def reset(self) -> None:
        self.nodes: list[int] = []
        self.seconds: list[float] = []
        self.limits = 0

    def __call__(self, scan: Scan, prediction: Prediction) -> Hypothesis:
        start = time.perf_counter()
        hypothesis = self._associate(scan, prediction)
        self.seconds.append(time.perf_counter() - start)
        self.nodes.append(hypothesis.effort.nodes)
        self.limits += hypothesis.effort.limit_hit
        return hypothesis


@dataclass(frozen=True)
class Course:
    """Who drives, where, and how a lost robot is found."""

    setting: str  # a scenario, or a level of the suite
    driver: str = "nearest_frontier"
    relocation: str | None = None
    split: str = "test"

    @property
    def scenario(self) -> Scenario:
        """ValueError with the known names where there is none."""
        return get_scenario(self.setting)


@dataclass(frozen=True)
class Drive:
    """One episode with one associator."""

    associator: str
    course: Course
    episode: int

    @property
    def keys(self) -> tuple[Key, ...]:
        return ((self.associator, self.course.setting, self.episode),)

    def without(self, done: set[Key]) -> Task | None:
        return None if self.keys[0] in done else self

    def run(self) -> list[Record]:
        env, meter = _env(self.associator, self.course)
        if meter is not None:
            meter.reset()
        driven = run_episode(env, _driver(self.course.driver), self.episode)
        driven.pop("curve")
        tally: Any = env.unwrapped.tally  # type: ignore[attr-defined]
        record: Record = {"associator": self.associator, "setting": self.course.setting} | driven
        record |= {"f1": tally.f1, "exact": tally.exact} | asdict(tally)
        return [record | _effort(meter)]


def _effort(meter: Metered | None) -> dict[str, float]:
    """Means a scan; of the time the median, which does not see the first call being compiled."""
    if meter is None or not meter.seconds:
        return dict.fromkeys(("nodes", "microseconds", "microseconds_p99", "limits"), float("nan"))
    seconds = 1e6 * np.array(meter.seconds)
    return {
        "nodes": float(np.mean(meter.nodes)),
        "microseconds": float(np.median(seconds)),
        "microseconds_p99": float(np.quantile(seconds, 0.99)),
        "limits": float(meter.limits),
    }


@lru_cache(maxsize=4)
def _env(associator: str, course: Course) -> tuple[gym.Env[Any, Any], Metered | None]:
    """The environment, and the meter on its associator. The true one is handed the truth by the environment alone."""
    scenario = course.scenario
    meter = None if associator == CEILING else Metered(find_associator(associator))
    env = gym.make(
        ENV_ID, scenario=scenario, split=course.split, associator=meter or associator, relocation=course.relocation,
        action=_driver(course.driver).action, disable_env_checker=True,
    )  # fmt: skip
    return env, meter


@lru_cache(maxsize=2)
def _driver(name: str) -> Any:
    return make_agent(name)


def drives(associators: Sequence[str], courses: Sequence[Course], episodes: int) -> list[Drive]:
    """All of them, checked. ValueError for an associator, scenario, driver or relocator that nobody knows."""
    for course in courses:
        for associator in associators:
            _env(associator, course)
    return [Drive(name, course, k) for course in courses for k in range(episodes) for name in associators]


def columns_for(records: Sequence[Record]) -> tuple[Column, ...]:
    """The columns of the table; where a robot was carried away, some are about relocation."""
    if not any(record.get("kidnapped") for record in records):
        return COLUMNS
    return tuple(column for column in COLUMNS if column.key not in ("f1", "nodes", "duplicates")) + RELOCATION


def tables(records: Sequence[Record], associators: Sequence[str], settings: Sequence[str]) -> dict[str, Any]:
    """Setting → associator → column → estimate; `all` pools the settings, resampling within each."""
    groups: dict[str, str | None] = {setting: setting for setting in settings}
    if len(settings) > 1:
        groups["all"] = None
    return {
        label: {
            name: row(records, name, setting, columns_for(_within(records, setting))) for name in associators
        }
        for label, setting in groups.items()
    }  # fmt: skip


def _within(records: Sequence[Record], setting: str | None) -> list[Record]:
    return [record for record in records if setting in (None, record["setting"])]
