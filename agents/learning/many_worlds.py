"""Many worlds for Stable-Baselines3, which has a vector environment of its own kind."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv

from slam_gym.envs.base import Snapshot
from slam_gym.envs.vector.env import ManyWorlds

Indices = None | int | Iterable[int]


class WorldsForLearning(VecEnv):
    """`ManyWorlds`, reset in the same step, as Stable-Baselines3's `VecEnv`.

    At the end of an episode `info` is that of its last step, with `terminal_observation`, `TimeLimit.truncated`, and
    `episode` as `Monitor` has it: the return `r` in true rewards, the length `l`, and the values of `keywords`.
    The masks that MaskablePPO asks for by `env_method` are at hand, and cost no message.
    """

    def __init__(self, worlds: ManyWorlds, reward_scale: float = 1.0, keywords: Sequence[str] = ()) -> None:
        """`reward_scale`: the factor of the rewards that are learned from."""
        mode = worlds.metadata["autoreset_mode"]
        if mode is not AutoresetMode.SAME_STEP:
            raise ValueError(f"autoreset_mode={mode.value}: Stable-Baselines3 needs {AutoresetMode.SAME_STEP.value}")
        self.worlds = worlds
        self._scale, self._keywords = reward_scale, tuple(keywords)
        self.returns, self.lengths = np.zeros(worlds.num_envs), np.zeros(worlds.num_envs, np.int64)
        super().__init__(worlds.num_envs, worlds.single_observation_space, worlds.single_action_space)

    def reset(self) -> dict[str, Any]:
        asked = [options.get("world") for options in self._options]
        if any(self._options) and None in asked:
            raise ValueError(f"options {self._options}: the one there is, world, is given to all environments or none")
        options = {"world": asked} if any(self._options) else None
        observations, infos = self.worlds.reset(seed=self._seeds, options=options)
        self.reset_infos = [of_world(infos, i) for i in range(self.num_envs)]
        self.returns[:], self.lengths[:] = 0.0, 0
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: Any) -> None:
        self.worlds.step_async(actions)

    def step_wait(self) -> Any:
        observations, rewards, terminated, truncated, infos = self.worlds.step_wait()
        self.returns += rewards
        self.lengths += 1
        dones = terminated | truncated
        told = [of_world(infos, i) for i in range(self.num_envs)]
        for i in np.flatnonzero(dones).tolist():
            told[i] = of_world(infos["final_info"], i)
            told[i]["terminal_observation"] = infos["final_obs"][i]
            told[i]["TimeLimit.truncated"] = bool(truncated[i] and not terminated[i])
            episode = {"r": float(self.returns[i]), "l": int(self.lengths[i])}
            told[i]["episode"] = episode | {key: float(told[i][key]) for key in self._keywords}
            self.returns[i], self.lengths[i] = 0.0, 0
        return observations, self._scale * rewards, dones, told

    def restore(self, snapshots: Sequence[Snapshot], returns: Sequence[float], lengths: Sequence[int]) -> Any:
        """Go on in each world from its snapshot, with what its episode has earned so far; the observations there."""
        observations, _ = self.worlds.restore(snapshots)
        self.returns[:], self.lengths[:] = returns, lengths
        return observations

    def close(self) -> None:
        self.worlds.close()

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        return list(self.worlds.call_in(self._of(indices), attr_name))

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        self.worlds.call_in(self._of(indices), "set_wrapper_attr", attr_name, value)

    def env_method(self, method_name: str, *arguments: Any, indices: Indices = None, **named: Any) -> list[Any]:
        if method_name == "action_masks":
            return list(self.worlds.action_masks()[self._of(indices)])
        return list(self.worlds.call_in(self._of(indices), method_name, *arguments, **named))

    def has_attr(self, attr_name: str) -> bool:
        if attr_name == "action_masks":
            return isinstance(self.action_space, gym.spaces.Discrete)
        return super().has_attr(attr_name)

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: Indices = None
    ) -> list[bool]:
        return [False] * len(self._of(indices))

    def get_images(self) -> Sequence[Any]:
        return self.worlds.render()

    def _of(self, indices: Indices) -> list[int]:
        return list(self._get_indices(indices))


def of_world(infos: dict[str, Any], world: int) -> dict[str, Any]:
    """The info of one world, from those of all in Gymnasium's convention."""
    return {
        key: of_world(value, world) if isinstance(value, dict) else value[world]
        for key, value in infos.items()
        if not key.startswith("_") and key not in ("final_info", "final_obs") and infos[f"_{key}"][world]
    }
