"""The learned driver that ships: information gain, and what a network has learned from a driver that knows the plan."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from agents.drivers.base import ActionKind, Info, Observation, legal_goals
from agents.drivers.goal_network import Size, scores, shapes
from agents.drivers.goal_tokens import TOKEN_FIELDS, tokens_of
from slam_gym.weights import Weights, load

VERSION = 1  # of the tokens: weights trained on others are refused
SIZE = Size()


class LearnedDriver:
    """The legal goal of the highest score. It sees the observation alone, and counts the ticks that it has driven."""

    name = "learned"
    action: ActionKind = "goal"

    def __init__(self, weights: str | Path | Weights = "driver") -> None:
        """`weights`: a name in `slam_gym.weights`, the path of a file, or themselves. Raises ValueError as `load`."""
        given = weights if isinstance(weights, Weights) else load(weights, VERSION, TOKEN_FIELDS, shapes(SIZE))
        self._arrays = given.arrays
        self.reset(0)

    def reset(self, seed: int) -> None:
        self._ticks = 0.0

    def act(self, observation: Observation, info: Info) -> int:
        self._ticks += float(info["ticks"])
        return int(np.argmax(scores(self._arrays, SIZE, tokens_of(observation, self._ticks), legal_goals(info))))
