"""The frozen protocol: the worlds in which an entry is evaluated, its losses, and the tasks of the evaluation.

The loss of an episode is 0 at best: the map error of a drive, or 1 − score in the suite. A column is an experiment or a
scenario; the mean over columns determines the rank.
"""

import functools
import hashlib
import json
from typing import Any, NamedTuple

import gymnasium as gym

from agents.drivers.base import Agent, make_agent
from agents.evaluation.associators import hashes_of
from agents.evaluation.episodes import ExploreArguments, run_episode
from agents.evaluation.pipeline import Evaluation, Key, Task
from agents.evaluation.records import Record
from agents.options import Role
from agents.ranking.entry_process import EntryAgent, EntryError, EntryProcess, associate_in, relocate_in
from agents.suite import evaluate
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION
from slam_gym.simulation.judged import CEILING

Parts = dict[str, int]
"""Scenarios and levels of the suite (EXPERIMENT/NUMBER), with the number of worlds of each."""

VERSION = 4
"""Version of the protocol, raised with any change of what follows, of the floors, or of the run of an episode."""

SPLIT = "test"
FIRST = 1000  # number of its first world; earlier worlds are used in development, and may be overfitted
PROBLEMS = 12  # largest number in a world of the suite
DRIVER = "information_gain"  # of entries that are not agents
LOST = 1.0
"""The loss of an episode in which the entry fails, which is the loss of an empty map."""

_CALM = ("office-small", "office", "aliased", "hall", "crowd")
_DRIFT = ("drift-1", "drift-2", "drift-3", "aliased-drift", "hall-drift", "crowd-drift")
_SUITE = [level.id for name, experiment in EXPERIMENTS.items() if name != RELOCATION for level in experiment.levels]
_KIDNAPPED = [level.id for level in EXPERIMENTS[RELOCATION].levels]

PARTS: dict[Role, Parts] = {
    "associator": dict.fromkeys(_SUITE, 4) | dict.fromkeys(_DRIFT, 6),
    "relocator": dict.fromkeys(_KIDNAPPED, 8) | dict.fromkeys(("kidnapped", "drift-2", "drift-3", "aliased-drift"), 6),
    "agent": dict.fromkeys((*_CALM, "drift-1", "drift-2", "drift-3"), 8),
}
QUICK: dict[Role, Parts] = {
    "agent": {"office-small": 1},
    "associator": {"clutter/1": 1, "drift-2": 1},
    "relocator": {"kidnapped/0": 1, "drift-2": 1},
}
"""Short protocols, to try an entry: the first worlds of some settings of the whole one."""


class Protocol(NamedTuple):
    """The protocol for entries of a role."""

    role: Role
    quick: bool = False

    @property
    def parts(self) -> Parts:
        """Its settings, with the number of worlds of each."""
        return (QUICK if self.quick else PARTS)[self.role]

    @property
    def about(self) -> dict[str, Any]:
        """The identity of the protocol. Only entries with the same `hash` are compared."""
        frozen = json.dumps([VERSION, SPLIT, FIRST, PROBLEMS, DRIVER, self.role, self.parts])
        digest = hashlib.sha256(frozen.encode()).hexdigest()[:16]
        return {"version": VERSION, "role": self.role, "quick": self.quick, "hash": digest}


def column_of(setting: str) -> str:
    """The column in which a setting counts."""
    return setting.partition("/")[0]


def lose(entry: str, role: Role, setting: str, episode: int) -> list[Record]:
    """The record of one world of one setting: the loss of the entry, and the error if it failed."""
    try:
        if "/" not in setting:
            agent, env = _loop(entry, role, setting)
            return [{"loss": float(run_episode(env, agent, episode)["map_error"])}]
        (record,) = evaluate(setting, episode, {entry: _searcher(entry, role)}, PROBLEMS, SPLIT)
        return [{"loss": 1.0 - record["score"]}]
    except EntryError as error:
        return [{"loss": LOST, "failed": str(error)}]


process = functools.lru_cache(maxsize=4)(EntryProcess)
"""The process of an entry, by role and name. Each process of the evaluation has one."""


def _searcher(name: str, role: Role) -> Any:
    """An associator or relocator in its own process, or the name `true_association`, which runs here with the truth."""
    if name == CEILING:
        return CEILING
    return functools.partial(associate_in if role == "associator" else relocate_in, process(role, name))


def _loop(name: str, role: Role, scenario: str) -> tuple[Agent, gym.Env[Any, Any]]:
    """The driver and the environment, in which baselines play the other roles."""
    agent: Agent = EntryAgent(process("agent", name)) if role == "agent" else make_agent(DRIVER)
    arguments = {"associator": "associator", "relocator": "relocation"}
    entry = {arguments[role]: _searcher(name, role)} if role in arguments else {}
    return agent, ExploreArguments(scenario, split=SPLIT).make(agent.action, **entry)


def leaderboard_evaluation(name: str, chosen: Protocol) -> Evaluation:
    """The evaluation of an entry by the protocol."""
    keys = [Key(name, setting, FIRST + k) for setting, count in chosen.parts.items() for k in range(count)]
    tasks = [Task([key], functools.partial(lose, name, chosen.role, key.setting, key.episode)) for key in keys]
    return Evaluation("leaderboard", tasks, {"entry": name} | chosen.about, {"models": hashes_of(name)})
