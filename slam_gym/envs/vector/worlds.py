"""Some of the worlds of a vector, stepped one after the other in this process."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
from gymnasium.vector import AutoresetMode

from slam_gym.envs.base import BaseEnv, Observation, Snapshot
from slam_gym.envs.vector.buffers import Buffers, opened
from slam_gym.envs.vector.infos import InfoLayout, SharedInfos


class WorldError(RuntimeError):
    """An error in one of the worlds; its cause is what was raised there."""

    def __init__(self, world: int, told: str) -> None:
        super().__init__(world, told)
        self.world, self.told = world, told

    def __str__(self) -> str:
        return f"world {self.world}: {self.told}"


@dataclass(frozen=True)
class Making:
    """How the worlds are made, and what happens at the end of an episode."""

    of: type[BaseEnv]
    arguments: Mapping[str, Any]
    autoreset: AutoresetMode
    max_episode_steps: int | None

    def __call__(self) -> gym.Env[Any, Any]:
        env: gym.Env[Any, Any] = self.of(**self.arguments)
        return env if self.max_episode_steps is None else gym.wrappers.TimeLimit(env, self.max_episode_steps)


class Told(NamedTuple):
    """What a step or a reset of a group of worlds gives beside what it writes into shared memory."""

    infos: list[tuple[int, dict[str, Any]]]  # worlds of the vector, and what is to be entered for each, in this order
    upcoming: dict[int, int]  # of the worlds of the vector that began an episode: the number of the next in the split


class Worlds:
    """The worlds numbered `rows` of a vector; `buffers` are their rows. `ahead`: tell which worlds come next."""

    def __init__(self, making: Making, rows: range, buffers: Buffers, ahead: bool = False) -> None:
        self._ahead = ahead and making.autoreset is not AutoresetMode.DISABLED
        self._rows, self._autoreset, self._buffers = rows, making.autoreset, buffers
        self._envs = [making() for _ in rows]
        self._infos: SharedInfos | None = None
        self._begin()

    def share_infos(self, layout: InfoLayout, block: bytearray | Path) -> None:
        """From now on write infos that are made like that into this memory, which has the layout."""
        self._infos = SharedInfos(layout, opened(block, layout.size) if isinstance(block, Path) else block)

    def reset(self, seeds: Mapping[int, int | None], options: Mapping[int, dict[str, Any] | None]) -> Told:
        """Begin an episode in each of the worlds that have a seed here, even if it is None."""
        self._begin()
        for row, world in enumerate(self._rows):
            if world in seeds:
                try:
                    observation, info = self._envs[row].reset(seed=seeds[world], options=options[world])
                except Exception as error:
                    raise _named(world, error) from error
                self._hand_out(row, observation, 0.0, False, False)
                self._look_ahead(row)
                self._tell(world, info)
        return self._told

    def step(self, drawn: Mapping[int, tuple[int, bytes]]) -> Told | None:
        """Carry out the actions in the buffers; where an episode was over, begin the next as the mode has it.

        `drawn` are worlds that were drawn ahead, with their numbers in the split, for the worlds of the vector that
        will need them. Returns None where everything is in shared memory.
        """
        self._begin()
        for row, world in enumerate(self._rows):
            try:
                if world in drawn:
                    self._single(row).take(*drawn[world])
                self._step(row)
            except Exception as error:
                raise _named(world, error) from error
        return self._told if self._told.infos or self._told.upcoming else None

    def call(self, name: str, arguments: tuple[Any, ...], named: dict[str, Any], worlds: Container[int]) -> list[Any]:
        """What the method or attribute of each of these worlds gives."""
        found = []
        for world, env in zip(self._rows, self._envs):
            if world in worlds:
                try:
                    value = env.get_wrapper_attr(name)
                    found.append(value(*arguments, **named) if callable(value) else value)
                except Exception as error:
                    raise _named(world, error) from error
        return found

    def restore(self, snapshots: Mapping[int, Snapshot]) -> Told:
        """Go on in each world from its snapshot."""
        self._begin()
        for row, world in enumerate(self._rows):
            try:
                observation, info = self._single(row).restore(snapshots[world])
            except Exception as error:
                raise _named(world, error) from error
            self._hand_out(row, observation, 0.0, self._single(row)._over, False)
            self._look_ahead(row)
            self._tell(world, info)
        return self._told

    def set_attr(self, name: str, values: Mapping[int, Any]) -> None:
        """Set an attribute of each world."""
        for world, env in zip(self._rows, self._envs):
            env.set_wrapper_attr(name, values[world])

    def close(self) -> None:
        """Close all of them."""
        for env in self._envs:
            env.close()

    def _begin(self) -> None:
        """Nothing is told yet."""
        self._told = Told([], {})
        if self._infos is not None:
            self._infos.there[self._rows.start : self._rows.stop] = False

    def _tell(self, world: int, info: dict[str, Any]) -> None:
        if self._infos is None or not self._infos.write(info, world):
            self._told.infos.append((world, info))

    def _step(self, row: int) -> None:
        env, buffers, world = self._envs[row], self._buffers, self._rows[row]
        over = buffers.terminated[row] or buffers.truncated[row]
        if over and self._autoreset is AutoresetMode.NEXT_STEP:
            observation, info = self._next_episode(row)
            self._hand_out(row, observation, 0.0, False, False)
        else:
            observation, reward, terminated, truncated, info = env.step(buffers.actions[row])
            if (terminated or truncated) and self._autoreset is AutoresetMode.SAME_STEP:
                self._told.infos.append((world, {"final_obs": observation, "final_info": info}))
                observation, info = self._next_episode(row)
            self._hand_out(row, observation, float(reward), terminated, truncated)
        self._tell(world, info)

    def _next_episode(self, row: int) -> tuple[Observation, dict[str, Any]]:
        start = self._envs[row].reset()
        self._look_ahead(row)
        return start

    def _look_ahead(self, row: int) -> None:
        """Tell which world comes next, so that it can be drawn ahead."""
        if self._ahead and (world := self._single(row).upcoming_world()) is not None:
            self._told.upcoming[self._rows[row]] = world

    def _single(self, row: int) -> BaseEnv:
        env = self._envs[row].unwrapped
        assert isinstance(env, BaseEnv)
        return env

    def _hand_out(self, row: int, observation: Observation, reward: float, terminated: bool, truncated: bool) -> None:
        buffers = self._buffers
        for name, part in buffers.observations.items():
            part[row] = observation[name]
        buffers.rewards[row], buffers.terminated[row], buffers.truncated[row] = reward, terminated, truncated


def _named(world: int, error: Exception) -> WorldError:
    return WorldError(world, f"{type(error).__name__}: {error}")
