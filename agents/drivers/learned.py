"""The learned driver that ships: information gain, and what a network has learned from trying goals out."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from agents.drivers.base import LOOK_AROUND, ActionKind, Info, Observation, legal_goals
from agents.drivers.goal_network import Size, choose, shapes
from agents.drivers.goal_tokens import TOKEN_FIELDS, tokens_of
from agents.drivers.information_gain import InformationGain
from slam_gym.envs.goal_observation import unsquash_goals
from slam_gym.geometry import transform
from slam_gym.simulation.goals import Tried
from slam_gym.weights import Weights, load

VERSION = 3  # of the tokens: weights trained on others are refused
SIZE = Size()


class LearnedDriver:
    """The frontier of the highest score, or once at one place to look around; with no frontier left, information gain.

    It sees the observation alone; it counts the ticks that it has driven, which tells how many are left.
    """

    name = "learned"
    action: ActionKind = "goal"

    def __init__(self, weights: str | Path | Weights = "driver") -> None:
        """`weights`: a name in `slam_gym.weights`, the path of a file, or themselves. Raises ValueError as `load`."""
        given = weights if isinstance(weights, Weights) else load(weights, VERSION, TOKEN_FIELDS, shapes(SIZE))
        self._arrays = given.arrays
        self._without_frontiers = InformationGain()
        self.reset(0)

    def reset(self, seed: int) -> None:
        self._ticks, self._looked = 0.0, Tried()
        self._without_frontiers.reset(seed)

    def act(self, observation: Observation, info: Info) -> int:
        self._ticks += float(info["ticks"])
        legal = legal_goals(info) & (unsquash_goals(observation["goals"])["frontier"] > 0.5)
        if not legal.any():
            return self._without_frontiers.act(observation, info)
        tokens = tokens_of(observation, self._ticks)
        place = transform(np.asarray(info["pose"], float), tokens.places[:1])
        legal[LOOK_AROUND] = self._looked.times(place)[0] == 0
        chosen = choose(self._arrays, SIZE, tokens, legal)
        if chosen == LOOK_AROUND:
            self._looked.add(place[0])
        return chosen
