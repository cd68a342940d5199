"""Trained models: `.zip` files of Stable-Baselines3, drivers made from them, and the arrays of associators.

Such a file contains weights, which torch reads without running code, and a JSON table whose entry `about` describes
the network. Other entries of the table are pickles, which are read only with `trust`.
"""

from __future__ import annotations

import json
import math
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from sb3_contrib import MaskablePPO
from stable_baselines3 import PPO
from stable_baselines3.common.save_util import load_from_zip_file

from agents.drivers.base import ActionKind, Info, legal_goals
from agents.drivers.base import Observation as ExploreObservation
from agents.learning.policies import CHOICES, Decision, Hyperparameters, policy_of
from slam_gym.association.tracking import ppo
from slam_gym.association.tracking.walk import COMPATIBILITIES
from slam_gym.association.walks import ORDERS
from slam_gym.weights import Card, Weights

FORMAT = "slam_gym policy 3"
_MAX_BYTES = 1 << 28  # of a file, unpacked
_MAX_VALUES, _MAX_ACTIONS = 1 << 17, 4_096  # of an observation; of a choice


@dataclass(frozen=True)
class About:
    """The description in a model file: enough to rebuild the network, and how it was trained.

    Raises ValueError for values that no training writes.
    """

    action: Decision
    observation: dict[str, list[int]]  # shape of each part of the observation; `image` is uint8, the rest float32
    actions: int  # number of goals or branches, or length of the twist
    hyperparameters: Hyperparameters
    training: dict[str, Any]  # scenario, seed, versions …
    timesteps: int = 0  # decisions so far
    format: str = FORMAT

    def __post_init__(self) -> None:
        sides = [self.actions, *(side for shape in self.observation.values() for side in shape)]
        if self.format != FORMAT or self.action not in (*CHOICES, "twist") or not isinstance(self.training, dict):
            raise ValueError(f"not a {FORMAT!r} file")
        if not all(type(n) is int and n >= 1 for n in sides):
            raise ValueError("its sizes are no positive numbers")
        if sum(map(math.prod, self.observation.values())) > _MAX_VALUES or self.actions > _MAX_ACTIONS:
            raise ValueError("it describes a network larger than any that is trained here")

    @classmethod
    def of(cls, env: gym.Env[Any, Any], action: Decision, hyper: Hyperparameters, training: dict[str, Any]) -> About:
        """The description of a policy before its training on an environment."""
        assert isinstance(env.observation_space, spaces.Dict)
        shapes = {key: list(space.shape or ()) for key, space in env.observation_space.spaces.items()}
        return cls(action, shapes, spaces.flatdim(env.action_space), hyper, training)

    @property
    def network(self) -> tuple[Any, ...]:
        """The values that determine the shapes of its weights."""
        return self.action, self.observation, self.actions, self.hyperparameters.width, self.hyperparameters.hidden

    def policy(self) -> Any:
        """The network, with initial weights."""
        observation = spaces.Dict({
            key: spaces.Box(0, 255, shape, np.uint8) if key == "image" else spaces.Box(-1.0, 1.0, shape, np.float32)
            for key, shape in self.observation.items()
        })  # fmt: skip
        choice, twist = spaces.Discrete(self.actions), spaces.Box(-1.0, 1.0, (self.actions,), np.float32)
        policy, arguments = policy_of(self.action, self.actions, self.hyperparameters)
        return policy(observation, choice if self.action in CHOICES else twist, lambda _: 0.0, **arguments)


def read_about(path: Path) -> About:
    """The description in a model file. Raises ValueError, naming the file, where it is missing, damaged or foreign."""
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(member.file_size for member in archive.infolist()) > _MAX_BYTES:
                raise ValueError(f"is larger than {_MAX_BYTES >> 20} MB")
            data = json.loads(archive.read("data"))
        hyper = Hyperparameters(**data["about"].pop("hyperparameters"))
        return About(**data["about"] | {"timesteps": int(data["num_timesteps"])}, hyperparameters=hyper)
    except OSError:
        raise ValueError(f"model {path}: no such file") from None
    except Exception as error:  # zipfile and json raise various errors
        raise ValueError(
            f"model {path}: refused, it is no model of this package ({type(error).__name__}: {error}); "
            "--trust reads other files of Stable-Baselines3, which can run code"
        ) from None


def load_policy(path: Path) -> tuple[About, Any]:
    """The description in a model file, and its network.

    Raises ValueError as `read_about`, and for weights that are not finite or do not fit the description.
    """
    about = read_about(path)
    try:
        weights = load_from_zip_file(path, load_data=False, device="cpu")[1]["policy"]
        if not all(bool(torch.isfinite(tensor).all()) for tensor in weights.values()):
            raise ValueError("not all weights are finite")
        policy = about.policy()
        policy.load_state_dict(weights)
    except Exception as error:  # torch raises various errors
        reason = (str(error) or type(error).__name__).splitlines()[0][:300]
        raise ValueError(f"model {path}: refused, {reason}") from None
    return about, policy


class PolicyAgent:
    """A driver that is a trained network."""

    name = "ppo"

    def __init__(self, policy: Any, action: ActionKind, *, deterministic: bool) -> None:
        torch.set_num_threads(1)  # more threads are slower for one state at a time
        policy.set_training_mode(False)
        self.action: ActionKind = action
        self._policy, self._deterministic = policy, deterministic

    @classmethod
    def load(cls, path: Path, *, trust: bool = False) -> PolicyAgent:
        """The driver of a model file. `trust` also reads files of Stable-Baselines3 without the entry `about`, by
        unpickling, which can run code: MaskablePPO for goals, PPO for twists."""
        try:
            about, policy = load_policy(path)
        except ValueError:
            if not trust:
                raise
            return cls._trusted(path)
        if about.action == "branch":
            raise ValueError(f"model {path}: an associator, not a driver")
        return cls(policy, about.action, deterministic=about.hyperparameters.deterministic)

    @classmethod
    def _trusted(cls, path: Path) -> PolicyAgent:
        try:
            policy = PPO.load(path, device="cpu").policy
        except (TypeError, KeyError, AssertionError):  # its policy takes masks
            policy = MaskablePPO.load(path, device="cpu").policy
        goal = isinstance(policy.action_space, spaces.Discrete)
        return cls(policy, "goal" if goal else "twist", deterministic=goal)

    def reset(self, seed: int) -> None:
        torch.manual_seed(seed)

    def act(self, observation: ExploreObservation, info: Info) -> int | NDArray[np.float32]:
        masks = {"action_masks": legal_goals(info)} if self.action == "goal" else {}
        action, _ = self._policy.predict(dict(observation), deterministic=self._deterministic, **masks)
        return int(action) if self.action == "goal" else np.asarray(action, np.float32)


def branch_weights(policy: Any, about: About) -> Weights:
    """The arrays of a network trained on Associate-v0, with which `tracking.ppo` associates without torch."""
    net, known, arrays = policy.features_extractor, about.training, {}
    layers = net.embed[0], net.embed[2], net.situation[1], net.score[0], net.score[2]
    for name, layer in zip("ABCDw", layers):
        arrays[name] = layer.weight.detach().numpy().copy()
        arrays["w0" if name == "w" else name.lower()] = layer.bias.detach().numpy().copy()
    walk = known["candidates"], ORDERS.index(known["order"]), COMPATIBILITIES.index(known["compatibility"])
    arrays["walk"] = np.array(walk, np.int64)
    card = Card(ppo.VERSION, ppo.INPUTS, {}, tuple(known["scenario"]), (known["seed"],), known["command"], {})
    return Weights(card, {name: arrays[name] for name in ppo.SHAPES})
