"""A scenario: a generator of worlds, a robot with its sensors and filter, and a budget; and the seeds of its worlds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from slam_gym.mapping.stochastic_map import MapSpec
from slam_gym.slam.slam import SlamSpec
from slam_gym.validation import check_settings, one_of
from slam_gym.world.floor_plan import FloorPlan
from slam_gym.world.physics import DynamicsSpec, RobotSpec
from slam_gym.world.sensor import BeamSpec, OdometrySpec, SensorSpec

SPLITS = {"train": (0, 1_000_000), "test": (1_000_000, 10_000)}
"""First world seed and number of worlds of each split."""


@dataclass(frozen=True)
class KidnappingSpec:
    """The robot is carried elsewhere, and neither its odometry nor any other measurement shows it."""

    at: float = 0.5  # fraction of the budget after which it happens
    inside: bool = True  # to a place where it has been; False: to the place farthest from all where it has been
    distance: float = 5.0  # [m] least distance from its last place, if possible; for `inside`

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class Scenario:
    """Everything that defines an episode, except its seed."""

    name: str
    generator: Callable[[np.random.Generator], FloorPlan]
    budget: int  # [ticks] length of an episode
    robot: RobotSpec = field(default_factory=RobotSpec)
    dynamics: DynamicsSpec = field(default_factory=DynamicsSpec)
    sensor: SensorSpec = field(default_factory=SensorSpec)
    beams: BeamSpec = field(default_factory=BeamSpec)
    odometry: OdometrySpec = field(default_factory=OdometrySpec)
    slam: SlamSpec = field(default_factory=lambda: SlamSpec(MapSpec(unconfirmed_age=5), new_confidence=1.0 - 1e-6))
    associator: str = "jcbb"  # default associator
    prior_sigma: float = 0.5  # [m] σ₀: the error of a feature that has not been mapped
    grid_resolution: float = 0.2  # [m] side of a cell of the explored grid
    wall_compass: bool = False  # whether straight walls in view correct odometry
    kidnapping: KidnappingSpec | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.budget, int):
            raise ValueError(f"Scenario.budget={self.budget}: expected a whole number of ticks")
        check_settings(self)


def world_seed(split: str, index: int) -> int:
    """The seed of world `index` of a split. Raises ValueError for an unknown split or an index outside it."""
    one_of("split", split, SPLITS)
    first, count = SPLITS[split]
    whole = isinstance(index, int | np.integer) and not isinstance(index, bool)
    if not (whole and 0 <= index < count):
        raise ValueError(f"world {index!r} of split {split!r}: expected a whole number 0 … {count - 1}")
    return first + int(index)


def world_generator(split: str, index: int) -> np.random.Generator:
    """The random generator for the plan of a world, independent of `reset(seed=…)`. Raises as `world_seed`."""
    return np.random.default_rng((world_seed(split, index), 1))
