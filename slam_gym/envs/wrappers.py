"""Wrappers for other libraries: flat observations, masks within observations, and films with every tick.

They wrap any of the three environments, and each other: masked policies of RLlib and TorchRL take
`MaskInObservation(FlatObservation(env))`. All of them leave `action_masks()` available to sb3-contrib.
"""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

MASK, REST = "action_mask", "observations"
"""Keys under which `MaskInObservation` puts the mask, and an observation that is not a Dict."""


class FlatObservation(gym.ObservationWrapper[Any, Any, Any], gym.utils.RecordConstructorArgs):
    """All parts of the observation but images in one float32 vector, in the order of the space.

    Raises ValueError for an environment whose observation is not a Dict.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        space = env.observation_space
        if not isinstance(space, spaces.Dict):
            raise ValueError(f"FlatObservation: expected a Dict, got {space}")
        gym.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env)
        self._parts = spaces.Dict({name: box for name, box in space.items() if len(box.shape or ()) < 3})
        self.observation_space = spaces.flatten_space(self._parts)

    def observation(self, observation: Any) -> Any:
        return spaces.flatten(self._parts, observation)


class MaskInObservation(gym.ObservationWrapper[Any, Any, Any], gym.utils.RecordConstructorArgs):
    """The mask of legal actions is a part of the observation, `action_mask`, (n,) int8.

    A Dict gets this additional part; any other observation becomes the part `observations` beside the mask.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        gym.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env)
        if not isinstance(env.action_space, spaces.Discrete):
            raise ValueError(f"MaskInObservation: masks are for discrete actions, not for {env.action_space}")
        mask = spaces.Box(0, 1, (int(env.action_space.n),), np.int8)
        space, self._is_dict = env.observation_space, isinstance(env.observation_space, spaces.Dict)
        parts = dict(space.spaces) if isinstance(space, spaces.Dict) else {REST: space}
        self.observation_space = spaces.Dict(parts | {MASK: mask})

    def observation(self, observation: Any) -> dict[str, Any]:
        mask = self.get_wrapper_attr("action_masks")().astype(np.int8)
        return (dict(observation) if self._is_dict else {REST: observation}) | {MASK: mask}


class RecordEveryTick(gym.wrappers.RecordVideo):
    """Gymnasium's RecordVideo with a picture of every tick instead of every step, since a goal takes many ticks.

    It has the arguments of RecordVideo; a film ends with the step in which `video_length` pictures are reached. Raises
    ValueError for an environment without `render_mode="rgb_array_list"`, whose `render` returns the pictures of all
    ticks since the last call.
    """

    def __init__(self, env: gym.Env[Any, Any], *arguments: Any, **named: Any) -> None:
        if env.render_mode != "rgb_array_list":
            raise ValueError(f"RecordEveryTick: needs render_mode='rgb_array_list', not {env.render_mode!r}")
        super().__init__(env, *arguments, **named)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        outcome = super().step(action)
        if not self.recording:
            self.env.render()  # forgets the pictures of this step
        return outcome

    def _capture_frame(self) -> None:
        frames: Any = self.env.render()
        self.recorded_frames += frames
