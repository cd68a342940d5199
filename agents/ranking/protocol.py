"""The frozen protocol: on which worlds an entry is judged, by what, and the tasks that do it.

What an entry loses is a number in an episode, 0 at best: the map's error where something is driven, 1 − score in the
suite. A column is an experiment or a scenario; the mean over columns ranks.
"""

from __future__ import annotations

import functools
import hashlib
import json
from typing import Any, Literal, NamedTuple

import gymnasium as gym

from agents.drivers.base import Agent, make_agent
from agents.evaluation.episodes import ExploreArguments, run_episode
from agents.evaluation.pipeline import Evaluation, Key, Task
from agents.evaluation.records import Record
from agents.ranking.entry_process import EntryAgent, EntryError, EntryProcess, associate_in, relocate_in
from agents.suite.worlds import associate, relocate
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION
from slam_gym.simulation.judged import CEILING

Role = Literal["agent", "associator", "relocator"]
Parts = dict[str, int]
"""Scenarios and levels of the suite (EXPERIMENT/NUMBER), and how many worlds of each."""

VERSION = 3
"""Of the protocol: raised with any change of what follows, of the floors, or of how an episode is run."""

SPLIT = "test"
FIRST = 1000  # of its worlds: those before it are looked at while somebody develops, and tell less
PROBLEMS = 12  # of a world of the suite, at most
DRIVER = "information_gain"  # where the entry does not drive
LOST = 1.0
"""The loss of an episode in which the entry fails: that of an empty map."""

_CALM = ("office-small", "office", "aliased", "hall", "crowd")
_DRIFT = ("drift-1", "drift-2", "drift-3", "aliased-drift", "hall-drift", "crowd-drift")
_SUITE = [level.id for name, experiment in EXPERIMENTS.items() if name != RELOCATION for level in experiment.levels]
_KIDNAPPED = [level.id for level in EXPERIMENTS[RELOCATION].levels]

PARTS: dict[Role, Parts] = {
    "agent": dict.fromkeys((*_CALM, "drift-1", "drift-2", "drift-3"), 8),
    "associator": dict.fromkeys(_SUITE, 4) | dict.fromkeys(_DRIFT, 6),
    "relocator": dict.fromkeys(_KIDNAPPED, 8) | dict.fromkeys(("kidnapped", "drift-2", "drift-3", "aliased-drift"), 6),
}
QUICK: dict[Role, Parts] = {
    "agent": {"office-small": 1},
    "associator": {"clutter/1": 1, "office-small": 1},
    "relocator": {"kidnapped/0": 1, "office-small": 1},
}
"""For tests: ranked among themselves only."""


class Protocol(NamedTuple):
    """What an entry of a role is put through."""

    role: Role
    quick: bool = False

    @property
    def parts(self) -> Parts:
        """Its settings, and how many worlds of each."""
        return (QUICK if self.quick else PARTS)[self.role]

    @property
    def about(self) -> dict[str, Any]:
        """Which protocol it is: only entries of the same `hash` are compared."""
        frozen = json.dumps([VERSION, SPLIT, FIRST, PROBLEMS, DRIVER, self.role, self.parts])
        found = hashlib.sha256(frozen.encode()).hexdigest()[:16]
        return {"version": VERSION, "role": self.role, "quick": self.quick, "hash": found}


def column_of(setting: str) -> str:
    """What a setting is counted under."""
    return setting.partition("/")[0]


def lose(entry: str, role: Role, setting: str, episode: int) -> list[Record]:
    """The record of one world of one setting: what the entry loses there, and how it failed if it did."""
    try:
        if "/" not in setting:
            agent, env = _loop(entry, role, setting)
            return [{"loss": float(run_episode(env, agent, episode)["map_error"])}]
        ask, asked = relocate if role == "relocator" else associate, {entry: _searcher(entry, role)}
        return [{"loss": 1.0 - ask(setting, episode, asked, PROBLEMS, SPLIT)[entry]["score"]}]
    except EntryError as error:
        return [{"loss": LOST, "failed": str(error)}]


@functools.lru_cache(maxsize=4)
def process(role: Role, name: str) -> EntryProcess:
    """The process of an entry, one for each process of the evaluation."""
    return EntryProcess(role, name)


def _searcher(name: str, role: Role) -> Any:
    """An associator or relocator in its own process; `true_association` is told the truth, which no process gets."""
    if name == CEILING:
        return CEILING
    return functools.partial(associate_in if role == "associator" else relocate_in, process(role, name))


@functools.lru_cache(maxsize=2)
def _loop(name: str, role: Role, scenario: str) -> tuple[Agent, gym.Env[Any, Any]]:
    """Who drives, and the environment; what the entry does not do is done by the baselines."""
    agent: Agent = EntryAgent(process("agent", name)) if role == "agent" else make_agent(DRIVER)
    others = {"associator": "associator", "relocator": "relocation"}
    own = {others[role]: _searcher(name, role)} if role in others else {}
    return agent, ExploreArguments(scenario, split=SPLIT).make(agent.action, **own)


def leaderboard_evaluation(name: str, chosen: Protocol) -> Evaluation:
    """An entry through the protocol."""
    keys = [Key(name, setting, FIRST + k) for setting, count in chosen.parts.items() for k in range(count)]
    tasks = [Task([key], functools.partial(lose, name, chosen.role, key.setting, key.episode)) for key in keys]
    return Evaluation("leaderboard", tasks, {"entry": name} | chosen.about)
