"""Named, frozen scenarios: a world to draw, a robot with its sensors and filter, a budget; train and test seeds."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from slam_gym.mapping.stochastic_map import MapSpec
from slam_gym.slam.slam import SlamSpec
from slam_gym.world.floor_plan import FloorPlan, load_floor_plan
from slam_gym.world.generators import AliasedGenerator, HallGenerator, OfficeGenerator
from slam_gym.world.physics import DynamicsSpec, RobotSpec
from slam_gym.world.sensor import BeamSpec, OdometrySpec, SensorSpec

SPLITS = {"train": (0, 1_000_000), "test": (1_000_000, 10_000)}
"""First world seed and number of worlds of each split."""


@dataclass(frozen=True)
class KidnappingSpec:
    """Somebody carries the robot elsewhere; neither its wheels nor anything else tell it."""

    at: float = 0.5  # share of the budget after which it happens
    inside: bool = True  # to a place where it has been before; False: to one as far from all those as there is
    distance: float = 5.0  # [m] from where it was, if there is such a place

    def __post_init__(self) -> None:
        if not 0.0 < self.at < 1.0:
            raise ValueError(f"KidnappingSpec.at: {self.at} is not between 0 and 1")
        if not 0.0 <= self.distance < math.inf:
            raise ValueError(f"KidnappingSpec.distance: {self.distance} is no length [m]")


@dataclass(frozen=True)
class Scenario:
    """Everything that defines an episode but its seed."""

    name: str
    generator: Callable[[np.random.Generator], FloorPlan]
    budget: int  # [ticks] an episode lasts
    robot: RobotSpec = field(default_factory=RobotSpec)
    dynamics: DynamicsSpec = field(default_factory=DynamicsSpec)
    sensor: SensorSpec = field(default_factory=SensorSpec)
    beams: BeamSpec = field(default_factory=BeamSpec)
    odometry: OdometrySpec = field(default_factory=OdometrySpec)
    slam: SlamSpec = field(default_factory=lambda: SlamSpec(MapSpec(unconfirmed_age=5), new_confidence=1.0 - 1e-6))
    prior_sigma: float = 0.5  # [m] σ₀: what a feature that has not been mapped is off by
    grid_resolution: float = 0.2  # [m] of the explored grid
    kidnapping: KidnappingSpec | None = None

    def __post_init__(self) -> None:
        if not (isinstance(self.budget, int) and self.budget >= 1):
            raise ValueError(f"Scenario.budget must be a whole number of ticks > 0, not {self.budget}")
        for name in ("prior_sigma", "grid_resolution"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"Scenario.{name} must be a finite length > 0 [m], not {getattr(self, name)}")


def world_seed(split: str, index: int) -> int:
    """Seed of the `index`-th world of a split. Raises ValueError for an unknown split or an index outside it."""
    if split not in SPLITS:
        raise ValueError(f"unknown split {split!r}; known: {', '.join(SPLITS)}")
    first, count = SPLITS[split]
    if not (0 <= index < count and index == int(index)):
        raise ValueError(f"world {index} of split {split!r}: expected a whole number 0 … {count - 1}")
    return first + int(index)


def world_generator(split: str, index: int) -> np.random.Generator:
    """What the plan of a world is drawn from; never the stream of `reset(seed=…)`. Raises as `world_seed`."""
    return np.random.default_rng((world_seed(split, index), 1))


def from_floor_plan(path: str | Path, resolution: float | None = None, like: Scenario | None = None) -> Scenario:
    """A scenario on a floor plan file: the package's JSON, or an occupancy image with its `resolution` [m per pixel].

    Robot, people, sensors and filter are those of `like` (default: office). The plan is read once, here; faults in the
    file are reported by `load_floor_plan`. Seeds vary the start and the noise. The budget grows with the floor.
    """
    plan = load_floor_plan(path, resolution)
    x0, y0, x1, y1 = plan.bounds
    budget = int(np.clip(3.0 * (x1 - x0) * (y1 - y0), 1_000, 20_000))
    return replace(like or SCENARIOS["office"], name=plan.name, generator=partial(_given, plan), budget=budget)


def _given(plan: FloorPlan, _rng: np.random.Generator) -> FloorPlan:
    return plan


SCENARIOS: dict[str, Scenario] = {
    scenario.name: scenario
    for scenario in (
        Scenario("office-small", OfficeGenerator(rooms=4), budget=300),
        Scenario("office", OfficeGenerator(), budget=800),
        Scenario("aliased", AliasedGenerator(), budget=800),
        Scenario(
            "hall",  # long views, and a robot whose noise makes drift count
            HallGenerator(),
            budget=600,
            sensor=SensorSpec(range_sigma=0.04, bearing_sigma=0.015),
            odometry=OdometrySpec(forward=0.05, turn_per_radian=0.05, turn_per_metre=0.05),
        ),
        Scenario(
            "crowd",  # people hide features and are taken for some, so that it takes more sightings to believe in one
            OfficeGenerator(),
            budget=800,
            dynamics=DynamicsSpec(people=6),
            sensor=SensorSpec(person_detection=0.3),
            slam=SlamSpec(MapSpec(confirmations=6, unconfirmed_age=12), new_confidence=1.0 - 1e-6),
        ),
        Scenario(
            "kidnapped",  # carried away at half time, to where it has been: pass relocation="gcbb" to find back
            OfficeGenerator(),
            budget=800,
            kidnapping=KidnappingSpec(),
        ),
    )
}


def get_scenario(name: str) -> Scenario:
    """The scenario of that name. Raises ValueError that lists the known ones."""
    if name not in SCENARIOS:
        raise ValueError(f"unknown scenario {name!r}; known: {', '.join(SCENARIOS)}")
    return SCENARIOS[name]
