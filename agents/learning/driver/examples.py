"""What the learned driver learns from: states of drives, and what came of each goal there when it was tried.

From a state a drive goes on once for each of the most promising goals, by that goal and then as information gain, or
the learner of an earlier round, drives on. What a goal is better than that driver's own choice then holds for a driver
who knows no more: on average over worlds it is what the driver should have done (a rollout algorithm; Bertsekas,
Tsitsiklis and Wu, 1997).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from agents.drivers.goal_network import choose, gaps_between, greedy_score
from agents.drivers.goal_tokens import most_promising, tokens_of
from agents.drivers.information_gain import GainSpec, rates
from agents.drivers.learned import SIZE
from agents.evaluation.episodes import ExploreArguments, reset_arguments
from agents.learning.driver.sketch import Policy, Sketch, played
from slam_gym.types import Array, BoolArray
from slam_gym.weights import Weights


class Examples(NamedTuple):
    """n states with k goals each, the most promising ones."""

    tokens: Array  # (n, k, f)
    gaps: Array  # (n, k, k) between goals
    greedy: Array  # (n, k) scores
    legal: BoolArray  # (n, k)
    values: Array  # (n, k) [.01 of all features] mapped in the end, by each goal; 0 where not legal

    def __len__(self) -> int:  # of the states, not of the fields
        return len(self.tokens)


@dataclass(frozen=True)
class Drive:
    """One drive in outline in a train world. Without `weights` information gain drives, with them the learner."""

    scenario: str
    world: int
    weights: Weights | None = None
    states: float = 0.8  # of the decisions are tried out
    random: float = 0.12  # of the decisions are drawn from all legal goals
    budgets: tuple[float, float] = (0.45, 1.1)  # of the scenario's, of which one is drawn

    def run(self) -> Examples:
        """The states of the drive; the same, whichever process it runs in."""
        env, rng, policy = _env(self.scenario), np.random.default_rng(self.world), policy_of(self.weights)
        env.reset(**reset_arguments(self.world))
        episode = env.unwrapped.episode  # type: ignore[attr-defined]
        sketch, states = Sketch(episode, int(episode.scenario.budget * rng.uniform(*self.budgets))), []
        while not sketch.over:
            legal, chosen = sketch.legal, policy(sketch)
            if legal.sum() > 1 and (rng.random() < self.states or not states):
                rows, tokens = most_promising(tokens_of(sketch.observation(), sketch.ticks), legal)
                values = [_tried(sketch, policy, int(k)) if legal[k] else 0.0 for k in rows]
                gaps, greedy = gaps_between(tokens.places), greedy_score(tokens.rates)
                states.append((tokens.fields, gaps, greedy, legal[rows], values))
            sketch.step(int(rng.choice(np.flatnonzero(legal))) if rng.random() < self.random else chosen)
        return Examples(*(np.array(part) for part in zip(*states)))


def _tried(sketch: Sketch, policy: Policy, goal: int) -> float:
    """[.01 of all features] mapped in the end when a goal is taken now."""
    return 100.0 * (1.0 - played(sketch.fork(), policy, goal))


def policy_of(weights: Weights | None) -> Policy:
    """Who drives a sketch: information gain, or the learner with these weights."""

    def greedy(sketch: Sketch) -> int:
        goals = {"path": sketch.goals.lengths, "area": sketch.goals.areas, "reduction": sketch.goals.reductions}
        return int(np.argmax(np.where(sketch.legal, rates(goals, GainSpec()), -np.inf)))

    def learned(sketch: Sketch) -> int:
        assert weights is not None
        return choose(weights.arrays, SIZE, tokens_of(sketch.observation(), sketch.ticks), sketch.legal)

    return greedy if weights is None else learned


def together(parts: Iterable[Examples]) -> Examples:
    """All states, in order."""
    return Examples(*(np.concatenate(columns) for columns in zip(*parts)))


@lru_cache(maxsize=4)
def _env(scenario: str) -> gym.Env[Any, Any]:
    """Kept for the next drive of the same process."""
    return ExploreArguments(scenario, split="train").make("goal")
