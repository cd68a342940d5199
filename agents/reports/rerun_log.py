"""Episodes for Rerun's viewer, tick by tick: the robot, where it believes to be, its map, its scan.

Everything lies in B, the frame of the robot's first pose, on the timeline `tick`. Needs the extra `rerun`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from agents.drivers.base import Agent
from agents.evaluation.episodes import ExploreArguments, run_episode
from agents.evaluation.records import stem
from slam_gym.association.prediction import Associator
from slam_gym.geometry import observe, transform
from slam_gym.types import UNPAIRED

BLUE, RED, GREY, GREEN = (43, 108, 163), (200, 85, 61), (150, 158, 168), (58, 138, 92)
DOWN = np.array([1.0, -1.0])  # Rerun's plane has y downwards


def viewer() -> Any:
    """The package rerun. ImportError says what to install."""
    try:
        import rerun
    except ImportError as error:
        raise ImportError("--rerun needs rerun-sdk: pip install 'slam_gym[rerun]'") from error
    return rerun


class RerunLog:
    """What an environment of Explore shows, written as it changes: `env.unwrapped.watch(log)`.

    `target` is a file (.rrd), or "spawn": a viewer in a window of its own. ImportError says what to install.
    """

    def __init__(self, target: str, name: str) -> None:
        self._rr = viewer()
        self.stream = self._rr.RecordingStream(f"slam_gym: {name}")
        if target == "spawn":
            self.stream.spawn()
        else:
            Path(target).parent.mkdir(parents=True, exist_ok=True)
            self.stream.save(target)

    def __call__(self, env: gym.Env[Any, Any]) -> None:
        """Write down the present state."""
        episode: Any = env.unwrapped.episode  # type: ignore[attr-defined]
        m, hypothesis = episode.slam.map, episode.last_step.hypothesis
        self.stream.set_time("tick", sequence=episode.ticks)
        walls = observe(episode.base, episode.site.plan.walls.reshape(-1, 2)).reshape(-1, 2, 2)
        self.stream.log("truth/walls", self._rr.LineStrips2D(walls * DOWN, colors=[GREY]))
        self._points("truth/robot", observe(episode.base, episode.poses[-1][None, :2]), [GREY], 0.2)
        self._points("robot/pose", m.pose[None, :2], [RED], 0.2)
        self._points("robot/path", np.array(episode.estimates)[:, :2], [RED], 0.02)
        self._points("map/features", m.positions, [BLUE], 0.06)
        paired = [GREEN if feature != UNPAIRED else GREY for feature in hypothesis.features.tolist()]
        self._points("scan", transform(m.pose, episode.scan.points), paired, 0.05)
        for name, value in (("map_error", episode.map_error()), ("coverage", episode.coverage()), ("features", len(m))):
            self.stream.log(f"curves/{name}", self._rr.Scalars(float(value)))

    def _points(self, path: str, points: Any, colours: list[tuple[int, int, int]], radius: float) -> None:
        self.stream.log(path, self._rr.Points2D(points * DOWN, colors=colours, radii=[radius]))


class Drive(NamedTuple):
    """An episode to be written down."""

    name: str
    arguments: ExploreArguments
    agent: Agent
    associator: Associator | str | None = None  # in place of that of the arguments


def log_drives(target: str, episode: int, drives: Sequence[Drive]) -> None:
    """That episode of each drive; of several each gets a file of its own, or a recording of the viewer."""
    for name, arguments, agent, associator in drives:
        path = Path(target)
        several = target != "spawn" and len(drives) > 1
        log = RerunLog(str(path.with_name(f"{path.stem}_{stem(name)}{path.suffix}")) if several else target, name)
        env = arguments.make(agent.action, associator=associator)
        run_episode(env, agent, episode, watch=log)
        env.close()
        log.stream.flush()
