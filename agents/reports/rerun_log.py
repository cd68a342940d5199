"""An episode for Rerun's viewer, tick by tick: where the robot is and believes to be, its map, the scan, what it pairs.

Everything lies in B, the frame of the robot's first pose, and on the timeline `tick`. Needs the extra `rerun`.
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
from slam_gym.geometry import observe, relative, transform
from slam_gym.types import NO_ID, UNPAIRED, Array, Associator

SPAWN = "spawn"
"""As a target: the viewer, in a window of its own."""

BLUE, RED, GREY, GREEN, BLACK = (43, 108, 163), (200, 85, 61), (150, 158, 168), (58, 138, 92), (47, 54, 64)
_AROUND = np.linspace(0.0, 2.0 * np.pi, 25)
_CIRCLE = np.stack([np.cos(_AROUND), np.sin(_AROUND)])  # (2, 25)
_SIGMAS_95 = 2.4477  # √χ²_{2, .95}


def viewer() -> Any:
    """The package rerun. ImportError says what to install."""
    try:
        import rerun
    except ImportError as error:
        raise ImportError("--rerun needs rerun-sdk: pip install 'slam_gym[rerun]'") from error
    return rerun


class Drive(NamedTuple):
    """An episode to be written down."""

    name: str
    arguments: ExploreArguments
    agent: Agent
    associator: Associator | str | None = None  # in place of that of the arguments


class RerunLog:
    """What an environment of Explore shows, written as it changes: `env.watch(log)`, or call it.

    `target` is a file (.rrd), or "spawn". ImportError says what to install.
    """

    def __init__(self, target: str | Path, name: str) -> None:
        rerun = self._rr = viewer()
        self._episode: Any = None  # that was written down last
        self._stream = rerun.RecordingStream(f"slam_gym: {name}")
        if str(target) == SPAWN:
            self._stream.spawn()
        else:
            Path(target).parent.mkdir(parents=True, exist_ok=True)
            self._stream.save(str(target))

    def __call__(self, env: gym.Env[Any, Any]) -> None:
        """Write down the present state."""
        episode: Any = env.unwrapped.episode  # type: ignore[attr-defined]
        if self._episode is not episode:
            self._episode = episode
            self._begin(episode)
        self._stream.set_time("tick", sequence=episode.ticks)
        self._robot(episode)
        self._map(episode.slam)
        self._scan(episode)
        self._curves(episode)

    def close(self) -> None:
        """Write what is left."""
        self._stream.flush()

    def _begin(self, episode: Any) -> None:
        """What stays as it is: the true walls."""
        walls = episode.site.plan.walls.reshape(-1, 2)
        strips = observe(episode.base, walls).reshape(-1, 2, 2)
        self._log("truth/walls", self._rr.LineStrips2D(_down(strips), colors=[GREY], radii=[0.03]), static=True)

    def _robot(self, episode: Any) -> None:
        true = np.array([relative(episode.base, pose)[:2] for pose in episode.poses[-1:]])
        for name, path, colour in (
            ("truth/robot", true, BLACK), ("robot/pose", np.array(episode.estimates[-1:])[:, :2], RED),
        ):  # fmt: skip
            self._log(name, self._rr.Points2D(_down(path), colors=[colour], radii=[0.2]))
        self._log("robot/path", self._rr.LineStrips2D([_down(np.array(episode.estimates)[:, :2])], colors=[RED]))

    def _map(self, slam: Any) -> None:
        at, covariances = slam.map.positions, slam.map.covariances
        labels = [f"feature {k}, seen {n}" for k, n in zip(slam.map.ids.tolist(), slam.map.seen.tolist())]
        points = self._rr.Points2D(_down(at), colors=[BLUE], radii=[0.06], labels=labels, show_labels=False)
        self._log("map/features", points)
        self._log("map/ellipses", self._rr.LineStrips2D(_down(ellipses(at, covariances)), colors=[BLUE]))
        edges = slam.covisibility.edges()
        between = at[edges.pairs]
        self._log("map/covisibility", self._rr.LineStrips2D(_down(between), colors=[(*GREY, 90)], radii=[0.01]))

    def _scan(self, episode: Any) -> None:
        slam_map, step = episode.slam.map, episode.last_step
        seen = transform(slam_map.pose, episode.scan.points)
        paired = step.hypothesis.features != UNPAIRED
        row_of = {int(id): row for row, id in enumerate(slam_map.ids)}
        rows = np.array([row_of.get(int(id), -1) if id != NO_ID else -1 for id in step.ids], dtype=np.int64)
        joined = paired & (rows >= 0)
        lines = np.stack([seen[joined], slam_map.positions[rows[joined]]], axis=1)
        colours = [GREEN if each else GREY for each in paired.tolist()]
        self._log("scan/measurements", self._rr.Points2D(_down(seen), colors=colours, radii=[0.05]))
        self._log("scan/pairings", self._rr.LineStrips2D(_down(lines), colors=[GREEN]))

    def _curves(self, episode: Any) -> None:
        figures = {
            "map_error": episode.map_error(), "coverage": episode.coverage(), "pose_nees": episode.nees[-1],
            "features": len(episode.slam.map), "paired": episode.last_step.hypothesis.pairings,
            "lost": float(episode.slam.lost),
        }  # fmt: skip
        for name, value in figures.items():
            self._log(f"curves/{name}", self._rr.Scalars(float(value)))

    def _log(self, path: str, what: Any, static: bool = False) -> None:
        self._stream.log(path, what, static=static)


def ellipses(positions: Array, covariances: Array) -> Array:
    """(k, 25, 2) outlines of the 95 % ellipses of Gaussians with means (k, 2) and covariances (k, 2, 2)."""
    values, vectors = np.linalg.eigh(covariances)
    radii = _SIGMAS_95 * np.sqrt(np.maximum(values, 0.0))
    found: Array = positions[:, None] + np.swapaxes(vectors @ (radii[:, :, None] * _CIRCLE), 1, 2)
    return found


def _down(points: Array) -> Array:
    """The same with y downwards, as Rerun's plane has it."""
    return np.asarray(points, np.float64) * [1.0, -1.0]


def log_drives(target: str, episode: int, drives: Sequence[Drive]) -> list[str]:
    """That episode of each; of several each gets a file of its own, or a recording of the viewer.

    The files that were written. Raises ImportError where rerun-sdk is missing.
    """
    written = []
    for name, arguments, agent, associator in drives:
        path = Path(target)
        several = target != SPAWN and len(drives) > 1
        own = str(path.with_name(f"{path.stem}_{stem(name)}{path.suffix}")) if several else target
        log = RerunLog(own, name)
        env = arguments.make(agent.action, associator=associator)
        run_episode(env, agent, episode, watch=log)
        env.close()
        log.close()
        written += [own] if own != SPAWN else []
    return written
