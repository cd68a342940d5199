"""Learned drivers: PPO on `twist`, MaskablePPO on `goal`, and the model file that holds them.

A model file is a `torch.save` of tensors, numbers and text only, so it is read with `weights_only=True`: reading a
stranger's file runs no code. Stable-Baselines3's own .zip files are pickles and need `trust`.
"""

from __future__ import annotations

import json
import os
import pickle
import tomllib
import zipfile
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Literal

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from sb3_contrib import MaskablePPO
from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import MultiInputActorCriticPolicy
from stable_baselines3.common.save_util import load_from_zip_file
from torch import nn

from agents.drivers.base import ActionKind, Info, Observation, legal_goals
from agents.learning.association_networks import BranchPolicy
from agents.learning.networks import GoalPolicy, SituationEncoder

FORMAT = "slam_gym policy 1"

Task = Literal["goal", "twist", "branch"]
"""What a policy decides: goals or twists in Explore-v0, branches of the interpretation tree in Associate-v0."""

_MASKED: dict[str, type[GoalPolicy] | type[BranchPolicy]] = {"goal": GoalPolicy, "branch": BranchPolicy}

HYPERPARAMETERS = Path(__file__).with_name("hyperparameters.toml")


@dataclass(frozen=True)
class Hyperparameters:
    """Of one training run; the file beside this module has the defaults and says what they mean."""

    envs: int
    steps: int
    batch_size: int
    epochs: int
    learning_rate: float
    discount: float
    gae_lambda: float
    clip_range: float
    entropy_coefficient: float
    value_coefficient: float
    reward_scale: float
    width: int
    hidden: int
    deterministic: bool


def load_hyperparameters(action: Task, path: Path = HYPERPARAMETERS) -> Hyperparameters:
    """The table `[goal]`, `[twist]` or `[branch]` of a TOML file. ValueError names the file and what is wrong in it."""
    try:
        table = tomllib.loads(path.read_text()).get(action)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ValueError(f"{path}: {error}") from error
    known = {field.name for field in fields(Hyperparameters)}
    if not isinstance(table, dict) or set(table) != known:
        wrong = known.symmetric_difference(table) if isinstance(table, dict) else {f"[{action}]"}
        raise ValueError(
            f"{path}: table [{action}] must have exactly {', '.join(sorted(known))}; wrong: {sorted(wrong)}"
        )
    return Hyperparameters(**table)


@dataclass(frozen=True)
class ModelSpec:
    """What a model file says beside its weights: enough to rebuild the network, and how it was trained."""

    action: Task
    observation: dict[str, list[int]]  # shape of each entry of the observation; `image` is uint8, the rest float32
    actions: int  # number of goals or branches, or length of the twist
    hyperparameters: dict[str, Any]
    training: dict[str, Any]  # scenario, seed, timesteps, versions …

    @classmethod
    def of(
        cls, env: gym.Env[Any, Any] | Any, action: Task, hyper: Hyperparameters, training: dict[str, Any]
    ) -> ModelSpec:
        shapes = {key: list(space.shape) for key, space in env.observation_space.spaces.items()}
        actions = int(env.action_space.n) if action in _MASKED else int(env.action_space.shape[0])
        return cls(action, shapes, actions, asdict(hyper), training)


def policy_arguments(action: Task, hyper: Hyperparameters) -> dict[str, Any]:
    """Arguments that both the trainer and the loader build the network from."""
    if action in _MASKED:
        return {"width": hyper.width, "hidden": hyper.hidden}
    arguments = {"features_extractor_class": SituationEncoder, "features_extractor_kwargs": {"width": hyper.width}}
    return arguments | {"net_arch": {"pi": [hyper.hidden] * 2, "vf": [hyper.hidden] * 2}}


def make_algorithm(action: Task, env: Any, hyper: Hyperparameters, seed: int) -> BaseAlgorithm:
    """A fresh learner on a vectorised environment."""
    cls, policy = (MaskablePPO, _MASKED[action]) if action in _MASKED else (PPO, MultiInputActorCriticPolicy)
    return cls(
        policy, env, learning_rate=hyper.learning_rate, n_steps=hyper.steps, batch_size=hyper.batch_size,
        n_epochs=hyper.epochs, gamma=hyper.discount, gae_lambda=hyper.gae_lambda, clip_range=hyper.clip_range,
        ent_coef=hyper.entropy_coefficient, vf_coef=hyper.value_coefficient, seed=seed, device="cpu",
        policy_kwargs=policy_arguments(action, hyper),
    )  # fmt: skip


def save_model(path: Path, spec: ModelSpec, policy: Any) -> None:
    """Write the file in one piece: an interrupted save leaves the previous file."""
    content = {"format": FORMAT, "spec": json.dumps(asdict(spec)), "policy": policy.state_dict()}
    content["optimizer"] = policy.optimizer.state_dict()
    partial = path.with_name(path.name + ".partial")
    torch.save(content, partial)
    os.replace(partial, path)


_UNREADABLE = (RuntimeError, EOFError, KeyError, TypeError, ValueError, zipfile.BadZipFile, pickle.UnpicklingError)


def read_model(path: Path) -> tuple[ModelSpec, dict[str, Any]]:
    """Spec and contents (`policy`, `optimizer`) of a model file, read without running code from it.

    ValueError names the file where it is missing, damaged, or not a model of this package.
    """
    if not path.is_file():
        raise ValueError(f"model {path}: no such file")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            raise ValueError(f"not a {FORMAT!r} file")
        return ModelSpec(**json.loads(content["spec"])), content
    except _UNREADABLE as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
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
    if spec.action in _MASKED:
        return _MASKED[spec.action](
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
    except (RuntimeError, TypeError, KeyError) as error:
        raise ValueError(f"model {path}: weights and description do not fit: {str(error).splitlines()[0]}") from error
    return spec, policy


def for_decisions(policy: Any) -> Any:
    """The network, set to decide. One thread: for one state at a time, more only get in each other's way."""
    policy.set_training_mode(False)
    torch.set_num_threads(1)
    return policy


class PolicyAgent:
    """A trained network at the wheel."""

    name = "ppo"

    def __init__(self, policy: Any, action: ActionKind, *, deterministic: bool) -> None:
        self.action: ActionKind = action
        self._policy, self._deterministic = for_decisions(policy), deterministic
        self.reset(0)

    @classmethod
    def load(cls, path: Path, *, trust: bool = False) -> PolicyAgent:
        """From a model file. `trust` reads Stable-Baselines3's .zip as well, which can run code."""
        if trust and path.suffix == ".zip":
            return _load_zip(path)
        spec, policy = load_policy(path)
        if spec.action == "branch":
            raise ValueError(f"model {path}: an associator, not a driver")
        return cls(policy, spec.action, deterministic=bool(spec.hyperparameters["deterministic"]))

    def reset(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)

    def act(self, observation: Observation, info: Info) -> int | NDArray[np.float32]:
        batch = {key: torch.as_tensor(np.asarray(value))[None] for key, value in observation.items()}
        with torch.no_grad():
            return self._goal(batch, legal_goals(info)) if self.action == "goal" else self._twist(batch)

    def _goal(self, batch: dict[str, torch.Tensor], legal: NDArray[np.bool_]) -> int:
        scores = np.where(legal, self._policy.goal_scores(batch)[0].numpy().astype(float), -np.inf)
        if self._deterministic:
            return int(np.argmax(scores))
        weights = np.exp(scores - scores.max())
        return int(self._rng.choice(len(scores), p=weights / weights.sum()))

    def _twist(self, batch: dict[str, torch.Tensor]) -> NDArray[np.float32]:
        normal = self._policy.get_distribution(batch).distribution
        mean, sigma = normal.mean[0].numpy(), normal.stddev[0].numpy()
        drawn = mean if self._deterministic else self._rng.normal(mean, sigma)
        return np.clip(drawn, -1.0, 1.0).astype(np.float32)


def _load_zip(path: Path) -> PolicyAgent:
    """Stable-Baselines3's own format: MaskablePPO where its policy scores goals, else PPO."""
    try:
        data = load_from_zip_file(path, device="cpu")[0] or {}
        goal = issubclass(data["policy_class"], GoalPolicy)
        policy = (MaskablePPO if goal else PPO).load(path, device="cpu").policy
    except (OSError, *_UNREADABLE) as error:
        raise ValueError(f"model {path}: no Stable-Baselines3 model of this package: {error}") from error
    return PolicyAgent(policy, "goal" if goal else "twist", deterministic=goal)
