"""Associators in the loop: the same driver on the same test worlds, with each associator in turn."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import pandas as pd

from agents.drivers.base import Agent, make_agent
from agents.evaluation.drivers import LOST
from agents.evaluation.episodes import LOST_MEANS, ExploreArguments, run_episode
from agents.evaluation.pipeline import Evaluation, Results
from agents.evaluation.records import Key, Record
from agents.evaluation.tables import (
    Column,
    Rows,
    Table,
    Value,
    by_name,
    by_setting,
    counted,
    difference,
    estimate_of,
    estimates,
)
from slam_gym.association import ASSOCIATORS, resolve_associator
from slam_gym.association.prediction import Associator, Prediction
from slam_gym.metrics.statistics import mean
from slam_gym.simulation.judged import CEILING
from slam_gym.types import Hypothesis, Scan

COLUMNS = (
    Column("precision", "precision", 3, "higher"),
    Column("recall", "recall", 3, "higher"),
    Column("f1", "F1", 3, "higher", optional=True),
    Column("exact", "exact", 3, "higher"),
    Column("duplicates", "dupl.", 1, "lower"),
    Column("nodes", "nodes", 0),
    Column("microseconds", "µs/scan", 0, "lower"),
    Column("map_error", "map error", 3, "lower"),
    Column("local_error", "local error", 3, "lower", optional=True),
    Column("anees", "ANEES", 2),
)
RELOCATION_COLUMNS = (
    Column("recovered", "recovered", 2, "higher"),
    Column("relocations_wrong", "wrong reloc.", 1, "lower", optional=True),
    Column("ticks_astray", "ticks astray", 0, "lower", optional=True),
)
BEFORE_RELOCATION = tuple(column for column in COLUMNS if column.key not in ("f1", "nodes", "duplicates"))

SIMPLEST_FIRST = (
    "nearest_neighbour", "global_nearest_neighbour", "singles", "one_point_ransac", "jcbb", "ipjc", "map_hypothesis",
    "marginal", "learned",
)  # fmt: skip
JOIN = " + "
"""Between an associator and the search that finds a lost robot for it, in the name of what was evaluated."""


def shipped() -> list[str]:
    """The associators that ship, in the order of tables: from the simplest to the truth."""
    known = [name for name in SIMPLEST_FIRST if name in ASSOCIATORS]
    return [*known, *(name for name in ASSOCIATORS if name not in (*known, CEILING)), CEILING]


@lru_cache
def find_associator(name: str) -> Associator:
    """An associator by name, `module:function`, or the file of a learned one. ValueError lists the known names."""
    if Path(name).suffix == ".zip":
        from agents.learning.models import load_associator  # torch is imported for learned associators only

        return load_associator(Path(name))
    return resolve_associator(name)


class Metered:
    """An associator, and what its calls take since the last `reset`."""

    def __init__(self, associate: Associator) -> None:
        self._associate = associate
        self.reset()

    def reset(self) -> None:
        self.nodes: list[int] = []
        self.seconds: list[float] = []
        self.limits = 0  # calls that met the limit of their search

    def __call__(self, scan: Scan, prediction: Prediction) -> Hypothesis:
        start = time.perf_counter()
        hypothesis = self._associate(scan, prediction)
        self.seconds.append(time.perf_counter() - start)
        self.nodes.append(hypothesis.effort.nodes)
        self.limits += hypothesis.effort.limit_hit
        return hypothesis

    def effort(self) -> Record:
        """Means a scan; of the time the median, which does not see the first call being compiled. NaN without calls."""
        if not self.seconds:
            return dict.fromkeys(("nodes", "microseconds", "limits"), float("nan"))
        return {
            "nodes": float(np.mean(self.nodes)),
            "microseconds": 1e6 * float(np.median(self.seconds)),
            "limits": float(self.limits),
        }


def metered(associator: str | Associator) -> tuple[Metered, Associator | str]:
    """A meter, and what to associate with: the metered associator, or the name of the one that is told the truth,
    which nothing may stand in for and whose meter stays empty."""
    if associator == CEILING:
        return Metered(ASSOCIATORS[CEILING]), CEILING
    meter = Metered(find_associator(associator) if isinstance(associator, str) else associator)
    return meter, meter


@dataclass(frozen=True)
class AssociatorTask:
    """One episode with one associator."""

    associator: str
    arguments: ExploreArguments
    driver: str
    episode: int
    name: str  # of the associator, with its relocation where there are several

    @property
    def keys(self) -> tuple[Key, ...]:
        return (Key(self.name, self.arguments.scenario, self.episode),)

    def run(self, wanted: Sequence[Key]) -> list[Record]:
        env, meter = _loop(self.associator, self.arguments, self.driver)
        meter.reset()
        driven = run_episode(env, _driver(self.driver), self.episode)
        driven.pop("curve")
        tally: Any = env.unwrapped.episode.identities.total  # type: ignore[attr-defined]
        numbers = driven | {"f1": tally.f1, "exact": tally.exact} | asdict(tally) | meter.effort()
        return [key._asdict() | numbers for key in wanted]


class _Loop(NamedTuple):
    env: gym.Env[Any, Any]
    meter: Metered  # on its associator


@lru_cache(maxsize=4)
def _loop(associator: str, arguments: ExploreArguments, driver: str) -> _Loop:
    meter, associate = metered(associator)
    return _Loop(arguments.make(_driver(driver).action, associator=associate), meter)


@lru_cache(maxsize=2)
def _driver(name: str) -> Agent:
    return make_agent(name)


def with_relocation(associator: str, relocation: str | None) -> str:
    """What an associator is called beside itself with another relocation."""
    return associator if relocation is None else f"{associator}{JOIN}{relocation}"


def associator_evaluation(
    associators: Sequence[str],
    loops: Sequence[ExploreArguments],
    driver: str,
    episodes: Sequence[int],
    relocations: Sequence[str | None],
) -> Evaluation:
    """Every associator in every loop, with each of the `relocations`, checked.

    ValueError for an associator, scenario, driver or relocator that nobody knows.
    """
    tasks = []
    for arguments in loops:
        kinds = [replace(arguments, relocation=relocation) for relocation in relocations]
        for associator in associators:
            for kind in kinds:
                _loop(associator, kind, driver)
        tasks += [
            AssociatorTask(name, kind, driver, k, with_relocation(name, kind.relocation) if len(kinds) > 1 else name)
            for k in episodes for name in associators for kind in kinds
        ]  # fmt: skip
    shared = {name: loops[0].plain[name] for name in ("split", "overrides", "floor_plan", "resolution")}
    return Evaluation("associators", tasks, {"driver": driver, "relocation": list(relocations)} | shared)


def tables(results: Results) -> list[Table]:
    """One table a scenario, with the associators in the order in which they were asked for; then the headline."""
    return [*scenario_tables(results), *headline(results.frame)]


def scenario_tables(results: Results) -> list[Table]:
    """One table a scenario; where a robot was carried away, some columns are about relocation."""
    conditions = results.conditions
    floor = f" on {Path(conditions['floor_plan']).name}" if conditions.get("floor_plan") else ""
    found = []
    for setting, own in by_setting(results.frame).items():
        columns = BEFORE_RELOCATION + RELOCATION_COLUMNS if own["kidnapped"].any() else COLUMNS
        rows = {name: estimates(episodes, columns) for name, episodes in by_name(own).items()}
        count = counted(own["episode"].nunique(), "episode")
        found.append(Table(f"{setting}{floor}, {count}, driven by {conditions['driver']}", "associator", columns, rows))
    return found


# -- whose map survives ----------------------------------------------------------------------------------------------


def headline(frame: pd.DataFrame) -> list[Table]:
    """Two tables: mean map errors and lost maps, and paired differences to the truth with the same relocation."""
    columns = [Column(setting, setting, 3, "lower") for setting in by_setting(frame)]
    overall = Column("mean", "mean", 3, "lower")
    groups = by_name(frame)
    rows: Rows = {name: _errors(own) for name, own in groups.items()}
    caption = f"mean map error, 95 % bootstrap interval; {LOST_MEANS}"
    all_columns = [*columns, overall, Column("median", "median", 3, "lower"), LOST]
    found = [Table("Map error", "associator", all_columns, rows, caption)]
    gaps = {name: _gaps(own, groups[truth]) for name, own in groups.items() if (truth := _truth_for(name)) in groups}
    if gaps:
        caption = "mean over the same episodes, 95 % bootstrap interval"
        title = "Map error above that of true association with the same relocation"
        found.append(Table(title, "associator", [*columns, overall], gaps, caption, differences=True))
    return found


def _errors(frame: pd.DataFrame) -> dict[str, Value]:
    """Scenario → mean map error; and of all scenarios the mean, the median and the fraction of lost maps."""
    by_scenario = {name: estimate_of(own, "map_error", mean) for name, own in by_setting(frame).items()}
    errors, lost = estimate_of(frame, "map_error", mean), estimate_of(frame, "map_lost", mean)
    return {**by_scenario, "mean": errors, "median": float(frame["map_error"].median()), "map_lost": lost}


def _truth_for(name: str) -> str:
    """The truth that a name is held against: that with the same relocation; none for the truth itself."""
    associator, join, relocation = name.partition(JOIN)
    return f"{CEILING}{join}{relocation}" if associator != CEILING else ""


def _gaps(frame: pd.DataFrame, truth: pd.DataFrame) -> dict[str, Value]:
    of_truth = by_setting(truth)
    found = {name: difference(own, of_truth[name], "map_error", mean) for name, own in by_setting(frame).items()}
    return {**found, "mean": difference(frame, truth, "map_error", mean)}
