"""Trained networks that decide: drivers (`PolicyAgent`) and associators (`load_associator`), from their model files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from sb3_contrib import MaskablePPO
from stable_baselines3 import PPO
from stable_baselines3.common.save_util import load_from_zip_file

from agents.drivers.base import ActionKind, Info, legal_goals
from agents.drivers.base import Observation as ExploreObservation
from agents.learning.model_file import UNREADABLE, load_policy
from agents.learning.networks import GoalPolicy
from slam_gym.association.tracking.observation import Observation
from slam_gym.association.tracking.policy import from_policy
from slam_gym.types import Associator, BoolArray


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

    def act(self, observation: ExploreObservation, info: Info) -> int | NDArray[np.float32]:
        batch = {key: torch.as_tensor(np.asarray(value))[None] for key, value in observation.items()}
        with torch.no_grad():
            return self._goal(batch, legal_goals(info)) if self.action == "goal" else self._twist(batch)

    def _goal(self, batch: dict[str, torch.Tensor], legal: NDArray[np.bool_]) -> int:
        scores = np.where(legal, self._policy.scores(batch)[0].numpy().astype(float), -np.inf)
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
    except (OSError, *UNREADABLE) as error:
        raise ValueError(f"model {path}: no Stable-Baselines3 model of this package: {error}") from error
    return PolicyAgent(policy, "goal" if goal else "twist", deterministic=goal)


@dataclass(frozen=True)
class BestBranch:
    """The policy that takes the legal branch of the highest score."""

    network: Any  # `BranchPolicy`

    def __call__(self, observation: Observation, mask: BoolArray) -> int:
        batch = {key: torch.from_numpy(value)[None] for key, value in observation.items()}
        with torch.no_grad():
            scores = self.network.scores(batch)[0].numpy()
        return int(np.argmax(np.where(mask, scores, -np.inf)))


def load_associator(path: Path | str) -> Associator:
    """The associator of a model file that `python -m agents.train_associate` wrote; reading it runs no code from it.

    It walks the tree as it was trained to: same K, order and compatibility. Raises ValueError that names the file where
    it is missing, damaged, or no associator.
    """
    spec, network = load_policy(Path(path))
    if spec.action != "branch":
        raise ValueError(f"model {path}: a driver (action {spec.action!r}), not an associator")
    names = ("candidates", "order", "compatibility")
    try:
        arguments = {name: spec.training[name] for name in names}
        return from_policy(BestBranch(for_decisions(network)), **arguments)
    except (KeyError, ValueError, TypeError) as error:
        raise ValueError(f"model {path}: training: {error} is missing or wrong") from None
