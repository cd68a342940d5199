"""Train the learned log odds: cross-entropy of the right decision under the marginals of the hypotheses kept.

The hypotheses of a scan have log densities by the model; the network adds to each the odds of its pairings. What a
measurement is decided is as probable as the hypotheses that decide it so, together: that of the right decision is what
is maximised. So what is learned is what the marginals lack, and they come out calibrated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from agents.learning.associator.decisions import Batch, Decisions, flat
from slam_gym.association.learned.network import FARTHEST, Network
from slam_gym.types import Array

_ENOUGH = 16.0  # log odds
_PARAMETERS = {
    "centre": "centre", "scale": "scale", "linear": "linear.weight", "offset": "linear.bias",
    "first": "first.weight", "first_offset": "first.bias", "second": "second.weight", "second_offset": "second.bias",
    "last": "last.weight",
}  # fmt: skip
"""What torch calls each array of `Network`."""


@dataclass(frozen=True)
class Training:
    """Hyperparameters."""

    hidden: int = 24  # 0: a logistic model
    epochs: int = 14
    batch: int = 64  # scans
    rate: float = 4e-3  # of Adam, falling to nothing by a cosine
    decay: float = 1e-2  # of the weights
    seed: int = 0


class Losses(NamedTuple):
    """Mean cross-entropy [nat] of a decision, and of the decisions that a hypothesis of the search makes rightly."""

    model: float  # without the network
    train: float
    curve: tuple[float, ...]  # held out, after each epoch

    @property
    def held_out(self) -> float:
        return self.curve[-1]


class Odds(nn.Module):
    """`slam_gym.association.learned.network`, to be trained."""

    def __init__(self, centre: Array, scale: Array, hidden: int) -> None:
        super().__init__()
        n = len(centre)
        self.register_buffer("centre", torch.tensor(centre, dtype=torch.float32))
        self.register_buffer("scale", torch.tensor(scale, dtype=torch.float32))
        self.linear = nn.Linear(n, 1)
        self.first = nn.Linear(n, hidden)
        self.second = nn.Linear(3 * hidden, hidden)
        self.last = nn.Linear(hidden, 1, bias=False)
        for layer in (self.linear, self.last):  # training starts at the model
            for parameter in layer.parameters():
                nn.init.zeros_(parameter)
        self.hidden = hidden

    def forward(self, batch: TensorBatch) -> Tensor:
        given = (batch.inputs - self.centre) / self.scale
        x = given.clamp(-FARTHEST, FARTHEST)
        trust = 0.5 ** (x != given).sum(dim=1)
        out = self.linear(x)[:, 0]
        if not self.hidden:
            return trust * self._limited(out)
        own = torch.relu(self.first(x))
        pooled = [own, _most(own, batch.measured), _most(own, batch.slots)]
        return trust * self._limited(out + self.last(torch.relu(self.second(torch.cat(pooled, dim=1))))[:, 0])

    def _limited(self, odds: Tensor) -> Tensor:
        """In training none beyond `_ENOUGH`: what is decided pulls no weight any further, and what nobody has trained
        on meets weights that are small."""
        return odds.clamp(-_ENOUGH, _ENOUGH) if self.training else odds

    @classmethod
    def of(cls, network: Network) -> Odds:
        """The same as one that ships, fit to be judged."""
        found = cls(network.centre, network.scale, len(network.last))
        given = {parameter: getattr(network, name) for name, parameter in _PARAMETERS.items()}
        for name, own in found.state_dict().items():
            own.copy_(torch.from_numpy(given[name]).reshape(own.shape))
        return found.eval()

    def arrays(self) -> dict[str, Array]:
        """As `network_of` takes them."""
        state = {name: value.detach().numpy().copy() for name, value in self.state_dict().items()}
        arrays = {name: state[parameter] for name, parameter in _PARAMETERS.items()}
        return arrays | {name: arrays[name][0] for name in ("linear", "last")}  # of one score, not of a row of them


class TensorBatch(NamedTuple):
    """`Batch` for torch."""

    inputs: Tensor
    measured: Tensor
    slots: Tensor
    scores: Tensor
    scan_of: Tensor
    made: Tensor
    agreed: Tensor
    known: Tensor
    weights: Tensor
    measurements: int

    @classmethod
    def of(cls, batch: Batch) -> TensorBatch:
        return cls(*(torch.from_numpy(np.ascontiguousarray(array)) for array in batch[:-1]), batch.measurements)


def _most(values: Tensor, group: Tensor) -> Tensor:
    """The greatest of each column (c, h) among those of the same group (c,); values are not negative."""
    out = torch.zeros(int(group.max()) + 1, values.shape[1])
    index = group.long()[:, None].expand_as(values)
    return out.scatter_reduce(0, index, values, "amax").gather(0, index)


def probabilities(odds: Tensor, batch: TensorBatch) -> Tensor:
    """(k,) of the right decision on each measurement of which it is known."""
    scores = batch.scores.index_add(0, batch.made[:, 0], odds[batch.made[:, 1]])
    most = torch.full((int(batch.scan_of.max()) + 1,), -torch.inf)
    most = most.scatter_reduce(0, batch.scan_of, scores.detach(), "amax")
    weights = torch.exp(scores - most[batch.scan_of])
    weights = weights / torch.zeros(len(most)).index_add(0, batch.scan_of, weights)[batch.scan_of]
    right = torch.zeros(batch.measurements).index_add(0, batch.agreed[:, 1], weights[batch.agreed[:, 0]])
    return right[batch.known]


def loss_of(odds: Tensor, batch: TensorBatch, least: float = 1e-4) -> Tensor:
    """Weighted mean of −log p, p not below `least`: what no hypothesis decides rightly teaches nothing."""
    p = probabilities(odds, batch)
    return -(batch.weights * torch.log(p.clamp(least, 1.0))).sum() / batch.weights.sum()


def scale_of(scans: Sequence[Decisions]) -> tuple[Array, Array]:
    """Mean and standard deviation of the inputs over all pairings; where one never varies, 1."""
    inputs = np.concatenate([d.inputs for d in scans]).astype(np.float64)
    deviation = inputs.std(axis=0)
    return inputs.mean(axis=0), np.where(deviation > 1e-3, deviation, 1.0)


def fit(train: Sequence[Decisions], held_out: Sequence[Decisions], how: Training) -> tuple[Odds, Losses]:
    """Train on some scans, and judge on others."""
    torch.manual_seed(how.seed)
    torch.set_num_threads(1)
    rng = np.random.default_rng(how.seed)
    batches = batches_of([train[k] for k in rng.permutation(len(train)).tolist()], how.batch)
    network = Odds(*scale_of(train), how.hidden)
    optimizer = torch.optim.AdamW(network.parameters(), lr=how.rate, weight_decay=how.decay)
    steps = how.epochs * len(batches)
    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda k: 0.5 + 0.5 * math.cos(math.pi * k / steps))
    others, curve = batches_of(held_out, how.batch), []
    for _ in range(how.epochs):
        network.train()
        for k in rng.permutation(len(batches)).tolist():
            optimizer.zero_grad()
            loss_of(network(batches[k]), batches[k]).backward()
            nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimizer.step()
            schedule.step()
        curve.append(mean_loss(network.eval(), others))
    return network, Losses(mean_loss(None, others), mean_loss(network, batches), tuple(curve))


def mean_loss(network: Odds | None, batches: Sequence[TensorBatch]) -> float:
    """Over batches, by the network or by the model alone."""
    with torch.no_grad():
        found = [loss_of(network(b) if network else torch.zeros(len(b.inputs)), b) * b.weights.sum() for b in batches]
    total = sum(float(b.weights.sum()) for b in batches)
    return float(sum(found)) / total if total else math.nan


def batches_of(scans: Sequence[Decisions], size: int) -> list[TensorBatch]:
    """Of so many scans each, in their order."""
    return [TensorBatch.of(flat(scans[at : at + size])) for at in range(0, len(scans), size)]
