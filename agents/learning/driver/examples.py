"""What the learned driver learns from: states of episodes, and what the clairvoyant driver expects of each goal.

The one who drives there is whoever shall learn, or learns from: a state that only the teacher gets into teaches nothing
about one's own mistakes (DAgger; Ross, Gordon and Bagnell, AISTATS 2011).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from agents.drivers.base import Agent, visible
from agents.drivers.clairvoyant import Clairvoyant
from agents.drivers.goal_network import gaps_between, greedy_score
from agents.drivers.goal_tokens import tokens_of
from agents.drivers.information_gain import InformationGain
from agents.drivers.learned import LearnedDriver
from agents.evaluation.episodes import ExploreArguments, begin_episode
from slam_gym.types import Array, BoolArray
from slam_gym.weights import Weights


class Examples(NamedTuple):
    """n states with k goals each."""

    tokens: Array  # (n, k, f)
    gaps: Array  # (n, k, k) between goals
    greedy: Array  # (n, k) scores
    legal: BoolArray  # (n, k)
    values: Array  # (n, k) [.01 E] by which the map error should be lower in the end, by each goal; 0 where not legal

    def __len__(self) -> int:  # of the states, not of the fields
        return len(self.tokens)


@dataclass(frozen=True)
class Drive:
    """One episode in a train world. Without `weights` information gain or the teacher drives, with them the learner."""

    scenario: str
    world: int
    weights: Weights | None = None
    teacher: float = 0.5  # probability that the teacher drives the episode
    random: float = 0.12  # of the decisions are drawn from all legal goals

    def run(self) -> Examples:
        """The states of the episode; the same, whichever process it runs in."""
        env, rng, teacher = _env(self.scenario), np.random.default_rng(self.world), Clairvoyant()
        pupil = InformationGain() if self.weights is None else LearnedDriver(self.weights)
        observation, info = begin_episode(env, teacher, self.world)
        features = int(env.unwrapped.episode.site.observable.sum())  # type: ignore[attr-defined]
        driver: Agent = teacher if rng.random() < self.teacher else pupil
        states, used, over = [], 0.0, False
        while not over:
            seen = visible(info)
            used += float(seen["ticks"])
            legal, values = seen["action_mask"], teacher.values(observation, seen)
            tokens = tokens_of(observation, used)
            states.append((
                tokens.fields, gaps_between(tokens.places), greedy_score(tokens.rates), legal,
                np.where(legal, 100.0 * values / features, 0.0),
            ))  # fmt: skip
            chosen = pupil.act(observation, seen)  # asked always, since it counts the ticks
            if driver is teacher:
                chosen = teacher.act(observation, seen)
            if rng.random() < self.random:
                chosen = int(rng.choice(np.flatnonzero(legal)))
            observation, _, over, _, info = env.step(chosen)
        return Examples(*(np.array(part) for part in zip(*states)))


def together(parts: Iterable[Examples]) -> Examples:
    """All states, in order."""
    return Examples(*(np.concatenate(columns) for columns in zip(*parts)))


@lru_cache(maxsize=4)
def _env(scenario: str) -> gym.Env[Any, Any]:
    """Kept for the next episode of the same process."""
    return ExploreArguments(scenario, split="train").make("goal")
