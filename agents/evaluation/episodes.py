"""One episode: the arguments of its environment, which are the same for every agent, and its run to the end."""

import hashlib
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import slam_gym  # noqa: F401  (registers the environments)
from agents.drivers.base import Agent, visible
from agents.drivers.clairvoyant import Clairvoyant
from agents.evaluation.records import Record
from slam_gym.association.prediction import Associator
from slam_gym.slam.relocate import SEARCH
from slam_gym.types import Relocator

EXPLORE, ASSOCIATE = "slam_gym/Explore-v0", "slam_gym/Associate-v0"


@dataclass(frozen=True)
class _Arguments:
    """The arguments of both environments."""

    scenario: str
    overrides: tuple[tuple[str, Any], ...] = ()  # dotted names in the scenario, and their values
    split: str = "test"

    @property
    def plain(self) -> dict[str, Any]:
        """The arguments as the environment takes them and results record them."""
        return asdict(self) | {"overrides": dict(self.overrides)}


@dataclass(frozen=True)
class ExploreArguments(_Arguments):
    """Arguments of slam_gym/Explore-v0, except those that depend on the agent."""

    scenario: str = "office"
    associator: str | None = None  # None: that of the scenario
    reward: str = "map_error"
    floor_plan: str | None = None  # a file that replaces the scenario's worlds
    resolution: float | None = None  # [m/pixel] of that file, where it is an image
    relocation: str | None = SEARCH  # the search that relocates a lost robot

    @property
    def world(self) -> str:
        """The name of its worlds for titles: that of the scenario, or of the file of a floor plan."""
        return Path(self.floor_plan).name if self.floor_plan else self.scenario

    def make(
        self,
        action: str,
        render_mode: str | None = None,
        associator: Associator | str | None = None,
        relocation: Relocator | str | None = None,
    ) -> gym.Env[Any, Any]:
        """The environment. `associator` and `relocation` replace those of the arguments unless None. Raises ValueError,
        with the known names, for an unknown one."""
        changes = {"associator": associator, "relocation": relocation}
        arguments = self.plain | {name: value for name, value in changes.items() if value is not None}
        return gym.make(EXPLORE, action=action, render_mode=render_mode, disable_env_checker=True, **arguments)


@dataclass(frozen=True)
class AssociateArguments(_Arguments):
    """Arguments of slam_gym/Associate-v0."""

    scenario: str = "office-small"
    split: str = "train"
    driver: str = "nearest_frontier"
    reward: str = "truth"
    candidates: int = 5
    order: str = "as_scanned"
    compatibility: str = "joint"
    wrong_cost: float = 10.0

    def make(self, action: str = "branch") -> gym.Env[Any, Any]:
        """The environment, which has one kind of action. ValueError, with the known names, for an unknown one."""
        return gym.make(ASSOCIATE, disable_env_checker=True, **self.plain)


LOST_ERROR, LOST_DUPLICATES = 0.8, 10.0
"""A map with a greater error, or with more features mapped twice, counts as lost: it contains the building twice."""

LOST_MEANS = (
    f"lost: fraction of episodes with a map error above {LOST_ERROR:g} "
    f"or more than {LOST_DUPLICATES:g} features mapped twice"
)


def reset_arguments(episode: int) -> dict[str, Any]:
    """Arguments of `env.reset` for the i-th episode of a split."""
    return {"seed": episode, "options": {"world": episode}}


CURVE = ("ticks", "map_error", "coverage")
CURVE_STEP = 10  # [ticks] least distance between points of a curve, since twist episodes have many steps


def begin_episode(env: gym.Env[Any, Any], agent: Agent, episode: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """Reset environment and agent for the i-th episode; returns the first observation and info. The clairvoyant driver,
    identified by its class, receives the truth here; no other agent does."""
    observation, info = env.reset(**reset_arguments(episode))
    digest = hashlib.sha256(f"agent of episode {episode}".encode()).digest()
    agent.reset(int.from_bytes(digest[:4], "big"))  # different for each episode, and does not reveal the world
    if isinstance(agent, Clairvoyant):
        agent.behold(env.unwrapped.episode)  # type: ignore[attr-defined]
    return observation, info


def run_episode(
    env: gym.Env[Any, Any], agent: Agent, episode: int, watch: Callable[[gym.Env[Any, Any]], None] | None = None
) -> Record:
    """Drive one episode of Explore-v0 to its end. `watch(env)` is called after every tick.

    Returns a flat dict of JSON-able numbers: episode, return, decisions, ticks, seconds (of driving, without the
    reset), all of `map_quality`, map_lost; and `curve`, lists of equal length over the decisions: ticks, map_error,
    coverage.
    """
    observation, info = begin_episode(env, agent, episode)
    if watch is not None:
        env.unwrapped.watch(watch)  # type: ignore[attr-defined]
    curve = {name: [float(info[name]) if name != "ticks" else 0] for name in CURVE}
    decisions, ticks, total, ended = 0, 0, 0.0, False
    start = time.perf_counter()
    while not ended:
        observation, reward, terminated, truncated, info = env.step(agent.act(observation, visible(info)))
        ended = terminated or truncated
        decisions, ticks, total = decisions + 1, ticks + int(info["ticks"]), total + float(reward)
        if ended or ticks - curve["ticks"][-1] >= CURVE_STEP:
            for name, value in zip(CURVE, (ticks, info["map_error"], info["coverage"])):
                curve[name].append(round(float(value), 6))
    seconds = time.perf_counter() - start
    quality = {key: float(np.asarray(value)) for key, value in info["map_quality"].items()}
    record = {"episode": episode, "return": total, "decisions": decisions, "seconds": seconds} | quality
    lost = float(record["map_error"] > LOST_ERROR or record["duplicates"] > LOST_DUPLICATES)
    return record | {"map_lost": lost, "ticks": ticks, "ticks_per_second": ticks / seconds, "curve": curve}
