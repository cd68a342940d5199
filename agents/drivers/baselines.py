"""The classical drivers: a random goal, the nearest frontier, lanes back and forth, and greedy information gain."""

import numpy as np

from agents.drivers.base import LOOK_AROUND, Agent, Info, Observation
from slam_gym.envs.observation import unsquash_goals
from slam_gym.geometry import transform
from slam_gym.simulation.goals import Tried
from slam_gym.types import Array

LANE_WIDTH = 4.0  # [m] lanes run along the x axis of the map base B

# of information gain
PRIOR_SIGMA = 0.5  # [m] σ₀ of a feature that has not been seen
DENSITY = 0.3  # [1/m²] features expected per area of new floor
SPEED = 0.08  # [m/tick] along a path, turns included
OVERHEAD = 5.0  # [ticks] to start and to stop
LOOK = 32.0  # [ticks] to turn round once


class RandomAgent(Agent):
    """Chooses a legal goal uniformly at random."""

    name = "random"

    def reset(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)

    def act(self, observation: Observation, info: Info) -> int:
        return int(self._rng.choice(np.flatnonzero(info["action_mask"])))


class NearestFrontier(Agent):
    """Chooses the legal frontier with the shortest path (Yamauchi, CIRA 1997). With no frontier left, it stays and
    looks around."""

    name = "nearest_frontier"

    def act(self, observation: Observation, info: Info) -> int:
        goals = unsquash_goals(observation["goals"])
        frontiers = info["action_mask"] & (goals["frontier"] > 0.5)
        if not frontiers.any():
            return LOOK_AROUND
        return int(np.argmin(np.where(frontiers, goals["path"], np.inf)))


class Lawnmower(Agent):
    """Visits frontiers in lanes back and forth (boustrophedon; Choset 2001): the next frontier ahead in the lane, or
    else one of the nearest lane.

    Frontiers are what ends a lane in an unknown building, so the sweep goes from one to the next instead of along
    straight lines. When no frontier is left, it drives the lanes again over the revisits, which closes loops.
    """

    name = "lawnmower"

    def reset(self, seed: int) -> None:
        self._direction = 1.0  # +1: lanes are driven towards +x of B
        self._lane = 0

    def act(self, observation: Observation, info: Info) -> int:
        goals = unsquash_goals(observation["goals"])
        frontiers, revisits = (info["action_mask"] & (goals[kind] > 0.5) for kind in ("frontier", "revisit"))
        slots = np.flatnonzero(frontiers if frontiers.any() else revisits)
        if not len(slots):
            return LOOK_AROUND
        pose = np.asarray(info["pose"], float)
        in_base = transform(pose, np.column_stack([goals["x"][slots], goals["y"][slots]]))
        lanes = np.floor(in_base[:, 1] / LANE_WIDTH + 0.5).astype(int)
        ahead = (in_base[:, 0] - pose[0]) * self._direction
        here = lanes == self._lane
        if not (here & (ahead > 0.0)).any():
            self._direction = -self._direction
            ahead = -ahead
        if not here.any():
            self._lane = int(lanes[np.argmin(np.abs(lanes - self._lane))])
            here = lanes == self._lane
        # goals ahead of the robot come first, by distance, then those behind it
        order = np.where(ahead > 0.0, ahead, 1e3 + np.abs(ahead))
        return int(slots[np.argmin(np.where(here, order, np.inf))])


# -- information gain --------------------------------------------------------------------------------------------------


def rates(goals: dict[str, Array]) -> Array:
    """(k,) [m² per tick] by which each of the goals from `unsquash_goals` reduces the uncertainty of the map."""
    ticks = OVERHEAD + goals["path"] / SPEED
    ticks[LOOK_AROUND] = LOOK
    return (2.0 * PRIOR_SIGMA**2 * DENSITY * goals["area"] + goals["reduction"]) / ticks


class InformationGain(Agent):
    """Chooses the goal that reduces the uncertainty of the map most per tick: the maximum of
    (2 σ₀² · density · expected new area + expected trace reduction) / ticks.

    A-optimality is the trace of the covariance (Sim and Roy, ICRA 2005). An unseen feature counts with its prior σ₀²
    per coordinate, so that new area and revisits are on one scale. The rate of a revisit falls with the number of
    visits to its place, and that of looking around is 0 where the robot has done so before.
    """

    name = "information_gain"

    def reset(self, seed: int) -> None:
        self._looked, self._revisited = Tried(), Tried()

    def act(self, observation: Observation, info: Info) -> int:
        goals = unsquash_goals(observation["goals"])
        rate = rates(goals)
        places = transform(np.asarray(info["pose"], float), np.column_stack([goals["x"], goals["y"]]))
        rate /= 1.0 + np.where(goals["revisit"] > 0.5, self._revisited.times(places), 0)
        rate[LOOK_AROUND] *= self._looked.times(places[:1])[0] == 0
        chosen = int(np.argmax(np.where(info["action_mask"], rate, -np.inf)))
        if chosen == LOOK_AROUND:
            self._looked.add(places[LOOK_AROUND])
        elif goals["revisit"][chosen] > 0.5:
            self._revisited.add(places[chosen])
        return chosen


class InformationGainNoRevisits(InformationGain):
    """Information gain without revisits, to measure the value of revisits."""

    name = "information_gain_no_revisits"

    def act(self, observation: Observation, info: Info) -> int:
        mask = info["action_mask"] & ~(unsquash_goals(observation["goals"])["revisit"] > 0.5)
        return super().act(observation, {**info, "action_mask": mask})
