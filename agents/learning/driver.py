"""The training of the learned driver, from worlds to weights.

From a state of a drive the drive goes on once for each of the most promising goals, by that goal and then as
information gain drives. By how much a goal is better than that driver's own choice holds for a driver who knows no
more: on average over worlds it is what the driver should have done (a rollout algorithm; Bertsekas, Tsitsiklis and Wu,
1997). A network of attention between goals learns it, as a score that is added to the greedy one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, NamedTuple

import gymnasium as gym
import joblib
import numpy as np
import torch
from torch import Tensor, nn

from agents.drivers.information_gain import GainSpec, rates
from agents.drivers.learned import (
    SIZE,
    TOKEN_FIELDS,
    VERSION,
    Arrays,
    Size,
    gaps_between,
    greedy_score,
    most_promising,
    tokens_of,
)
from agents.evaluation.episodes import ExploreArguments, reset_arguments
from agents.evaluation.parallel import run_all
from agents.learning.sketch import Sketch, missed_by
from slam_gym.types import Array, BoolArray
from slam_gym.weights import Card, Weights, figure

SCENARIOS = ("office", "aliased", "hall", "office", "aliased", "crowd")  # the buildings: wheels do not tell
FIRST_WORLD, HELD_OUT = 40_000, 5  # of the train split; every fifth is held out
_TRIED, _RANDOM = 0.8, 0.12  # of the decisions of a drive
_BUDGETS = (0.45, 1.1)  # of the scenario's, of which one is drawn
_LINEAR = 2.0  # [.01 E] beyond which an error counts linearly


@dataclass(frozen=True)
class Plan:
    """How much is driven, and how often and for how long networks are trained on it."""

    scenarios: Sequence[str] = SCENARIOS
    episodes: int = 2_000
    seeds: Sequence[int] = (0, 1, 2)  # the networks of the first `size.members` ship
    size: Size = SIZE
    epochs: int = 15
    batch: int = 128
    rate: float = 1e-3  # at its highest: it rises, and falls to nothing
    jobs: int = field(default_factory=joblib.cpu_count)


QUICK = Plan(scenarios=("office-small", "hall"), episodes=6, epochs=4, jobs=1)


def reproduce(quick: bool, command: str, say: Callable[[str], None]) -> Weights:
    """Weights of the first networks; the figures of the card are those of all seeds."""
    plan, began = QUICK if quick else Plan(), time.perf_counter()
    worlds = range(FIRST_WORLD, FIRST_WORLD + plan.episodes)
    drives = [Drive(plan.scenarios[world % len(plan.scenarios)], world) for world in worlds]
    found = dict(run_all(drives, plan.jobs))
    say(f"{len(found)} drives, {sum(map(len, found.values()))} states, {time.perf_counter() - began:.0f} s")
    return trained(plan, found, command, say)


def trained(plan: Plan, found: dict[int, Examples], command: str, say: Callable[[str], None]) -> Weights:
    """Weights and card, from the states of each world."""
    train = Examples.joined([found[world] for world in sorted(found) if world % HELD_OUT])
    held_out = Examples.joined([found[world] for world in sorted(found) if not world % HELD_OUT])
    networks = []
    for seed in plan.seeds:
        networks.append(fit(plan, train, seed))
        say(f"seed {seed}: a choice loses {regret(networks[-1:], held_out).mean():.3f} hundredths of E held out")
    shipped = networks[: plan.size.members]
    of_one = [regret([network], held_out) for network in networks]
    metrics = {
        "regret held out, of one network [.01 E]": _figure(of_one),
        "regret held out [.01 E]": _figure([regret(shipped, held_out)]),
        "regret trained on [.01 E]": _figure([regret(shipped, train)]),
        "regret held out, of the greedy driver [.01 E]": _figure([regret_of(held_out.greedy, held_out)]),
        "states": figure([float(len(train) + len(held_out))]),
    }
    scenarios = tuple(dict.fromkeys(plan.scenarios))
    card = Card(VERSION, TOKEN_FIELDS, {}, scenarios, tuple(plan.seeds), command, metrics)
    members = [network.arrays() for network in shipped]
    return Weights(card, {name: np.stack([own[name] for own in members]) for name in members[0]})


def _figure(regrets: Sequence[Array]) -> dict[str, float]:
    """As `figure`, of means over states, and no narrower than what other states of the same kind would give."""
    found = figure([float(own.mean()) for own in regrets])
    error = 3.0 * float(np.mean([own.std() / len(own) ** 0.5 for own in regrets]))
    low, high = found["estimate"] - error, found["estimate"] + error
    return found | {"low": max(0.0, min(found["low"], low)), "high": max(found["high"], high)}


# -- states of drives, and what came of each goal there ----------------------------------------------------------------


class Examples(NamedTuple):
    """n states with k goals each, the most promising ones."""

    tokens: Array  # (n, k, f)
    gaps: Array  # (n, k, k) between goals
    greedy: Array  # (n, k) scores
    legal: BoolArray  # (n, k)
    values: Array  # (n, k) [.01 of all features] mapped in the end, by each goal; 0 where not legal

    def __len__(self) -> int:  # of the states, not of the fields
        return len(self.tokens)

    @classmethod
    def joined(cls, parts: Sequence[Examples]) -> Examples:
        """All states, in order."""
        return cls(*(np.concatenate(columns) for columns in zip(*parts)))

    def tensors(self) -> tuple[list[Tensor], Tensor]:
        """Inputs of the network, and the values."""
        numbers = [torch.as_tensor(part, dtype=torch.float32) for part in (self.tokens, self.gaps, self.greedy)]
        return [*numbers, torch.as_tensor(self.legal)], torch.as_tensor(self.values, dtype=torch.float32)


@dataclass(frozen=True)
class Drive:
    """One drive in outline in a train world, by information gain."""

    scenario: str
    world: int

    def __call__(self) -> tuple[int, Examples]:
        """The world, and the states of the drive; the same, whichever process it runs in."""
        env, rng = _env(self.scenario), np.random.default_rng(self.world)
        env.reset(**reset_arguments(self.world))
        episode = env.unwrapped.episode  # type: ignore[attr-defined]
        sketch, states = Sketch(episode, int(episode.scenario.budget * rng.uniform(*_BUDGETS))), []
        while not sketch.over:
            legal, chosen = sketch.legal, greedy(sketch)
            if legal.sum() > 1 and (rng.random() < _TRIED or not states):
                rows, tokens = most_promising(tokens_of(sketch.observation(), sketch.ticks), legal)
                values = [100.0 * (1.0 - missed_by(sketch, greedy, int(k))) if legal[k] else 0.0 for k in rows]
                gaps, scores = gaps_between(tokens.places), greedy_score(tokens.rates)
                states.append((tokens.fields, gaps, scores, legal[rows], values))
            sketch.step(int(rng.choice(np.flatnonzero(legal))) if rng.random() < _RANDOM else chosen)
        return self.world, Examples(*(np.array(part) for part in zip(*states)))


@lru_cache(maxsize=4)
def _env(scenario: str) -> gym.Env[Any, Any]:
    """Kept for the next drive of the same process."""
    return ExploreArguments(scenario, split="train").make("goal")


def greedy(sketch: Sketch) -> int:
    """The goal that information gain takes."""
    goals = {"path": sketch.goals.lengths, "area": sketch.goals.areas, "reduction": sketch.goals.reductions}
    return int(np.argmax(np.where(sketch.legal, rates(goals, GainSpec()), -np.inf)))


# -- the network while it learns: a test holds it against `agents.drivers.learned`, which runs it on arrays ------------


class Block(nn.Module):
    """Every goal looks at all legal ones, nearer ones more or less so, and then thinks for itself."""

    def __init__(self, size: Size) -> None:
        super().__init__()
        self.heads = size.heads
        self.before, self.between = nn.LayerNorm(size.width), nn.LayerNorm(size.width)
        self.attend = nn.Linear(size.width, 3 * size.width)
        self.mix = nn.Linear(size.width, size.width)
        self.nearness = nn.Parameter(torch.linspace(0.0, 1.0, size.heads))
        self.wide, self.narrow = nn.Linear(size.width, 2 * size.width), nn.Linear(2 * size.width, size.width)

    def forward(self, x: Tensor, gaps: Tensor, legal: Tensor) -> Tensor:
        batch, goals, width = x.shape
        q, k, v = self.attend(self.before(x)).reshape(batch, goals, 3, self.heads, -1).permute(2, 0, 3, 1, 4)
        match = q @ k.transpose(-1, -2) / (width / self.heads) ** 0.5
        match = match - self.nearness[:, None, None] * gaps[:, None]
        share = match.masked_fill(~legal[:, None, None, :], -1e9).softmax(dim=-1)
        x = x + self.mix((share @ v).transpose(1, 2).reshape(batch, goals, width))
        return x + self.narrow(torch.relu(self.wide(self.between(x))))


class GoalNetwork(nn.Module):
    """Tokens (b, k, f), gaps (b, k, k) between goals, greedy scores (b, k) → scores (b, k), −1e9 where not legal."""

    def __init__(self, size: Size) -> None:
        super().__init__()
        self.embed = nn.Linear(len(TOKEN_FIELDS), size.width)
        self.blocks = nn.ModuleList(Block(size) for _ in range(size.layers))
        self.last = nn.LayerNorm(size.width)
        self.score = nn.Linear(size.width, 1)
        self.greed = nn.Parameter(torch.tensor(3.0))
        self.register_buffer("shift", torch.zeros(len(TOKEN_FIELDS)))
        self.register_buffer("scale", torch.ones(len(TOKEN_FIELDS)))
        nn.init.zeros_(self.score.weight)  # it begins as the greedy driver
        nn.init.zeros_(self.score.bias)

    def forward(self, tokens: Tensor, gaps: Tensor, greedy: Tensor, legal: Tensor) -> Tensor:
        x = self.embed((tokens - self.shift) * self.scale)
        for block in self.blocks:
            x = block(x, gaps, legal)
        scores = self.greed * greedy + self.score(self.last(x))[..., 0]
        return scores.masked_fill(~legal, -1e9)

    def arrays(self) -> Arrays:
        """The weights, by the names that `agents.drivers.learned` knows."""
        return {name: value.detach().numpy().astype(np.float32) for name, value in self.state_dict().items()}


def fit(plan: Plan, train: Examples, seed: int) -> GoalNetwork:
    """A network that predicts the values of goals, up to what they have in common."""
    torch.set_num_threads(1)  # sums in one order, or the weights would depend on the number of cores
    torch.manual_seed(seed)
    rng, network = np.random.default_rng(seed), GoalNetwork(plan.size)
    own = train.tokens[train.legal]
    network.shift[:] = torch.as_tensor(own.mean(axis=0))
    network.scale[:] = torch.as_tensor(1.0 / (own.std(axis=0) + 0.05))
    inputs, values = train.tensors()
    optimizer = torch.optim.AdamW(network.parameters(), lr=plan.rate, weight_decay=1e-2)
    batches = -(-len(train) // plan.batch)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, plan.rate, total_steps=plan.epochs * batches)
    for _ in range(plan.epochs):
        for rows in np.array_split(rng.permutation(len(train)), batches):
            chosen = torch.as_tensor(rows)
            loss = _loss(network(*(part[chosen] for part in inputs)), values[chosen], inputs[-1][chosen])
            optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimizer.step()
            schedule.step()
    return network.eval()


def _loss(scores: Tensor, values: Tensor, legal: Tensor) -> Tensor:
    """Huber's, of scores and values above their means over the legal goals, summed over goals."""
    off = (scores - values).masked_fill(~legal, 0.0)
    off = (off - off.sum(dim=1, keepdim=True) / legal.sum(dim=1, keepdim=True)).masked_fill(~legal, 0.0)
    return nn.functional.huber_loss(off, torch.zeros_like(off), reduction="sum", delta=_LINEAR) / len(off)


def regret(networks: Sequence[GoalNetwork], examples: Examples) -> Array:
    """(n,) [.01 E] by which the goals that the mean of some networks chooses are worse than the best."""
    inputs, _ = examples.tensors()
    with torch.no_grad():
        scores = torch.stack([network(*inputs) for network in networks]).mean(dim=0).numpy()
    return regret_of(scores, examples)


def regret_of(scores: Array, examples: Examples) -> Array:
    """(n,) the same of the goals of the highest scores (n, k)."""
    values = np.where(examples.legal, examples.values, -np.inf)
    chosen = np.where(examples.legal, scores, -np.inf).argmax(axis=1)
    found: Array = values.max(axis=1) - values[np.arange(len(values)), chosen]
    return found
