"""Model files: the weights of a policy, and what it takes to rebuild its network.

A model file is a `torch.save` of tensors, numbers and text only, so it is read with `weights_only=True`: reading a
stranger's file runs no code. Stable-Baselines3's own .zip files are pickles and need `trust`.
"""

from __future__ import annotations

import io
import json
import pickle
import zipfile
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.policies import MultiInputActorCriticPolicy
from torch import nn

from agents.evaluation.records import written_whole
from agents.learning.model_contents import MAX_BYTES, check_archive, check_description, check_weights
from agents.learning.ppo import SCORING, Decision, Hyperparameters, policy_arguments
from slam_gym._files import content_of

FORMAT = "slam_gym policy 1"
UNREADABLE = (RuntimeError, EOFError, KeyError, TypeError, ValueError, zipfile.BadZipFile, pickle.UnpicklingError)
"""What reading a file raises that is no model."""


@dataclass(frozen=True)
class ModelSpec:
    """What a model file says beside its weights: enough to rebuild the network, and how it was trained."""

    action: Decision
    observation: dict[str, list[int]]  # shape of each entry of the observation; `image` is uint8, the rest float32
    actions: int  # number of goals or branches, or length of the twist
    hyperparameters: dict[str, Any]
    training: dict[str, Any]  # scenario, seed, timesteps, versions …

    @classmethod
    def of(
        cls, env: gym.Env[Any, Any] | Any, action: Decision, hyper: Hyperparameters, training: dict[str, Any]
    ) -> ModelSpec:
        shapes = {key: list(space.shape) for key, space in env.observation_space.spaces.items()}
        actions = int(env.action_space.n) if action in SCORING else int(env.action_space.shape[0])
        return cls(action, shapes, actions, asdict(hyper), training)


def save_model(path: Path, spec: ModelSpec, policy: Any, state: bytes = b"") -> None:
    """Write the file in one piece: an interrupted save leaves the previous file. `state`: of the training, if any."""
    content: dict[str, Any] = {"format": FORMAT, "spec": json.dumps(asdict(spec)), "policy": policy.state_dict()}
    content["optimizer"] = policy.optimizer.state_dict()
    if state:
        content["state"] = torch.frombuffer(bytearray(state), dtype=torch.uint8)
    with written_whole(path) as partial:
        torch.save(content, partial)


def read_model(path: Path) -> tuple[ModelSpec, dict[str, Any]]:
    """Spec and contents of a model file (`policy`, `optimizer`; `state`, of a checkpoint), read without running code.

    ValueError names the file where it is missing, damaged, or not a model of this package.
    """
    if not path.is_file():
        raise ValueError(f"model {path}: no such file")
    try:
        archive = content_of(path, MAX_BYTES)
        check_archive(archive)
        content = torch.load(io.BytesIO(archive), map_location="cpu", weights_only=True)
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            raise ValueError(f"not a {FORMAT!r} file")
        check_weights(content)
        spec = ModelSpec(**json.loads(content["spec"]))
        check_description(**{field.name: getattr(spec, field.name) for field in fields(spec)})
        return spec, content
    except Exception as error:  # torch raises whatever the damage leads to
        reason = (str(error) or type(error).__name__).splitlines()[0][:300]
        if isinstance(error, pickle.UnpicklingError):  # torch's own words advise to read it all the same
            reason = "it is no model file, or holds code beside weights and text"
        hint = " (a Stable-Baselines3 .zip is a pickle: --trust reads it)" if path.suffix == ".zip" else ""
        raise ValueError(f"model {path}: refused, {reason}{hint}") from error


def build_policy(spec: ModelSpec) -> nn.Module:
    """The network of a spec, with fresh weights."""
    shapes = {key: tuple(shape) for key, shape in spec.observation.items()}
    observation = spaces.Dict({
        key: spaces.Box(0, 255, shape, np.uint8) if key == "image" else spaces.Box(-1.0, 1.0, shape, np.float32)
        for key, shape in shapes.items()
    })  # fmt: skip
    hyper = Hyperparameters(**spec.hyperparameters)
    arguments = policy_arguments(spec.action, hyper)
    if spec.action in SCORING:
        return SCORING[spec.action](
            observation, spaces.Discrete(spec.actions), lambda _: hyper.learning_rate, **arguments
        )
    twist = spaces.Box(-1.0, 1.0, (spec.actions,), np.float32)
    return MultiInputActorCriticPolicy(observation, twist, lambda _: hyper.learning_rate, **arguments)


def load_policy(path: Path) -> tuple[ModelSpec, Any]:
    """Spec and network of a model file. ValueError as `read_model`, and where its weights do not fit its spec."""
    spec, content = read_model(path)
    try:
        policy = build_policy(spec)
        policy.load_state_dict(content["policy"])
    except Exception as error:  # so do torch, Stable-Baselines3 and gymnasium for layers that do not fit
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise ValueError(f"model {path}: weights and description do not fit: {reason}") from error
    return spec, policy
