"""One episode of one agent: what every command that runs agents shares."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import gymnasium as gym
import numpy as np

import slam_gym  # noqa: F401  (registers the environments)
from agents.drivers.base import ActionKind, Agent, visible

ENV_ID = "slam_gym/Explore-v0"


@dataclass(frozen=True)
class Setting:
    """What an episode is run on, the agent apart. The i-th episode is the same for every agent."""

    scenario: str = "office"
    associator: str = "jcbb"
    reward: str = "map_error"
    split: str = "test"
    floor_plan: str | None = None  # a file that replaces the scenario's worlds
    resolution: float | None = None  # [m/pixel] of that file, where it is an image
    relocation: str | None = None  # the search that finds a lost robot again

    def make(self, action: ActionKind, render_mode: str | None = None) -> gym.Env[Any, Any]:
        """The environment. ValueError, with the known names, for what it does not know."""
        return gym.make(ENV_ID, action=action, render_mode=render_mode, disable_env_checker=True, **asdict(self))

    @property
    def world(self) -> str:
        """What to call it in a title."""
        return self.scenario if self.floor_plan is None else self.floor_plan


def reset_arguments(episode: int) -> dict[str, Any]:
    """Arguments of `env.reset` for the i-th episode of a split."""
    return {"seed": episode, "options": {"world": episode}}


def run_episode(
    env: gym.Env[Any, Any], agent: Agent, episode: int, watch: Callable[[gym.Env[Any, Any]], None] | None = None
) -> dict[str, Any]:
    """Drive one episode to its end. `watch(env)` is called after every tick.

    Returns a flat dict of JSON-able numbers: episode, return, decisions, ticks, seconds (of driving, without the
    reset), all of `map_quality`; and `curve`, lists of equal length over the decisions: ticks, map_error, coverage.
    """
    observation, info = env.reset(**reset_arguments(episode))
    agent.reset(episode)
    if watch is not None:
        env.unwrapped.watch(watch)  # type: ignore[attr-defined]
    curve: dict[str, list[float]] = {"ticks": [0], "map_error": [float(info["map_error"])]}
    curve["coverage"] = [float(info["coverage"])]
    decisions, ticks, total, ended = 0, 0, 0.0, False
    start = time.perf_counter()
    while not ended:
        observation, reward, terminated, truncated, info = env.step(agent.act(observation, visible(info)))
        ended = terminated or truncated
        decisions, ticks, total = decisions + 1, ticks + int(info["ticks"]), total + float(reward)
        if ended or ticks - curve["ticks"][-1] >= 10:  # every step of a twist episode would be too many
            for key, value in (("ticks", ticks), ("map_error", info["map_error"]), ("coverage", info["coverage"])):
                curve[key].append(round(float(value), 6))
    seconds = time.perf_counter() - start
    quality = {key: float(np.asarray(value)) for key, value in info["map_quality"].items()}
    record: dict[str, Any] = {"episode": episode, "return": total, "decisions": decisions}
    return (
        record | {"seconds": seconds} | quality | {"ticks": ticks, "ticks_per_second": ticks / seconds, "curve": curve}
    )
