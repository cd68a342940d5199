"""The episodes of the protocol as tasks: the entry's decisions come from its own process."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym

from agents.drivers.base import Agent, make_agent
from agents.evaluation.episodes import run_episode
from agents.evaluation.log_measures import measure
from agents.evaluation.mapped_log import map_log
from agents.evaluation.pipeline import LEADERBOARD, Evaluation
from agents.evaluation.recordings import Log
from agents.evaluation.records import Key, Record
from agents.ranking.protocol import DRIVER, PROBLEMS, SPLIT, Part, Protocol
from agents.ranking.served import Role, ServedAgent, ServedAssociator, ServedRelocator, entry
from agents.suite.worlds import WorldTask
from slam_gym.association import ASSOCIATORS
from slam_gym.scenarios.recorded import slam_for
from slam_gym.simulation.judged import CEILING
from slam_gym.slam.relocate import SEARCH
from slam_gym.types import Associator, Relocator

_KEPT = ("map_error", "map_lost", "coverage", "precision", "recall", "exact", "spoiled", "f1", "ate")


@dataclass(frozen=True)
class EntryTask:
    """One world of one part."""

    entry: str
    role: Role
    part: Part
    world: int

    @property
    def keys(self) -> tuple[Key, ...]:
        return (Key(self.entry, self.part.setting, self.world),)

    def run(self, wanted: Sequence[Key]) -> list[Record]:
        found = {"suite": self._suite, "log": self._log}.get(self.part.kind, self._drive)()
        loss, kept = _loss(self.part, found), {name: found[name] for name in _KEPT if name in found}
        about = {"entry": self.entry, "setting": self.part.setting, "episode": self.world, "column": self.part.column}
        return [about | {"loss": loss} | kept]

    def _drive(self) -> Record:
        agent, env = _loop(self.entry, self.role, self.part)
        driven = run_episode(env, agent, self.world)
        driven.pop("curve")
        return driven

    def _suite(self) -> Record:
        task = WorldTask(self.part.setting, self.world, (self.entry,), PROBLEMS, SPLIT)
        if self.role == "relocator":
            return task.relocate({self.entry: ServedRelocator(entry("relocator", self.entry))})[self.entry]
        return task.associate({self.entry: _associator(self.entry)})[self.entry]

    def _log(self) -> Record:
        log = Log(self.part.setting).open()
        return measure(log, map_log(log, _told(self.entry), slam_for(log), SEARCH))


def _loss(part: Part, record: Record) -> float:
    if part.kind == "suite":
        return 1.0 - float(record["score"])
    return 1.0 - float(record["f1"]) if part.kind == "log" else float(record["map_error"])


def _associator(name: str) -> Associator:
    """An associator in its own process; `true_association` is told the truth, which no process gets."""
    return ASSOCIATORS[CEILING] if name == CEILING else ServedAssociator(entry("associator", name))


def _told(name: str) -> Associator | str:
    return CEILING if name == CEILING else _associator(name)


@functools.lru_cache(maxsize=2)
def _loop(name: str, role: Role, part: Part) -> tuple[Agent, gym.Env[Any, Any]]:
    """Who drives, and the environment; what the entry does not do is done by the baselines."""
    agent: Agent = ServedAgent(entry("agent", name)) if role == "agent" else make_agent(DRIVER)
    associator = _told(name) if role == "associator" else None
    relocation: Relocator | str = ServedRelocator(entry("relocator", name)) if role == "relocator" else SEARCH
    return agent, part.arguments().make(agent.action, associator=associator, relocation=relocation)


def leaderboard_evaluation(name: str, chosen: Protocol) -> Evaluation:
    """An entry through the protocol."""
    tasks = [EntryTask(name, chosen.role, part, world) for part in chosen.parts for world in part.worlds]
    conditions = {"entry": name} | chosen.about
    return Evaluation(LEADERBOARD, tasks, conditions, lambda records: {})
