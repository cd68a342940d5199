"""What goes with a map where several are kept side by side: see `slam_gym.slam.deferred`."""

from __future__ import annotations

import copy
from typing import NamedTuple

from slam_gym.navigation.explored_grid import ExploredGrid
from slam_gym.navigation.keyframes import Keyframes
from slam_gym.types import Array


class Belief(NamedTuple):
    """Explored space and the way, as one of several maps has them."""

    grid: ExploredGrid
    sweeps: Keyframes  # in that grid
    estimates: list[Array]  # (3,) in B, one per tick
    nees: list[float]  # of those

    def copy(self) -> Belief:
        """One that goes its own way from here."""
        grid, sweeps = copy.deepcopy((self.grid, self.sweeps))
        return Belief(grid, sweeps, self.estimates.copy(), self.nees.copy())
