"""Behaviour cloning: a policy of the interpretation tree learns to decide as an associator does, before PPO goes on."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from torch import Tensor

from agents.learning.fitting import fit
from agents.record_decisions import Decided, decisions

EPISODES = 4  # recorded in each scenario
FIRST_WORLD = 20_000  # of the train split
_STEPS, _BATCH, _RATE = 800, 1_024, 2e-3

Batch = tuple[dict[str, Tensor], Tensor, Tensor]
"""Observations, masks and actions of b decisions."""


def clone(policy: Any, envs: Iterable[gym.Env[Any, Any]], associator: str, seed: int) -> list[float]:
    """Fit a policy of Stable-Baselines3 to what an associator decides in each environment, `true_association` what the
    truth decides: the mean −log p of its decisions after each epoch. ValueError for an associator that nobody knows."""
    worlds = range(FIRST_WORLD, FIRST_WORLD + EPISODES)
    batches = _batches([own for env in envs for own in decisions(env, associator, worlds)], seed)

    def surprise(batch: Batch) -> Tensor:
        observations, masks, actions = batch
        _, log_probability, _ = policy.evaluate_actions(observations, actions, action_masks=masks)
        return -log_probability.mean()

    def judge() -> float:
        return float(np.mean([float(surprise(batch)) for batch in batches]))

    epochs = max(_STEPS // len(batches), 1)
    return fit(list(policy.parameters()), batches, surprise, judge, epochs, _RATE, np.random.default_rng(seed))


def _batches(decided: list[Decided], seed: int) -> list[Batch]:
    masks, actions = (np.concatenate([getattr(own, name) for own in decided]) for name in ("masks", "actions"))
    observations = {
        name: torch.as_tensor(np.concatenate([own.observations[name][:-1] for own in decided]))
        for name in decided[0].observations
    }
    order = np.random.default_rng(seed).permutation(len(actions))
    return [
        ({name: part[rows] for name, part in observations.items()}, torch.as_tensor(masks[rows]),
         torch.as_tensor(actions[rows]))
        for rows in np.array_split(order, max(len(order) // _BATCH, 1))
    ]  # fmt: skip
