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

from agents.drivers.base import Agent, make_agent
from agents.evaluation.episodes import ExploreArguments, run_episode
from agents.evaluation.headline import headline, subject
from agents.evaluation.pipeline import ASSOCIATORS as KIND
from agents.evaluation.pipeline import Evaluation, Results
from agents.evaluation.records import Key, Record
from agents.evaluation.tables import Column, Rows, Table, by_name, by_setting, counted, estimates
from slam_gym.association import ASSOCIATORS, resolve_associator
from slam_gym.simulation.judged import CEILING
from slam_gym.types import Associator, Hypothesis, Prediction, Scan

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
            return dict.fromkeys(("nodes", "microseconds", "microseconds_p99", "limits"), float("nan"))
        microseconds = 1e6 * np.array(self.seconds)
        return {
            "nodes": float(np.mean(self.nodes)),
            "microseconds": float(np.median(microseconds)),
            "microseconds_p99": float(np.quantile(microseconds, 0.99)),
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
        tally: Any = env.unwrapped.tally  # type: ignore[attr-defined]
        record = {"associator": self.name, "setting": self.arguments.scenario} | driven
        return [record | {"f1": tally.f1, "exact": tally.exact} | asdict(tally) | meter.effort()]


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


def associator_evaluation(
    associators: Sequence[str],
    loops: Sequence[ExploreArguments],
    driver: str,
    episodes: Sequence[int],
    relocations: Sequence[str | None] | None = None,
) -> Evaluation:
    """Every associator in every loop, with each of the `relocations` (default: that of each loop), checked.

    ValueError for an associator, scenario, driver or relocator that nobody knows.
    """
    compared = relocations is not None and len(relocations) > 1
    tasks = []
    for arguments in loops:
        kinds = [arguments] if relocations is None else [replace(arguments, relocation=r) for r in relocations]
        for associator in associators:
            for kind in kinds:
                _loop(associator, kind, driver)
        tasks += [
            AssociatorTask(name, kind, driver, k, subject(name, kind.relocation) if compared else name)
            for k in episodes for name in associators for kind in kinds
        ]  # fmt: skip
    plain = loops[0].plain
    found = {"relocation": plain["relocation"] if relocations is None else list(relocations)}
    conditions = (
        {"driver": driver} | found | {name: plain[name] for name in ("split", "overrides", "floor_plan", "resolution")}
    )
    return Evaluation(KIND, tasks, conditions, lambda records: {"table": numbers(records)})


def columns_for(records: Sequence[Record]) -> tuple[Column, ...]:
    """The columns of the table; where a robot was carried away, some are about relocation."""
    carried = any(record.get("kidnapped") for record in records)
    return BEFORE_RELOCATION + RELOCATION_COLUMNS if carried else COLUMNS


def rows(records: Sequence[Record]) -> Rows:
    """Associator → column → estimate."""
    columns = columns_for(records)
    return {name: estimates(own, columns) for name, own in by_name(records, "associator").items()}


def numbers(records: Sequence[Record]) -> dict[str, Rows]:
    """Scenario → associator → column → estimate; `all` pools the scenarios, resampling within each."""
    found = {setting: rows(own) for setting, own in by_setting(records).items()}
    return found | {"all": rows(records)} if len(found) > 1 else found


def tables(results: Results) -> list[Table]:
    """One table a scenario, with the associators in the order in which they were asked for; then the headline."""
    return [*scenario_tables(results), *headline(results.records)]


def scenario_tables(results: Results) -> list[Table]:
    """One table a scenario."""
    conditions, episodes = results.content["conditions"], results.content["asked"]["episodes"]
    floor = f" on {Path(conditions['floor_plan']).name}" if conditions.get("floor_plan") else ""
    return [
        Table(
            f"{setting}{floor}, {counted(episodes, 'episode')}, driven by {conditions['driver']}",
            "associator",
            columns_for(own),
            rows(own),
        )
        for setting, own in by_setting(results.records).items()
    ]
