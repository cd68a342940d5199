"""Kidnapping: the robot is carried elsewhere during the episode, and has to find out where it is."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from slam_gym.geometry import compose, relative
from slam_gym.types import Array

if TYPE_CHECKING:
    from slam_gym.simulation.episode import Episode

POSITION, HEADING = 0.5, math.radians(10.0)  # [m], [rad] a pose that is off by no more is right


class Kidnapping:
    """What was done to the robot of an episode, and what became of it.

    A pose is right within `POSITION` and `HEADING` of the truth. `recovered` is the tick at which it first was right
    again after the kidnapping, without the robot being lost; relocations count as wrong when they end elsewhere.
    """

    def __init__(self) -> None:
        self.happened: int | None = None  # tick
        self.recovered: int | None = None  # tick
        self.right = self.wrong = 0  # relocations that ended at the right pose, and elsewhere
        self._relocations = 0

    def happens(self, episode: Episode) -> None:
        """Carry the robot away, once, when its time has come."""
        spec = episode.scenario.kidnapping
        if spec is None or self.happened is not None or episode.ticks + 1 < spec.at * episode.scenario.budget:
            return
        been = np.array(episode.poses)
        where = _place_been(been, spec.distance, episode.rng) if spec.inside else _place_not_been(episode, been)
        episode.world.place(np.append(where, episode.rng.uniform(-math.pi, math.pi)))
        self.happened = episode.ticks + 1

    def judge(self, episode: Episode) -> None:
        """Look at the estimate at the end of a tick."""
        right = pose_is_right(compose(episode.base, episode.estimates[-1]), episode.poses[-1])
        if episode.slam.relocations > self._relocations:
            self._relocations = episode.slam.relocations
            self.right, self.wrong = self.right + right, self.wrong + (not right)
        if self.happened is not None and self.recovered is None and right and not episode.slam.lost:
            self.recovered = episode.ticks


def pose_is_right(estimate: Array, true: Array) -> bool:
    """Whether two poses (3,) of one frame are the same, but for `POSITION` and `HEADING`."""
    error = relative(true, estimate)
    return math.hypot(error[0], error[1]) <= POSITION and abs(float(error[2])) <= HEADING


def _place_been(been: Array, distance: float, rng: np.random.Generator) -> Array:
    """One of the places (t, 3) where the robot has been, `distance` [m] from the last or as far as there is."""
    away = np.hypot(*(been[:, :2] - been[-1, :2]).T)
    far = np.flatnonzero(away >= min(distance, float(away.max())))
    place: Array = been[rng.choice(far), :2]
    return place


def _place_not_been(episode: Episode, been: Array) -> Array:
    """The reachable place that is farthest from all where the robot has been."""
    cells = episode.site.cells
    nearest = np.full(len(cells), math.inf)
    for pose in been[::10]:
        nearest = np.minimum(nearest, np.hypot(cells[:, 0] - pose[0], cells[:, 1] - pose[1]))
    place: Array = cells[int(np.argmax(nearest))]
    return place
