"""Training of the driver's network: by how much each goal of a state beats the mean of all, as the teacher has it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from agents.drivers.goal_network import Size
from agents.learning.driver.examples import Examples
from agents.learning.driver.network import GoalNetwork
from slam_gym.types import Array


@dataclass(frozen=True)
class Training:
    """How the network is trained."""

    epochs: int = 20
    batch: int = 128
    rate: float = 1e-3  # at its highest: it rises, and falls to nothing
    decay: float = 1e-2  # of the weights
    most: float = 2.0  # [.01 E] beyond which an error counts linearly
    seed: int = 0


class Regrets(NamedTuple):
    """[.01 E] by which the goals that somebody chooses are worse than the best, (n,) one a state."""

    learned: Array
    greedy: Array


def fit(
    train: Examples, size: Size, training: Training, after_epoch: Callable[[GoalNetwork], None] = lambda network: None
) -> GoalNetwork:
    """A network that predicts the values of goals, up to what they have in common."""
    torch.set_num_threads(1)  # sums in one order, or the weights would depend on the number of cores
    torch.manual_seed(training.seed)
    rng, network = np.random.default_rng(training.seed), GoalNetwork(size)
    own = train.tokens[train.legal]
    network.shift[:] = torch.as_tensor(own.mean(axis=0))
    network.scale[:] = torch.as_tensor(1.0 / (own.std(axis=0) + 0.05))
    inputs, values = _tensors(train)
    optimizer = torch.optim.AdamW(network.parameters(), lr=training.rate, weight_decay=training.decay)
    batches = -(-len(train) // training.batch)
    plan = torch.optim.lr_scheduler.OneCycleLR(optimizer, training.rate, total_steps=training.epochs * batches)
    for _ in range(training.epochs):
        for rows in np.array_split(rng.permutation(len(train)), batches):
            chosen = torch.as_tensor(rows)
            loss = _loss(network(*(part[chosen] for part in inputs)), values[chosen], inputs[-1][chosen], training.most)
            optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimizer.step()
            plan.step()
        after_epoch(network)
    return network.eval()


def regrets(networks: list[GoalNetwork], examples: Examples) -> Regrets:
    """What the mean of the networks loses by its choices, and what the greedy driver loses."""
    inputs, _ = _tensors(examples)
    with torch.no_grad():
        scores = torch.stack([network(*inputs) for network in networks]).mean(dim=0).numpy()
    return Regrets(_regret(scores, examples), _regret(examples.greedy, examples))


def _regret(scores: Array, examples: Examples) -> Array:
    values = np.where(examples.legal, examples.values, -np.inf)
    chosen = np.where(examples.legal, scores, -np.inf).argmax(axis=1)
    regret: Array = values.max(axis=1) - values[np.arange(len(values)), chosen]
    return regret


def _tensors(examples: Examples) -> tuple[list[Tensor], Tensor]:
    """Inputs of the network, and the values."""
    numbers = [torch.as_tensor(part, dtype=torch.float32) for part in (examples.tokens, examples.gaps, examples.greedy)]
    return [*numbers, torch.as_tensor(examples.legal)], torch.as_tensor(examples.values, dtype=torch.float32)


def _loss(scores: Tensor, values: Tensor, legal: Tensor, most: float) -> Tensor:
    """Huber's, of scores and values above their means over the legal goals, summed over goals."""
    off = (scores - values).masked_fill(~legal, 0.0)
    off = (off - off.sum(dim=1, keepdim=True) / legal.sum(dim=1, keepdim=True)).masked_fill(~legal, 0.0)
    return nn.functional.huber_loss(off, torch.zeros_like(off), reduction="sum", delta=most) / len(off)
