"""Short films of episodes: the same seeds as the evaluation, drawn tick by tick."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import imageio.v2 as imageio
import numpy as np

from agents.evaluation.drives import Driver
from agents.evaluation.episodes import ExploreArguments, run_episode
from agents.evaluation.records import stem

FRAMES = 300
RATE = 20  # [frames/s]
SLOW = 8  # frames a tick, around a kidnapping and a recovery


def film_path(out: Path, agent: str) -> Path:
    """Where an agent's film lies; its last picture has the same name with .png."""
    return out / "films" / f"{stem(agent)}.mp4"


def films_of(
    drivers: Sequence[Driver], arguments: ExploreArguments, episode: int, out: Path
) -> list[Callable[[], Path]]:
    """Calls that film that episode, one per agent, by its first model; those that are there already stay."""
    first = {driver.agent: driver for driver in reversed(drivers)}
    paths = {agent: film_path(out, agent) for agent in first}
    missing = [agent for agent, path in paths.items() if not path.with_suffix(".png").exists()]
    return [partial(film, arguments, first[agent], episode, paths[agent]) for agent in missing]


def film(arguments: ExploreArguments, driver: Driver, episode: int, path: Path) -> Path:
    """Film one episode into `path` (.mp4); its last picture is kept beside it as .png, which is returned.

    At most about `FRAMES` frames, however long the episode is.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    agent = driver.make()
    env = arguments.make(agent.action, render_mode="rgb_array")
    stride = max(1, round(env.unwrapped.scenario.budget / FRAMES))  # type: ignore[attr-defined]
    mp4 = {"codec": "libx264", "quality": 6, "macro_block_size": 2, "ffmpeg_log_level": "error"}
    with imageio.get_writer(path, fps=RATE, **mp4) as writer:

        def shoot(env: gym.Env[Any, Any], frames: int) -> None:
            picture = np.asarray(env.render(), dtype=np.uint8)
            for _ in range(frames):
                writer.append_data(picture)

        def watch(env: gym.Env[Any, Any]) -> None:
            if _worth_a_closer_look(env):
                shoot(env, SLOW)
            elif env.unwrapped.episode.ticks % stride == 0:  # type: ignore[attr-defined]
                shoot(env, 1)

        run_episode(env, agent, episode, watch)
        shoot(env, RATE)  # hold the final map for a second
    picture = path.with_suffix(".png")
    imageio.imwrite(picture, np.asarray(env.render(), dtype=np.uint8))
    env.close()
    return picture


def _worth_a_closer_look(env: gym.Env[Any, Any]) -> bool:
    """The robot has just been carried away, or has just found where it is."""
    episode = env.unwrapped.episode  # type: ignore[attr-defined]
    moments = (episode.kidnapping.happened, episode.kidnapping.recovered)
    return any(moment is not None and 0 <= episode.ticks - moment < 4 for moment in moments)
