"""Nearest-frontier exploration (Yamauchi, CIRA 1997): always drive to the closest edge of the known space."""

from __future__ import annotations

import numpy as np

from agents.drivers.base import LOOK_AROUND, ActionKind, Info, Observation, legal_goals
from slam_gym.envs.goal_observation import unsquash_goals


class NearestFrontier:
    """The legal frontier with the shortest path. With no frontier left the floor counts as explored and it stays."""

    name = "nearest_frontier"
    action: ActionKind = "goal"

    def reset(self, seed: int) -> None:
        pass

    def act(self, observation: Observation, info: Info) -> int:
        goals = unsquash_goals(observation["goals"])
        frontiers = legal_goals(info) & (goals["frontier"] > 0.5)
        if not frontiers.any():
            return LOOK_AROUND
        return int(np.argmin(np.where(frontiers, goals["path"], np.inf)))
