"""Short films of episodes: the same seeds as the evaluation, drawn tick by tick."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import imageio.v2 as imageio
import numpy as np
from numpy.typing import NDArray

from agents.drivers.base import Agent
from agents.evaluation.drivers import Driver
from agents.evaluation.episodes import ExploreArguments, run_episode
from agents.evaluation.parallel import run_all
from agents.evaluation.pipeline import Execution
from agents.evaluation.records import stem

FRAMES = 300
RATE = 20  # [frames/s]
SLOW = 8  # frames a tick, around a kidnapping and a recovery


def film_path(out: Path, agent: str) -> Path:
    """Where an agent's film lies; its last picture has the same name with .png."""
    return out / "films" / f"{stem(agent)}.mp4"


def make_films(
    drivers: Sequence[Driver], arguments: ExploreArguments, episode: int, out: Path, execution: Execution
) -> None:
    """One film per agent, of that episode, by its first model; those that are there already stay."""
    first = {driver.agent: driver for driver in reversed(drivers)}
    paths = {agent: film_path(out, agent) for agent in first}
    missing = [agent for agent, path in paths.items() if not path.with_suffix(".png").exists()]
    calls = [partial(_film_by, first[agent], arguments, episode, paths[agent]) for agent in missing]
    with execution.console.status(f"filming {', '.join(missing)}"):
        list(run_all(calls, execution.jobs, execution.backend))


def _film_by(driver: Driver, arguments: ExploreArguments, episode: int, path: Path) -> Path:
    return film(arguments, driver.make(), episode, path)


def film(arguments: ExploreArguments, agent: Agent, episode: int, path: Path) -> Path:
    """Film one episode into `path` (.mp4); its last picture is kept beside it as .png, which is returned.

    At most about `FRAMES` frames, however long the episode is.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    env = arguments.make(agent.action, render_mode="rgb_array")
    try:
        stride = max(1, round(env.unwrapped.scenario.budget / FRAMES))  # type: ignore[attr-defined]
        with Camera(path, stride) as camera:
            run_episode(env, agent, episode, watch=camera)
            for _ in range(RATE):  # hold the final map for a second
                camera.shoot(env)
    finally:
        env.close()
    picture = path.with_suffix(".png")
    imageio.imwrite(picture, camera.last)
    return picture


class Camera:
    """Draws every `stride`-th tick into an mp4 file; use as a context."""

    def __init__(self, path: Path, stride: int) -> None:
        self.last: NDArray[np.uint8] | None = None
        self._stride, self._tick = stride, 0
        self._writer = imageio.get_writer(
            path, fps=RATE, codec="libx264", quality=6, macro_block_size=2, ffmpeg_log_level="error"
        )

    def __call__(self, env: gym.Env[Any, Any]) -> None:
        slow = _worth_a_closer_look(env)
        if slow or self._tick % self._stride == 0:
            for _ in range(SLOW if slow else 1):
                self.shoot(env)
        self._tick += 1

    def shoot(self, env: gym.Env[Any, Any]) -> None:
        """Draw the env as it is now."""
        self.last = np.asarray(env.render(), dtype=np.uint8)
        self._writer.append_data(self.last)

    def __enter__(self) -> Camera:
        return self

    def __exit__(self, *exception: object) -> None:
        self._writer.close()


def _worth_a_closer_look(env: gym.Env[Any, Any]) -> bool:
    """The robot has just been carried away, or has just found where it is."""
    episode = env.unwrapped.episode  # type: ignore[attr-defined]
    moments = (episode.kidnapping.happened, episode.kidnapping.recovered)
    return any(moment is not None and 0 <= episode.ticks - moment < 4 for moment in moments)
