"""The learned driver that ships: information gain, and what a network has learned from a driver that knows the plan."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from agents.drivers.base import LOOK_AROUND, ActionKind, Info, Observation, legal_goals
from agents.drivers.goal_network import Size, scores, shapes
from agents.drivers.goal_tokens import TOKEN_FIELDS, tokens_of
from slam_gym.envs.goal_observation import unsquash_goals
from slam_gym.geometry import transform
from slam_gym.simulation.goals import Tried
from slam_gym.types import BoolArray
from slam_gym.weights import Weights, load

VERSION = 1  # of the tokens: weights trained on others are refused
SIZE = Size()


class LearnedDriver:
    """The legal goal of the highest score, but where it has looked around or gone back to before it does not do so
    again as long as there is anything else: a network without memory would go to and fro between two places.

    It sees the observation alone; it counts the ticks that it has driven, which tells how many are left.
    """

    name = "learned"
    action: ActionKind = "goal"

    def __init__(self, weights: str | Path | Weights = "driver") -> None:
        """`weights`: a name in `slam_gym.weights`, the path of a file, or themselves. Raises ValueError as `load`."""
        given = weights if isinstance(weights, Weights) else load(weights, VERSION, TOKEN_FIELDS, shapes(SIZE))
        self._arrays = given.arrays
        self.reset(0)

    def reset(self, seed: int) -> None:
        self._ticks = 0.0
        self._looked, self._revisited = Tried(), Tried()

    def act(self, observation: Observation, info: Info) -> int:
        self._ticks += float(info["ticks"])
        tokens, revisit = tokens_of(observation, self._ticks), unsquash_goals(observation["goals"])["revisit"] > 0.5
        places = transform(np.asarray(info["pose"], float), tokens.places)
        done: BoolArray = revisit & (self._revisited.times(places) > 0)
        done[LOOK_AROUND] = self._looked.times(places[:1])[0] > 0
        legal = legal_goals(info)
        fresh = legal & ~done
        chosen = int(np.argmax(scores(self._arrays, SIZE, tokens, fresh if fresh.any() else legal)))
        if chosen == LOOK_AROUND:
            self._looked.add(places[LOOK_AROUND])
        elif revisit[chosen]:
            self._revisited.add(places[chosen])
        return chosen
