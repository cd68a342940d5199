"""The state of a training beside its weights: with it, a resumed training goes on as one that was not interrupted.

It holds the random states of PyTorch and NumPy, a snapshot of every world (its generator and actions, to be replayed),
and what is counted along the way. It is written as JSON: numbers and text only.
"""

from __future__ import annotations

import json
from collections import deque
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm

from agents.learning.many_worlds import WorldsForLearning
from slam_gym.envs.base import Snapshot

_COUNTED = ("_n_updates", "_episode_num")


def state_of(model: BaseAlgorithm) -> bytes:
    """The state of a training between two rollouts."""
    envs = model.env
    assert isinstance(envs, WorldsForLearning)
    name, keys, position, has_gauss, gauss = np.random.get_state()  # noqa: NPY002 (Stable-Baselines3 draws from it)
    state = {
        "torch": torch.get_rng_state().tolist(),
        "numpy": [name, np.asarray(keys).tolist(), position, has_gauss, gauss],
        "worlds": [snapshot._asdict() for snapshot in envs.env_method("snapshot")],
        "returns": envs.returns.tolist(),
        "lengths": envs.lengths.tolist(),
        "starts": np.asarray(model._last_episode_starts).tolist(),
        "episodes": list(model.ep_info_buffer or []),
        "counted": {name: getattr(model, name) for name in _COUNTED},
    }
    return json.dumps(state).encode()


def restore_state(model: BaseAlgorithm, content: bytes) -> None:
    """Put a model, its worlds and the random generators into a state that `state_of` gave.

    Raises ValueError where it is not one for this model, as after a change of the number of worlds.
    """
    envs = model.env
    assert isinstance(envs, WorldsForLearning)
    try:
        state: dict[str, Any] = json.loads(content)
        snapshots = [Snapshot(**{**world, "series": tuple(world["series"])}) for world in state["worlds"]]
        model._last_obs = envs.restore(snapshots, state["returns"], state["lengths"])
        model._last_episode_starts = np.array(state["starts"], np.bool_)
        model.ep_info_buffer = deque(state["episodes"], maxlen=model._stats_window_size)
        model.ep_success_buffer = deque(maxlen=model._stats_window_size)
        for name in _COUNTED:
            setattr(model, name, int(state["counted"][name]))
        np.random.set_state(tuple(state["numpy"]))  # noqa: NPY002
        torch.set_rng_state(torch.tensor(state["torch"], dtype=torch.uint8))
    except (KeyError, TypeError, RuntimeError, AttributeError, RecursionError) as error:
        raise ValueError(f"the state of the training does not fit: {type(error).__name__}: {error}") from error
