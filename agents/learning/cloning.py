"""Supervised learning: the loop that fits a network to examples and the figures of its card, for the learned driver and
the learned associator; and behaviour cloning, by which a policy of the interpretation tree learns to decide as an
associator does, before PPO."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar

import gymnasium as gym
import numpy as np
import torch
from torch import Tensor, nn

from agents.record_decisions import decisions
from slam_gym.types import IntArray

T = TypeVar("T")

_DECAY, _LARGEST = 1e-2, 1.0  # of the weights, in each step; norm of the gradient

EPISODES = 4  # recorded in each scenario
FIRST_WORLD = 20_000  # of the train split
_STEPS, _BATCH, _RATE = 800, 1_024, 2e-3


def fit(
    parameters: Sequence[Tensor],
    batches: Sequence[T],
    loss: Callable[[T], Tensor],
    judge: Callable[[], float],
    epochs: int,
    rate: float,
    rng: np.random.Generator,
) -> list[float]:
    """Minimise the loss over the batches by AdamW; returns the result of `judge` after each epoch.

    The learning rate rises to `rate`, and falls to almost 0 (one cycle; Smith and Topin 2019).
    """
    torch.set_num_threads(1)  # sums in one order, or the weights would depend on the number of cores
    optimizer = torch.optim.AdamW(parameters, lr=rate, weight_decay=_DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, rate, total_steps=epochs * len(batches))
    curve = []
    for _ in range(epochs):
        for k in rng.permutation(len(batches)).tolist():
            optimizer.zero_grad()
            loss(batches[k]).backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(parameters, _LARGEST)
            optimizer.step()
            schedule.step()
        with torch.no_grad():
            curve.append(judge())
    return curve


def figure(values: Sequence[float], error: float = 0.0) -> dict[str, float]:
    """A metric of a card, which is not negative: the mean over seeds, with an interval of three standard deviations of
    one seed to either side, but at least 2 % of the mean and at least `error`."""
    mean = math.fsum(values) / len(values)
    spread = math.sqrt(math.fsum((v - mean) ** 2 for v in values) / max(len(values) - 1, 1))
    margin = max(3.0 * spread, 0.02 * abs(mean), error)  # rounding differs between machines
    return {"estimate": mean, "low": max(0.0, mean - margin), "high": mean + margin}


# -- behaviour cloning -------------------------------------------------------------------------------------------------


def clone(policy: Any, envs: Iterable[gym.Env[Any, Any]], associator: str, seed: int) -> list[float]:
    """Fit a policy of Stable-Baselines3 to the decisions of an associator in each environment, of which
    `true_association` decides by the truth. Returns the mean −log p of these decisions after each epoch. Raises
    ValueError for an unknown associator."""
    worlds = range(FIRST_WORLD, FIRST_WORLD + EPISODES)
    decided = [own for env in envs for own in decisions(env, associator, worlds)]
    masks, actions = (
        torch.as_tensor(np.concatenate([getattr(own, name) for own in decided])) for name in ("masks", "actions")
    )
    observations = {
        name: torch.as_tensor(np.concatenate([own.observations[name][:-1] for own in decided]))
        for name in decided[0].observations
    }
    order = np.random.default_rng(seed).permutation(len(actions))
    batches = np.array_split(order, max(len(order) // _BATCH, 1))

    def surprise(rows: IntArray) -> Tensor:
        seen = {name: part[rows] for name, part in observations.items()}
        _, log_probability, _ = policy.evaluate_actions(seen, actions[rows], action_masks=masks[rows])
        return -log_probability.mean()

    def judge() -> float:
        return float(np.mean([float(surprise(rows)) for rows in batches]))

    epochs = max(_STEPS // len(batches), 1)
    return fit(list(policy.parameters()), batches, surprise, judge, epochs, _RATE, np.random.default_rng(seed))
