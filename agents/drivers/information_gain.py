"""Greedy information gain: the goal that takes the most uncertainty out of the map per tick.

A-optimality is the trace of the covariance (Sim and Roy, ICRA 2005). A feature that has not been
seen counts with its prior σ₀² per coordinate, so new area and revisits are weighed on one scale [m² per tick].
"""

from __future__ import annotations

import numpy as np

from agents.drivers.base import LOOK_AROUND, ActionKind, Info, Observation, legal_goals
from slam_gym.envs.observation import unsquash_goals
from slam_gym.geometry import transform
from slam_gym.simulation.goals import Tried
from slam_gym.types import Array

PRIOR_SIGMA = 0.5  # [m] σ₀ of a feature that has not been seen
DENSITY = 0.3  # [1/m²] features expected per area of new floor
SPEED = 0.08  # [m/tick] along a path, turns included
OVERHEAD = 5.0  # [ticks] to set off and to stop
LOOK = 32.0  # [ticks] to turn round once


def rates(goals: dict[str, Array]) -> Array:
    """(k,) [m² per tick] that each of the goals, as `unsquash_goals` gives them, takes out of the map."""
    ticks = OVERHEAD + goals["path"] / SPEED
    ticks[LOOK_AROUND] = LOOK
    out: Array = (2.0 * PRIOR_SIGMA**2 * DENSITY * goals["area"] + goals["reduction"]) / ticks
    return out


class InformationGain:
    """argmax over the legal goals of (2 σ₀² · density · expected new area + expected trace reduction) / ticks.

    A place that the robot has gone back to, or where it has looked around, promises the less the more often it has.
    """

    name = "information_gain"
    action: ActionKind = "goal"

    def __init__(self) -> None:
        self.reset(0)

    def reset(self, seed: int) -> None:
        self._looked, self._revisited = Tried(), Tried()

    def act(self, observation: Observation, info: Info) -> int:
        goals = unsquash_goals(observation["goals"])
        rate = rates(goals)
        places = transform(np.asarray(info["pose"], float), np.column_stack([goals["x"], goals["y"]]).astype(float))
        rate /= 1.0 + np.where(goals["revisit"] > 0.5, self._revisited.times(places), 0)
        rate[LOOK_AROUND] *= self._looked.times(places[:1])[0] == 0
        chosen = int(np.argmax(np.where(legal_goals(info), rate, -np.inf)))
        if chosen == LOOK_AROUND:
            self._looked.add(places[LOOK_AROUND])
        elif goals["revisit"][chosen] > 0.5:
            self._revisited.add(places[chosen])
        return chosen


class InformationGainNoRevisits(InformationGain):
    """The same without revisits: what it scores less is what they are worth."""

    name = "information_gain_no_revisits"

    def act(self, observation: Observation, info: Info) -> int:
        mask = legal_goals(info) & ~(unsquash_goals(observation["goals"])["revisit"] > 0.5)
        return super().act(observation, {**info, "action_mask": mask})
