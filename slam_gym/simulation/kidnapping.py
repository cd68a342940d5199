"""Kidnapping: the robot is carried elsewhere during the episode, and has to find out where it is."""

from __future__ import annotations

import math

import numpy as np

from slam_gym.geometry import relative
from slam_gym.scenarios import KidnappingSpec
from slam_gym.types import Array

POSITION, HEADING = 0.5, math.radians(10.0)  # [m], [rad] a pose that is off by no more is right


class Kidnapping:
    """What is done to the robot of an episode, and what becomes of it.

    A pose is right within `POSITION` and `HEADING` of the truth. `recovered` is the tick at which it first was right
    again after the kidnapping, without the robot being lost; relocations count as wrong when they end elsewhere.
    """

    def __init__(self, spec: KidnappingSpec | None, budget: int) -> None:
        self._due = math.inf if spec is None else spec.at * budget  # [tick]
        self._spec = spec
        self.happened: int | None = None  # tick
        self.recovered: int | None = None  # tick
        self.right = self.wrong = 0  # relocations that ended at the right pose, and elsewhere
        self._relocations = 0

    @property
    def planned(self) -> bool:
        """It has not happened yet, but will."""
        return self._spec is not None and self.happened is None

    def destination(self, tick: int, been: list[Array], cells: Array, rng: np.random.Generator) -> Array | None:
        """Pose (3,) in W that the robot is carried to in this tick; None where it is left alone.

        `been` are the poses (3,) where it has been, `cells` (c, 2) [m] all places that it can reach.
        """
        if self._spec is None or self.happened is not None or tick < self._due:
            return None
        self.happened, trail = tick, np.array(been)
        where = _place_been(trail, self._spec.distance, rng) if self._spec.inside else _place_not_been(trail, cells)
        return np.append(where, rng.uniform(-math.pi, math.pi))

    def judge(self, tick: int, estimate: Array, true: Array, relocations: int, lost: bool) -> None:
        """Note down whether the pose (3,) that the robot believes in at the end of a tick is right."""
        right = is_right(estimate, true)
        if relocations > self._relocations:
            self._relocations = relocations
            self.right, self.wrong = self.right + right, self.wrong + (not right)
        if self.happened is not None and self.recovered is None and right and not lost:
            self.recovered = tick


def is_right(estimate: Array, true: Array) -> bool:
    """Whether a pose (3,) is near enough to the true one."""
    x, y, turn = relative(true, estimate).tolist()
    return math.hypot(x, y) <= POSITION and abs(turn) <= HEADING


def _place_been(been: Array, distance: float, rng: np.random.Generator) -> Array:
    """One of the places (t, 3) where the robot has been, `distance` [m] from the last or as far as there is."""
    away = np.hypot(*(been[:, :2] - been[-1, :2]).T)
    far = np.flatnonzero(away >= min(distance, float(away.max())))
    place: Array = been[rng.choice(far), :2]
    return place


def _place_not_been(been: Array, cells: Array) -> Array:
    """The reachable place that is farthest from all where the robot has been."""
    nearest = np.full(len(cells), math.inf)
    for pose in been[::10]:
        nearest = np.minimum(nearest, np.hypot(cells[:, 0] - pose[0], cells[:, 1] - pose[1]))
    place: Array = cells[int(np.argmax(nearest))]
    return place
