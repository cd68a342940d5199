"""The simplest drivers: a random goal, the nearest frontier, and lanes back and forth."""

from __future__ import annotations

import numpy as np

from agents.drivers.base import LOOK_AROUND, ActionKind, Info, Observation, legal_goals
from slam_gym.envs.observation import unsquash_goals
from slam_gym.geometry import transform
from slam_gym.types import Array, IntArray

LANE_WIDTH = 4.0  # [m] lanes run along the x axis of the map base B


class RandomAgent:
    """One of the legal goals, uniformly."""

    name = "random"
    action: ActionKind = "goal"

    def __init__(self) -> None:
        self.reset(0)

    def reset(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)

    def act(self, observation: Observation, info: Info) -> int:
        return int(self._rng.choice(np.flatnonzero(legal_goals(info))))


class NearestFrontier:
    """The legal frontier with the shortest path (Yamauchi, CIRA 1997). With no frontier left the floor counts as
    explored, and it stays."""

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


class Lawnmower:
    """Frontiers in the order of a lawn-mower (boustrophedon; Choset 2001): along the lane while it goes on ahead, else
    turn into the nearest lane.

    Frontiers are what blocks a lane in an unknown building, so the sweep goes from one to the next instead of along
    straight lines. When no frontier is left, the lanes are driven again over the revisits, which closes loops.
    """

    name = "lawnmower"
    action: ActionKind = "goal"

    def __init__(self) -> None:
        self.reset(0)

    def reset(self, seed: int) -> None:
        self._direction = 1.0  # +1: lanes are driven towards +x of B
        self._lane = 0

    def act(self, observation: Observation, info: Info) -> int:
        goals = unsquash_goals(observation["goals"])
        legal = legal_goals(info)
        for wanted in (goals["frontier"] > 0.5, goals["revisit"] > 0.5):
            if (legal & wanted).any():
                return self._next(goals, np.flatnonzero(legal & wanted), np.asarray(info["pose"], dtype=float))
        return LOOK_AROUND

    def _next(self, goals: dict[str, Array], slots: IntArray, pose: Array) -> int:
        in_robot = np.ascontiguousarray(np.column_stack([goals["x"][slots], goals["y"][slots]]), dtype=float)
        in_base = transform(pose, in_robot)
        lanes = np.floor(in_base[:, 1] / LANE_WIDTH + 0.5).astype(int)
        ahead = (in_base[:, 0] - pose[0]) * self._direction
        here = lanes == self._lane
        if not (here & (ahead > 0.0)).any():
            self._direction = -self._direction
            ahead = -ahead
        if not here.any():
            self._lane = int(lanes[np.argmin(np.abs(lanes - self._lane))])
            here = lanes == self._lane
        # Ahead of the robot comes first, the nearest first; what lies behind comes last.
        order = np.where(ahead > 0.0, ahead, 1e3 + np.abs(ahead))
        return int(slots[np.argmin(np.where(here, order, np.inf))])
