"""Drivers on the same test worlds: every agent drives every episode."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import gymnasium as gym

from agents.drivers.base import Agent, is_learned, make_agent
from agents.drivers.clairvoyant import Clairvoyant
from agents.evaluation.episodes import ExploreArguments, reset_arguments, run_episode
from agents.evaluation.pipeline import Evaluation, Results
from agents.evaluation.records import Key, Record
from agents.evaluation.tables import Column, Table, by_name, counted, display_name, estimates

LOST = Column("map_lost", "lost", 3, "lower", rare=True)
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
    model: str = ""
    trust: bool = False

    def make(self) -> Agent:
        return make_agent(self.agent, self.model or None, trust=self.trust)


def drivers_of(names: Sequence[str], models: Sequence[str], trust: bool) -> list[Driver]:
    """One driver a name; of learned ones, one a model file. A model alone adds `ppo` to the names."""
    names = list(dict.fromkeys(names))
    if models and not any(is_learned(name) for name in names):
        names.append("ppo")
    files = [str(Path(model).resolve()) for model in models]
    return [Driver(name, file, trust) for name in names for file in (is_learned(name) and files) or [""]]


@dataclass(frozen=True)
class DriverTask:
    """One episode to drive."""

    driver: Driver
    arguments: ExploreArguments
    episode: int

    @property
    def keys(self) -> tuple[Key, ...]:
        return (Key(self.driver.agent, world_of(self.arguments.plain), self.episode, self.driver.model),)

    def run(self, wanted: Sequence[Key]) -> list[Record]:
        agent = _agent(self.driver)
        record = run_episode(_env(self.arguments, agent.action), agent, self.episode)
        return [key._asdict() | record for key in wanted]


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
    models = {driver.model: _describe(Path(driver.model)) for driver in drivers if driver.model}
    tasks = [DriverTask(driver, arguments, k) for k in episodes for driver in drivers]
    return Evaluation("drivers", tasks, arguments.plain, {"models": models})


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


def world_of(conditions: Mapping[str, Any]) -> str:
    """What to call the world of an evaluation in a title: the name of the floor plan's file, or of the scenario."""
    floor: str | None = conditions["floor_plan"]
    return Path(floor).name if floor else str(conditions["scenario"])


def tables(results: Results) -> list[Table]:
    """The table, of the agents in the order in which they were asked for; models of one agent are pooled."""
    title = f"{world_of(results.conditions)}, {counted(results.frame['episode'].nunique(), 'episode')}"
    rows = {agent: estimates(own, COLUMNS) for agent, own in by_name(results.frame).items()}
    table = Table(title, "agent", COLUMNS, rows)
    if Clairvoyant.name not in rows:
        return [table]
    return [replace(table, caption=f"{table.caption}; clairvoyant is shown the plan: the upper reference")]


def kidnappings(results: Results) -> list[str]:
    """What became of the robots that were carried away, a line an agent; nothing of agents whose robot was not."""
    lines = []
    for agent, episodes in by_name(results.frame).items():
        own = episodes[episodes["kidnapped"] > 0.0]
        if own.empty:
            continue
        found = own[own["recovered"] > 0.0]
        line = f"{display_name(agent)}: carried away {len(own)}, recovered {len(found)}, never {len(own) - len(found)}"
        line += f", wrong relocations {own['relocations_wrong'].sum():.0f}"
        astray = f"; ticks astray {found['ticks_astray'].median():.0f} (median of the recovered)"
        lines.append(line + (astray if len(found) else ""))
    return lines
