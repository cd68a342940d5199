"""Trained policies of Associate-v0 as associators: `load(FILE)`, or `model:FILE` where a command takes associators."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch

from agents.learning.ppo import for_decisions, load_policy
from slam_gym.association.tracking.observation import Observation
from slam_gym.association.tracking.policy import Policy, from_policy
from slam_gym.types import Associator, BoolArray


@dataclass(frozen=True)
class BestBranch:
    """The policy that takes the legal branch of the highest score."""

    network: Any  # `BranchPolicy`

    def __call__(self, observation: Observation, mask: BoolArray) -> int:
        batch = {key: torch.from_numpy(value)[None] for key, value in observation.items()}
        with torch.no_grad():
            scores = self.network.branch_scores(batch)[0].numpy()
        return int(np.argmax(np.where(mask, scores, -np.inf)))


def load(path: Path | str) -> Associator:
    """The associator of a model file that `python -m agents.train_associate` wrote; reading it runs no code from it.

    It walks the tree as it was trained to: same K, order and compatibility. Raises ValueError that names the file where
    it is missing, damaged, or no associator.
    """
    spec, network = load_policy(Path(path))
    if spec.action != "branch":
        raise ValueError(f"model {path}: a driver (action {spec.action!r}), not an associator")
    names = ("candidates", "order", "compatibility")
    return from_policy(BestBranch(for_decisions(network)), **{name: spec.training[name] for name in names})


def associate_episode(env: gym.Env[Any, Any], policy: Policy, episode: int) -> dict[str, Any]:
    """Associate the i-th episode of a split to its end: return, decisions, score and map error of the episode."""
    observation, info = env.reset(seed=episode, options={"world": episode})
    total, count, over = 0.0, 0, False
    while not over:
        action = policy(observation, info["action_mask"])
        observation, reward, terminated, truncated, info = env.step(action)
        total, count, over = total + float(reward), count + 1, terminated or truncated
    return {"return": total, "decisions": count, "score": info["score"], "map_error": info["map_error"]}
