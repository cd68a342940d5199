"""The training of the learned associator, from worlds to weights.

The hypotheses of a scan have log densities by the model; the network adds to each the odds of its pairings. What a
measurement is decided is as probable as the hypotheses that decide it so, together: that of the right decision is what
is maximised. So what is learned is what the marginals lack, and they come out calibrated.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from agents.learning.association_scans import HIDDEN, LEVELS, LOGS, LOOPS, VIEWS, VIEWS_AND_SIZES, Decisions, Source
from slam_gym.association.tracking.learned import WEIGHTS
from slam_gym.association.tracking.network import FARTHEST, INPUTS, VERSION, Network, load_network
from slam_gym.types import UNPAIRED, Array
from slam_gym.weights import Card, Weights, figure

HIDDEN_LOOPS = (
    *(("sizes", 6, name) for name in ("office", "drift-2", "hall", "crowd-drift")),
    *(("all but places", 7, name) for name in ("crowd", "drift-3", "aliased-drift", "loop")),
    *((VIEWS, 8, name) for name in ("office", "crowd", "drift-1", "drift-2", "aliased", "hall-drift", "sparse")),
    *((VIEWS_AND_SIZES, 9, name) for name in ("office", "drift-1", "drift-3", "hall", "sparse", "loop")),
)
"""Further runs: what is hidden, the world, and the scenario."""

SHARES = {"level": 0.5, "loop": 0.45, "log": 0.05}
"""What each kind of source counts in all, however many scans it has."""

_HIDDEN_COUNT = 4.0  # what a scan counts of which something is hidden: there are few, and many a user has no more
_ENOUGH = 16.0  # log odds
_LEAST = 1e-4  # probability: what no hypothesis decides rightly teaches nothing
_DECAY = 1e-2  # of the weights


@dataclass(frozen=True)
class Plan:
    """What is looked at, in train worlds, and how the network is trained on it."""

    levels: Sequence[str] = LEVELS
    level_worlds: int = 16
    whole: int = 12  # of them in which nothing is hidden; then sizes and more are, in turn
    loops: Sequence[str] = LOOPS
    loop_worlds: int = 6
    hidden: Sequence[tuple[str, int, str]] = HIDDEN_LOOPS
    logs: Sequence[str] = LOGS
    held_out: int = 4  # worlds of each level, after those trained on
    seeds: Sequence[int] = (0, 1)  # the one that is best on what is held out ships
    hidden_numbers: int = 24  # 0: a logistic model
    epochs: int = 14
    rate: float = 4e-3  # of Adam, falling to nothing by a cosine


QUICK = Plan(
    levels=("clutter/2", "detection/2", "closure/3"), level_worlds=2, whole=2, loops=(), hidden=(), logs=(),
    held_out=1, epochs=6,
)  # fmt: skip
_BATCH = 64  # scans


def reproduce(quick: bool, command: str, say: Callable[[str], None]) -> Weights:
    """The weights of the best seed on what is held out; the figures of the card are those of all seeds.

    Raises ValueError where `SLAM_GYM_DATA` does not say where the recordings are, unless it is a quick one.
    """
    plan = QUICK if quick else Plan()
    if plan.logs and not os.environ.get("SLAM_GYM_DATA"):
        raise ValueError("SLAM_GYM_DATA is not set: the training looks at Victoria Park and MR.CLAM as well")
    train, held_out = (look(found, say) for found in sources(plan))
    fits = []
    for seed in plan.seeds:
        network, losses = fit(plan, train, held_out, seed)
        say(f"seed {seed}: cross-entropy held out, by epoch: {' '.join(f'{loss:.4f}' for loss in losses.curve)}")
        say(f"seed {seed}: cross-entropy {losses.held_out:.4f} held out, {losses.model:.4f} by the model alone")
        fits.append((network, losses))
    metrics = {
        "cross-entropy held out": figure([losses.held_out for _, losses in fits]),
        "cross-entropy trained on": figure([losses.train for _, losses in fits]),
        "cross-entropy held out, the model alone": figure([losses.model for _, losses in fits]),
        "scans": figure([float(len(train))]),
    } | _of_shipped(held_out)
    names = (*plan.levels, *plan.loops, *(f"recording:{name}" for name in plan.logs))
    card = Card(VERSION, INPUTS, {}, names, tuple(plan.seeds), command, metrics)
    best = min(range(len(fits)), key=lambda k: fits[k][1].held_out)
    return Weights(card, fits[best][0].arrays())


def _of_shipped(held_out: Sequence[Decisions]) -> dict[str, dict[str, float]]:
    """What the weights that ship come to on the same scans; nothing where they were made for other inputs."""
    try:
        network = load_network(WEIGHTS, VERSION, INPUTS)
    except ValueError:
        return {}
    loss = mean_loss(Odds.of(network), batches_of(held_out))
    return {"cross-entropy held out, the weights that ship": figure([loss])}


def sources(plan: Plan) -> tuple[list[Source], list[Source]]:
    """What is trained on, and what is held out."""
    first, last = plan.level_worlds, plan.level_worlds + plan.held_out
    hidden = [HIDDEN[0] if k < plan.whole else HIDDEN[k % len(HIDDEN)] for k in range(last)]
    train = [Source("level", name, k, hidden=hidden[k]) for k in range(first) for name in plan.levels]
    train += [Source("loop", name, k) for k in range(plan.loop_worlds) for name in plan.loops]
    train += [Source("loop", name, k, hidden=hidden) for hidden, k, name in plan.hidden]
    for k, associator in enumerate(("map_hypothesis", "marginal")):  # whose maps go wrong in other ways
        train += [Source("log", name, k, associator) for name in plan.logs]
    return train, [Source("level", name, k, hidden=hidden[k]) for k in range(first, last) for name in plan.levels]


def look(found: Sequence[Source], say: Callable[[str], None]) -> list[Decisions]:
    """The decisions of all sources, in their order, weighed by kind."""
    kinds: dict[str, list[Decisions]] = {}
    for source in found:
        began, own = time.perf_counter(), list(source.scans())
        say(f"{source.name}, world {source.world}: {len(own)} scans in {time.perf_counter() - began:.1f} s")
        factor = 1.0 if source.hidden == HIDDEN[0] else _HIDDEN_COUNT
        kinds.setdefault(source.kind, []).extend(d._replace(weight=d.weight * factor) for d in own)
    return weighed(kinds)


def weighed(kinds: Mapping[str, Sequence[Decisions]]) -> list[Decisions]:
    """All scans, each kind of source with its share of the weight; the mean weight is 1."""
    count, scans = sum(map(len, kinds.values())), []
    shared = sum(SHARES[kind] for kind in kinds)
    for kind, own in kinds.items():
        factor = SHARES[kind] / shared * count / max(sum(d.weight for d in own), 1e-9)
        scans += [d._replace(weight=d.weight * factor) for d in own]
    return scans


# -- the network -------------------------------------------------------------------------------------------------------


class Batch(NamedTuple):
    """Many scans, flat: every number of a pairing, hypothesis or measurement counts through all of them."""

    inputs: Tensor  # (C, inputs)
    measured: Tensor  # (C,)
    slots: Tensor  # (C,)
    scores: Tensor  # (H,)
    scan_of: Tensor  # (H,) scan of each hypothesis
    made: Tensor  # (p, 2) hypothesis and pairing: it makes it
    agreed: Tensor  # (r, 2) hypothesis and measurement: it decides it rightly
    known: Tensor  # (k,) measurements of which it is known
    weights: Tensor  # (k,) what each counts
    measurements: int

    @classmethod
    def of(cls, scans: Sequence[Decisions]) -> Batch:
        """Some scans as one batch."""
        parts: list[tuple[Array, ...]] = []
        pairings = hypotheses = measurements = slots = 0
        for number, d in enumerate(scans):
            b, m = d.hypotheses.shape
            at, who = np.nonzero(d.hypotheses != UNPAIRED)
            made = np.column_stack([at + hypotheses, d.hypotheses[at, who] + pairings])
            agreed = np.where(d.hypotheses == UNPAIRED, d.unpaired, np.append(d.right, False)[d.hypotheses])
            rightly = np.argwhere(agreed & d.known) + np.array([hypotheses, measurements])
            known = np.flatnonzero(d.known)
            weights = np.full(len(known), d.weight / max(len(known), 1), np.float32)
            parts.append((
                d.inputs, d.measured + measurements, d.slots + slots, d.scores - d.scores.max(), np.full(b, number),
                made, rightly, known + measurements, weights,
            ))  # fmt: skip
            pairings, hypotheses = pairings + len(d.measured), hypotheses + b
            measurements, slots = measurements + m, slots + int(d.slots.max()) + 1
        columns = [torch.from_numpy(np.ascontiguousarray(np.concatenate(column))) for column in zip(*parts)]
        return cls(*columns, measurements)  # type: ignore[arg-type]  # mypy cannot count them


def batches_of(scans: Sequence[Decisions], size: int = _BATCH) -> list[Batch]:
    """Of so many scans each, in their order."""
    return [Batch.of(scans[at : at + size]) for at in range(0, len(scans), size)]


_PARAMETERS = {
    "centre": "centre", "scale": "scale", "linear": "linear.weight", "offset": "linear.bias",
    "first": "first.weight", "first_offset": "first.bias", "second": "second.weight", "second_offset": "second.bias",
    "last": "last.weight",
}  # fmt: skip
"""What torch calls each array of `Network`."""


class Odds(nn.Module):
    """The network of `slam_gym.association.tracking.network`, to be trained."""

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

    def forward(self, batch: Batch) -> Tensor:
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


def _most(values: Tensor, group: Tensor) -> Tensor:
    """The greatest of each column (c, h) among those of the same group (c,); values are not negative."""
    out = torch.zeros(int(group.max()) + 1, values.shape[1])
    index = group.long()[:, None].expand_as(values)
    return out.scatter_reduce(0, index, values, "amax").gather(0, index)


# -- its training ------------------------------------------------------------------------------------------------------


class Losses(NamedTuple):
    """Mean cross-entropy [nat] of a decision, of the decisions that a hypothesis of the search makes rightly."""

    model: float  # without the network
    train: float
    curve: tuple[float, ...]  # held out, after each epoch

    @property
    def held_out(self) -> float:
        return self.curve[-1]


def fit(plan: Plan, train: Sequence[Decisions], held_out: Sequence[Decisions], seed: int) -> tuple[Odds, Losses]:
    """Train on some scans, and judge on others."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    rng = np.random.default_rng(seed)
    batches = batches_of([train[k] for k in rng.permutation(len(train)).tolist()])
    network = Odds(*scale_of(train), plan.hidden_numbers)
    optimizer = torch.optim.AdamW(network.parameters(), lr=plan.rate, weight_decay=_DECAY)
    steps = plan.epochs * len(batches)
    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda k: 0.5 + 0.5 * math.cos(math.pi * k / steps))
    others, curve = batches_of(held_out), []
    for _ in range(plan.epochs):
        network.train()
        for k in rng.permutation(len(batches)).tolist():
            optimizer.zero_grad()
            loss_of(network(batches[k]), batches[k]).backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimizer.step()
            schedule.step()
        curve.append(mean_loss(network.eval(), others))
    return network, Losses(mean_loss(None, others), mean_loss(network, batches), tuple(curve))


def scale_of(scans: Sequence[Decisions]) -> tuple[Array, Array]:
    """Mean and standard deviation of the inputs over all pairings; where one never varies, 1."""
    inputs = np.concatenate([d.inputs for d in scans]).astype(np.float64)
    deviation = inputs.std(axis=0)
    return inputs.mean(axis=0), np.where(deviation > 1e-3, deviation, 1.0)


def probabilities(odds: Tensor, batch: Batch) -> Tensor:
    """(k,) of the right decision on each measurement of which it is known."""
    scores = batch.scores.index_add(0, batch.made[:, 0], odds[batch.made[:, 1]])
    most = torch.full((int(batch.scan_of.max()) + 1,), -torch.inf)
    most = most.scatter_reduce(0, batch.scan_of, scores.detach(), "amax")
    weights = torch.exp(scores - most[batch.scan_of])
    weights = weights / torch.zeros(len(most)).index_add(0, batch.scan_of, weights)[batch.scan_of]
    right = torch.zeros(batch.measurements).index_add(0, batch.agreed[:, 1], weights[batch.agreed[:, 0]])
    return right[batch.known]


def loss_of(odds: Tensor, batch: Batch) -> Tensor:
    """Weighted mean of −log p, p not below `_LEAST`."""
    p = probabilities(odds, batch)
    return -(batch.weights * torch.log(p.clamp(_LEAST, 1.0))).sum() / batch.weights.sum()


def mean_loss(network: Odds | None, batches: Sequence[Batch]) -> float:
    """Over batches, by the network or by the model alone."""
    with torch.no_grad():
        found = [loss_of(network(b) if network else torch.zeros(len(b.inputs)), b) * b.weights.sum() for b in batches]
    total = sum(float(b.weights.sum()) for b in batches)
    return float(sum(found)) / total if total else math.nan
