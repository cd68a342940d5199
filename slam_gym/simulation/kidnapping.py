"""Kidnapping: the robot is carried elsewhere during the episode, and has to relocate."""

import math

import numpy as np

from slam_gym.geometry import relative
from slam_gym.scenarios import KidnappingSpec
from slam_gym.types import Array

POSITION, HEADING = 0.5, math.radians(10.0)  # [m], [rad] greatest error of a right pose


class Kidnapping:
    """Carries out the kidnapping of an episode, and judges whether the robot recovers.

    A pose is right within `POSITION` and `HEADING` of the truth. `recovered` is the first tick after the kidnapping at
    which the pose was right and the robot not lost; a relocation to any other pose counts as wrong.
    """

    def __init__(self, spec: KidnappingSpec | None, budget: int) -> None:
        self._spec, self._budget = spec, budget
        self.happened: int | None = None  # tick of the kidnapping
        self.recovered: int | None = None  # tick of the recovery
        self.right = self.wrong = 0  # numbers of right and wrong relocations
        self._relocations = 0

    def destination(self, tick: int, been: list[Array], cells: Array, rng: np.random.Generator) -> Array | None:
        """Pose (3,) in W to which the robot is carried in this tick; None if it is not.

        `been` are its true poses (3,) so far, `cells` (c, 2) [m] all places that it can reach.
        """
        if self._spec is None or self.happened is not None or tick < self._spec.at * self._budget:
            return None
        self.happened, trail = tick, np.array(been)
        place = _place_been(trail, self._spec.distance, rng) if self._spec.inside else _place_not_been(trail, cells)
        return np.append(place, rng.uniform(-math.pi, math.pi))

    def judge(self, tick: int, estimate: Array, true: Array, relocations: int, lost: bool) -> None:
        """Record whether the estimated pose (3,) at the end of a tick is right."""
        right = is_right(estimate, true)
        if relocations > self._relocations:
            self._relocations = relocations
            self.right, self.wrong = self.right + right, self.wrong + (not right)
        if self.happened is not None and self.recovered is None and right and not lost:
            self.recovered = tick


def is_right(estimate: Array, true: Array, position: float = POSITION, heading: float = HEADING) -> bool:
    """Whether a pose (3,) is within `position` [m] and `heading` [rad] of the true pose (3,)."""
    x, y, turn = relative(true, estimate).tolist()
    return math.hypot(x, y) <= position and abs(turn) <= heading


def _place_been(been: Array, distance: float, rng: np.random.Generator) -> Array:
    """A random one of the poses `been` (t, 3), at least `distance` [m] from the last one or as far as possible."""
    distances = np.hypot(*(been[:, :2] - been[-1, :2]).T)
    far = np.flatnonzero(distances >= min(distance, float(distances.max())))
    return np.asarray(been[rng.choice(far), :2])


def _place_not_been(been: Array, cells: Array) -> Array:
    """The reachable place (2,) that is farthest from all poses where the robot has been."""
    nearest = np.full(len(cells), math.inf)
    for pose in been[::10]:
        nearest = np.minimum(nearest, np.hypot(cells[:, 0] - pose[0], cells[:, 1] - pose[1]))
    return np.asarray(cells[int(np.argmax(nearest))])
