"""The training of the learned driver, from worlds to weights.

From a state of a drive, the drive continues once with each of the most promising goals, and then as information gain
drives. The result tells by how much each goal is better than the choice of that driver (a rollout algorithm;
Bertsekas, Tsitsiklis and Wu, 1997). A network with attention between goals learns the mean over worlds of this
difference from what a robot can see, as a score that is added to the greedy one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import joblib
import numpy as np
import torch
from torch import Tensor, nn

from agents.drivers.baselines import rates
from agents.drivers.learned import HEADS, MEMBERS, SHAPES, TOKEN_FIELDS, VERSION, Arrays, Tokens, scores, tokens_of
from agents.evaluation.episodes import ExploreArguments, reset_arguments
from agents.evaluation.pipeline import run_all
from agents.learning.cloning import figure, fit
from agents.learning.sketch import Sketch, missed_by
from slam_gym.types import Array, BoolArray
from slam_gym.weights import Card, Weights

SCENARIOS = ("office", "aliased", "hall", "office", "aliased", "crowd")  # by building: odometry does not matter here
FIRST_WORLD, HELD_OUT = 40_000, 5  # of the train split; every fifth is held out
_TRIED, _RANDOM = 0.8, 0.12  # fractions of the decisions of a drive that become examples, and that are random
_BUDGETS = (0.45, 1.1)  # range of the budget of a drive, as a fraction of that of the scenario
_LINEAR = 2.0  # [.01 E] error from which Huber's loss is linear
_GREED = 3.0  # initial factor of the greedy scores


@dataclass(frozen=True)
class DriverPlan:
    """The drives from which the examples come, and the training of the networks."""

    scenarios: Sequence[str] = SCENARIOS
    episodes: int = 2_000
    epochs: int = 15
    batch: int = 128
    rate: float = 1e-3  # at its highest
    jobs: int = field(default_factory=joblib.cpu_count)


QUICK = DriverPlan(scenarios=("office-small", "hall"), episodes=6, epochs=60, jobs=1)


def reproduce(quick: bool, command: str, say: Callable[[str], None]) -> Weights:
    """The weights of all members, and figures of each and of the ensemble on held-out worlds."""
    plan, began = QUICK if quick else DriverPlan(), time.perf_counter()
    worlds = range(FIRST_WORLD, FIRST_WORLD + plan.episodes)
    drives = [partial(sketched_drive, plan.scenarios[k % len(plan.scenarios)], k) for k in worlds]
    states = dict(run_all(drives, plan.jobs))
    train = Examples.joined([states[k] for k in worlds if k % HELD_OUT])
    held_out = Examples.joined([states[k] for k in worlds if not k % HELD_OUT])
    say(f"{plan.episodes} drives, {len(train) + len(held_out)} states, {time.perf_counter() - began:.0f} s")
    members = []
    for seed in range(MEMBERS):
        network, curve = trained(plan, train, held_out, seed)
        members.append(network)
        say(f"seed {seed}: regret held out [.01 E], by epoch: {' '.join(f'{loss:.3f}' for loss in curve)}")
    of_each, of_train = (np.stack([scores(own, part.tokens) for own in members]) for part in (held_out, train))
    metrics = {
        "regret held out, of one network [.01 E]": _figure([regret_of(own, held_out) for own in of_each]),
        "regret held out [.01 E]": _figure([regret_of(of_each.mean(axis=0), held_out)]),
        "regret trained on [.01 E]": _figure([regret_of(of_train.mean(axis=0), train)]),
        "regret held out, of the greedy driver [.01 E]": _figure([regret_of(held_out.greedy, held_out)]),
        "states": figure([float(len(train) + len(held_out))]),
    }
    scenarios = tuple(dict.fromkeys(plan.scenarios))
    card = Card(VERSION, TOKEN_FIELDS, {}, scenarios, tuple(range(MEMBERS)), command, metrics)
    return Weights(card, {name: np.stack([own[name] for own in members]) for name in members[0]})


def _figure(regrets: Sequence[Array]) -> dict[str, float]:
    """The figure of the means of `regrets`, with an interval of at least ±3 standard errors of these means."""
    error = 3.0 * float(np.mean([own.std() / len(own) ** 0.5 for own in regrets]))
    return figure([float(own.mean()) for own in regrets], error)


# -- states of drives, and the result of each goal there ---------------------------------------------------------------


class Examples(NamedTuple):
    """n states with the k most promising goals of each."""

    fields: Array  # (n, k, f); this and the next three are those of `Tokens`
    gaps: Array  # (n, k, k)
    greedy: Array  # (n, k)
    legal: BoolArray  # (n, k)
    values: Array  # (n, k) [.01 of all features] mapped at the end after each goal; 0 where not legal

    def __len__(self) -> int:  # the number of states, not of parts
        return len(self.fields)

    @property
    def tokens(self) -> Tokens:
        return Tokens(*self[:4])

    @classmethod
    def joined(cls, parts: Sequence[Examples]) -> Examples:
        return cls(*(np.concatenate(columns) for columns in zip(*parts)))

    def batch(self, rows: Array) -> Examples:
        """The states `rows` (b,), as tensors."""
        fields, gaps, greedy, legal, values = (torch.as_tensor(part[rows]) for part in self)
        return Examples(fields.float(), gaps.float(), greedy.float(), legal, values.float())  # type: ignore[arg-type]


def sketched_drive(scenario: str, world: int) -> tuple[int, Examples]:
    """The train world, and the states of a drive through it by information gain; the same in every process."""
    env, rng = ExploreArguments(scenario, split="train").make("goal"), np.random.default_rng(world)
    env.reset(**reset_arguments(world))
    episode = env.unwrapped.episode  # type: ignore[attr-defined]
    sketch, states = Sketch(episode, int(episode.scenario.budget * rng.uniform(*_BUDGETS))), []
    while not sketch.over:
        legal, chosen = sketch.legal, greedy(sketch)
        if legal.sum() > 1 and (rng.random() < _TRIED or not states):
            rows, tokens = tokens_of(sketch.observation(), sketch.ticks, legal)
            values = [100.0 * (1.0 - missed_by(sketch, greedy, int(k))) if legal[k] else 0.0 for k in rows]
            states.append((*tokens, values))
        sketch.step(int(rng.choice(np.flatnonzero(legal))) if rng.random() < _RANDOM else chosen)
    return world, Examples(*(np.array(part) for part in zip(*states)))


def greedy(sketch: Sketch) -> int:
    """The goal that information gain chooses."""
    goals = {"path": sketch.goals.lengths, "area": sketch.goals.areas, "reduction": sketch.goals.reductions}
    return int(np.argmax(np.where(sketch.legal, rates(goals), -np.inf)))


# -- the training ------------------------------------------------------------------------------------------------------


def untrained(rng: np.random.Generator) -> dict[str, Array]:
    """Initial weights of one member, by which it drives as the greedy driver does."""
    out = {name: np.zeros(shape) for name, shape in SHAPES.items()}
    for name, array in out.items():
        layer, _, part = name.rpartition(".")
        if part == "nearness":
            array[:] = np.linspace(0.0, 1.0, HEADS)
        elif layer.endswith(("before", "between", "last")):
            array[:] = part == "weight"
        elif part == "weight" and layer != "score":
            array[:] = rng.uniform(-1.0, 1.0, array.shape) / array.shape[1] ** 0.5
    return out | {"greed": np.array(_GREED)}


def trained(plan: DriverPlan, train: Examples, held_out: Examples, seed: int) -> tuple[Arrays, list[float]]:
    """Weights that predict the values of goals up to a constant of each state, and the regret held out by epoch."""
    rng, own = np.random.default_rng(seed), train.fields[train.legal]
    scaled = {"shift": own.mean(axis=0), "scale": 1.0 / (own.std(axis=0) + 0.05)}
    network = {name: torch.tensor(x, dtype=torch.float32) for name, x in (untrained(rng) | scaled).items()}
    learned = [tensor.requires_grad_() for name, tensor in network.items() if name not in scaled]
    arrays = {name: tensor.detach().numpy() for name, tensor in network.items()}  # the same memory
    batches = np.array_split(rng.permutation(len(train)), -(-len(train) // plan.batch))
    curve = fit(
        learned,
        [train.batch(rows) for rows in batches],
        lambda batch: loss_of(scores(network, batch.tokens, torch), batch),
        lambda: float(regret_of(scores(arrays, held_out.tokens), held_out).mean()),
        plan.epochs,
        plan.rate,
        rng,
    )
    return arrays, curve


def loss_of(scored: Tensor, batch: Examples) -> Tensor:
    """Huber's loss between scores (b, k) and values, both relative to their means over the legal goals of a state."""
    legal: Any = batch.legal
    errors = (scored - batch.values).masked_fill(~legal, 0.0)
    errors = (errors - errors.sum(dim=1, keepdim=True) / legal.sum(dim=1, keepdim=True)).masked_fill(~legal, 0.0)
    return nn.functional.huber_loss(errors, torch.zeros_like(errors), reduction="sum", delta=_LINEAR) / len(errors)


def regret_of(scored: Array, examples: Examples) -> Array:
    """(n,) [.01 E] by how much the goal of the highest score (n, k) is worse than the best goal."""
    values = np.where(examples.legal, examples.values, -np.inf)
    chosen = np.where(examples.legal, scored, -np.inf).argmax(axis=1)
    return values.max(axis=1) - values[np.arange(len(values)), chosen]
