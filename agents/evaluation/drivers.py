"""Drivers on the same test worlds: every agent drives every episode."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from agents.drivers.base import Agent, is_learned, make_agent
from agents.drivers.clairvoyant import Clairvoyant
from agents.evaluation.episodes import ExploreArguments, reset_arguments, run_episode
from agents.evaluation.headline import LOST
from agents.evaluation.pipeline import DRIVERS, Evaluation, Results
from agents.evaluation.records import Key, Record
from agents.evaluation.tables import Column, Rows, Table, by_name, counted, display_name, estimates

COLUMNS = (
    Column("map_error", "map error", 3, "lower"),
    Column("local_error", "local error", 3, "lower"),
    Column("coverage", "coverage", 3, "higher"),
    Column("precision", "precision", 3, "higher"),
    Column("recall", "recall", 3, "higher"),
    Column("anees", "ANEES", 2),
    LOST,
    Column("ticks", "ticks", 0),
    Column("ticks_per_second", "ticks/s", 0),
)


@dataclass(frozen=True)
class Driver:
    """An agent, and the model file behind it if it is learned."""

    agent: str
    model: str | None = None
    trust: bool = False

    def make(self) -> Agent:
        return make_agent(self.agent, self.model, trust=self.trust)


def drivers_of(names: Sequence[str], models: Sequence[str], trust: bool) -> list[Driver]:
    """One driver a name; of learned ones, one a model file. A model alone adds `ppo` to the names."""
    names = list(dict.fromkeys(names))
    if models and not any(is_learned(name) for name in names):
        names.append("ppo")
    files: list[str | None] = [str(Path(model).resolve()) for model in models]
    none: list[str | None] = [None]
    return [Driver(name, file, trust) for name in names for file in (is_learned(name) and files) or none]


@dataclass(frozen=True)
class DriverTask:
    """One episode to drive."""

    driver: Driver
    arguments: ExploreArguments
    episode: int

    @property
    def keys(self) -> tuple[Key, ...]:
        return (Key(self.driver.agent, None, self.episode, self.driver.model),)

    def run(self, wanted: Sequence[Key]) -> list[Record]:
        agent = _agent(self.driver)
        record = run_episode(_env(self.arguments, agent.action), agent, self.episode)
        return [{"agent": self.driver.agent, "model": self.driver.model} | record]


# Agent and environment are kept for the next task of the same process.
@lru_cache(maxsize=8)
def _agent(driver: Driver) -> Agent:
    return driver.make()


@lru_cache(maxsize=2)
def _env(arguments: ExploreArguments, action: str) -> gym.Env[Any, Any]:
    return arguments.make(action)


def driver_evaluation(drivers: Sequence[Driver], arguments: ExploreArguments, episodes: Sequence[int]) -> Evaluation:
    """Every driver in every episode, checked. ValueError for whatever nobody knows; models are loaded for that."""
    for action in sorted({driver.make().action for driver in drivers}):
        _warm_up(arguments.make(action), episodes[0])
    about = {
        "models": {driver.model: _describe(Path(driver.model)) for driver in drivers if driver.model},
        "seeds": [reset_arguments(k) for k in episodes],
    }
    tasks = [DriverTask(driver, arguments, k) for k in episodes for driver in drivers]
    return Evaluation(DRIVERS, tasks, arguments.plain, lambda records: {"table": rows(records)}, about)


def _warm_up(env: gym.Env[Any, Any], episode: int) -> None:
    """Compile the inner loops once instead of in every worker."""
    env.reset(**reset_arguments(episode))
    env.step(0 if isinstance(env.action_space, gym.spaces.Discrete) else env.action_space.sample())
    env.close()


def _describe(model: Path) -> dict[str, Any]:
    """Hash of a model file, and what it says of its training."""
    known: dict[str, Any] = {"sha256": hashlib.sha256(model.read_bytes()).hexdigest()}
    from agents.learning.models import read_about  # torch is imported for learned agents only

    try:
        about = read_about(model)
    except ValueError:  # a file that is trusted
        return known
    return known | {"training": about.training | {"timesteps": about.timesteps}}


def rows(records: Sequence[Record]) -> Rows:
    """Agent → column → estimate; models of one agent are pooled."""
    return {agent: estimates(own, COLUMNS) for agent, own in by_name(records, "agent").items()}


def world_of(conditions: Mapping[str, Any]) -> str:
    """What to call the world of an evaluation in a title: the name of the floor plan's file, or of the scenario."""
    floor: str | None = conditions["floor_plan"]
    return Path(floor).name if floor else str(conditions["scenario"])


def tables(results: Results) -> list[Table]:
    """The table, of the agents in the order in which they were asked for."""
    title = f"{world_of(results.content['conditions'])}, {counted(results.content['asked']['episodes'], 'episode')}"
    table = Table(title, "agent", COLUMNS, rows(results.records))
    if Clairvoyant.name not in table.rows:
        return [table]
    return [replace(table, caption=f"{table.caption}; clairvoyant is shown the plan: the upper reference")]


def kidnappings(results: Results) -> list[str]:
    """What became of the robots that were carried away, a line an agent; nothing of agents whose robot was not."""
    lines = []
    for agent, records in by_name(results.records, "agent").items():
        if not (own := [record for record in records if record.get("kidnapped")]):
            continue
        found = [record["ticks_astray"] for record in own if record["recovered"]]
        line = f"{display_name(agent)}: carried away {len(own)}, recovered {len(found)}, never {len(own) - len(found)}"
        line += f", wrong relocations {sum(record['relocations_wrong'] for record in own):.0f}"
        lines.append(line + (f"; ticks astray {np.median(found):.0f} (median of the recovered)" if found else ""))
    return lines
