"""Kidnapping: the robot is carried elsewhere during the episode, and has to relocate."""

import math

import numpy as np
from scipy.spatial import cKDTree

from slam_gym.geometry import relative
from slam_gym.scenarios import KidnappingSpec
from slam_gym.types import Array
from slam_gym.world.ray_casting import box_distance

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

    def destination(
        self, tick: int, been: list[Array], free: tuple[Array, float, Array], rng: np.random.Generator
    ) -> Array | None:
        """Pose (3,) in W to which the robot is carried in this tick; None if it is not.

        `been` are its true poses (3,) so far. `free` are all places (c, 2) [m] between walls that it can reach, its
        radius [m] and the furniture (f, 5).
        """
        if self._spec is None or self.happened is not None or tick < self._spec.at * self._budget:
            return None
        self.happened, trail, (cells, radius, furniture) = tick, np.array(been)[:, :2], free

        def clear(places: Array) -> Array:
            """The places (c, 2) at which the robot would not stand in furniture; all of them if there is none."""
            is_clear = np.array([box_distance(x, y, furniture) >= radius for x, y in places])
            return places[is_clear] if is_clear.any() else places

        if self._spec.inside:  # at least so far from the last place, or as far as possible
            distances = np.hypot(*(trail - trail[-1]).T)
            far = np.flatnonzero(distances >= min(self._spec.distance, float(distances.max())))
            place = rng.choice(clear(trail[far]))
        else:  # the place that is farthest from all where the robot has been
            cells = clear(cells)
            place = cells[cKDTree(trail[::10]).query(cells)[0].argmax()]
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
