"""Named, frozen configurations: the scenarios of the package, those that users add, and the settings of recordings.

In the scenarios of drift, the robot loses so much of its heading between two scans that association determines the
result. At ten scans per second and with good odometry, all associators make the same map. The odometry of these
scenarios is worse than that of the others by a factor of three (level 1) to ten (level 3), and their budgets end where
drivers still differ; the budget of `patrol` ends long after everything has been explored.

Real buildings have halls of 30 m, which need a sensor that reaches across. A robot with a range of 6 m sees nothing in
the middle of such a hall, and no associator can help: features are seen again only after hundreds of metres, from a
pose with an error of metres. A robot with a range of 20 m keeps features in view.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from slam_gym.mapping.stochastic_map import MapSpec
from slam_gym.recordings.recording import Recording
from slam_gym.scenarios.scenario import SPLITS as SPLITS
from slam_gym.scenarios.scenario import KidnappingSpec as KidnappingSpec
from slam_gym.scenarios.scenario import Scenario as Scenario
from slam_gym.scenarios.scenario import overridden as overridden
from slam_gym.scenarios.scenario import parse_override as parse_override
from slam_gym.scenarios.scenario import world_generator as world_generator
from slam_gym.scenarios.scenario import world_seed as world_seed
from slam_gym.scenarios.suite import EXPERIMENTS, get_level
from slam_gym.slam.slam import SlamSpec
from slam_gym.validation import imported
from slam_gym.world.floor_plan import FloorPlan
from slam_gym.world.floor_plan_file import load_floor_plan
from slam_gym.world.generators import AliasedGenerator, HallGenerator, LoopGenerator, OfficeGenerator
from slam_gym.world.physics import DynamicsSpec
from slam_gym.world.reachability import free_cells, reachable
from slam_gym.world.sensor import BeamSpec, OdometrySpec, SensorSpec

DRIFT: dict[int, OdometrySpec] = {
    1: OdometrySpec(forward=0.1, lateral=0.03, turn_per_radian=0.1, turn_per_metre=0.1),
    2: OdometrySpec(forward=0.2, lateral=0.05, turn_per_radian=0.2, turn_per_metre=0.2),
    3: OdometrySpec(forward=0.3, lateral=0.1, turn_per_radian=0.3, turn_per_metre=0.3),
}
"""The odometry of each level of drift. Level 0 is `OdometrySpec()`."""

CROWDED: dict[str, Any] = {
    "dynamics": DynamicsSpec(people=6),
    "sensor": SensorSpec(person_detection=0.3),
    "slam": SlamSpec(MapSpec(confirmations=6, unconfirmed_age=12), new_confidence=1.0 - 1e-6),
}
"""People hide features and are mistaken for features, so that a feature needs more sightings to be confirmed."""

_FEW_AND_BAD = SensorSpec(range=3.5, detection=0.7, clutter=1.0, range_sigma=0.05, bearing_sigma=0.03)
_ROUGH = SensorSpec(range=4.0, range_sigma=0.1, bearing_sigma=0.02)
_HALL_SENSOR = SensorSpec(range_sigma=0.04, bearing_sigma=0.015)
_SHORTEST, _LONGEST = 1_000, 100_000  # [ticks] limits of the budget of a floor
_LARGE_ROOMS = OfficeGenerator(rooms=8, room_width=(8.0, 16.0), room_depth=(8.0, 16.0), corridor_width=(3.0, 5.0))


def _drifting(name: str, generator: Any, level: int, budget: int = 450, **changes: Any) -> Scenario:
    return Scenario(name, generator, budget, odometry=DRIFT[level], associator="learned", **changes)


SCENARIOS: dict[str, Scenario] = {
    scenario.name: scenario
    for scenario in (
        # four rooms, for a first try and for tests
        Scenario("office-small", OfficeGenerator(rooms=4), budget=300),
        # good odometry: associators differ little, drivers much
        Scenario("office", OfficeGenerator(), budget=800),
        # identical rooms, which good odometry tells apart
        Scenario("aliased", AliasedGenerator(), budget=800),
        # long views, and odometry with notable drift
        Scenario(
            "hall",
            HallGenerator(),
            budget=600,
            sensor=_HALL_SENSOR,
            odometry=OdometrySpec(forward=0.05, turn_per_radian=0.05, turn_per_metre=0.05),
        ),
        # six people hide features, or pass for some
        Scenario("crowd", OfficeGenerator(), budget=800, **CROWDED),
        # carried at half time to a place where it has been
        Scenario("kidnapped", OfficeGenerator(), budget=800, kidnapping=KidnappingSpec()),
        # odometry three to five times as bad as that of `office`
        _drifting("drift-1", OfficeGenerator(), 1),
        # five to ten times as bad: nearest neighbour fails
        _drifting("drift-2", OfficeGenerator(), 2),
        # ten to fifteen times as bad: σ of 8° in a fast turn of a tick
        _drifting("drift-3", OfficeGenerator(), 3),
        # identical rooms, which odometry cannot distinguish
        _drifting("aliased-drift", AliasedGenerator(), 2),
        # long views, where a wrong heading matters most
        _drifting("hall-drift", HallGenerator(), 2, sensor=_HALL_SENSOR),
        # drift, and people mistaken for features
        _drifting("crowd-drift", OfficeGenerator(), 2, **CROWDED),
        # drift, and a sensor of short range, few detections and much noise
        _drifting("sparse", OfficeGenerator(), 2, sensor=_FEW_AND_BAD),
        # only the return to the start corrects the drift of the map
        _drifting("loop", LoopGenerator(), 1, budget=900, sensor=SensorSpec(range=4.0)),
        # a small office, explored at half time: revisits improve its map
        _drifting("patrol", OfficeGenerator(rooms=6), 1, budget=1_500, sensor=_ROUGH),
        # large rooms, and a robot that sees across them, the default for floor plan files
        Scenario(
            "building",
            _LARGE_ROOMS,
            budget=3_000,
            slam=SlamSpec(
                MapSpec(unconfirmed_age=5),
                new_confidence=1.0 - 1e-6,
                outlier_factor=25.0,  # in 12 000 steps, a motion is four standard deviations off
                max_chance_probability=0.05,  # door jambs come in pairs
                negative_evidence=True,  # in 12 000 steps, spurious measurements confirm some twenty features
            ),
            associator="learned",  # the best on real floors
            sensor=SensorSpec(range=20.0),  # 9 features in view on real floors, more than 20 in one of thirty scans
            beams=BeamSpec(count=90, range=20.0),
            wall_compass=True,  # in a hall without features in view, the walls still determine the heading
        ),
        # rooms of `building`, whose middle the robot of `office` does not see: driving matters
        Scenario("short-sighted", _LARGE_ROOMS, budget=5_000),
    )
}
"""The scenarios by name, without the levels of the suite (`slam_gym.scenarios.suite`), which are known by their ids."""


def get_scenario(name: str) -> Scenario:
    """The scenario with a name, the id of a level of the suite such as `closure/3`, or a name `"module:name"`.

    The module is imported; it must register a scenario `name`, or contain it in a variable `name`. Raises ValueError,
    listing the known names, for an unknown name.
    """
    if name in SCENARIOS:
        return SCENARIOS[name]
    if name.partition("/")[0] in EXPERIMENTS and "/" in name:
        return get_level(name).scenario
    if name == "corridor" or name.startswith("recording:"):
        raise ValueError(f"scenario {name!r} is for Associate-v0: it has scans, but no world to drive in")
    levels = ", ".join(f"{experiment}/…" for experiment in EXPERIMENTS)
    found = imported("scenario", name, SCENARIOS, f"; levels of the suite: {levels}")
    if not isinstance(found, Scenario):
        raise ValueError(f"scenario {name!r} is of type {type(found).__name__}, not a Scenario")
    return found


def register(scenario: Scenario) -> None:
    """Register a scenario by its name, in this process, for `get_scenario` and the environments.

    Raises ValueError if another scenario has this name, or the name could be that of a level of the suite.
    """
    if SCENARIOS.get(scenario.name, scenario) != scenario:
        raise ValueError(f"there is another scenario {scenario.name!r} already")
    if not scenario.name or "/" in scenario.name:
        raise ValueError(f"scenario name {scenario.name!r}: is empty or has a slash, as only levels of the suite have")
    SCENARIOS[scenario.name] = scenario


def from_floor_plan(path: str | Path, resolution: float | None = None, like: Scenario | None = None) -> Scenario:
    """A scenario on a floor plan file: the package's JSON, or an occupancy image with its `resolution` [m per pixel].

    Robot, people, sensors and filter are those of `like` (default: building). The plan is read once, here; errors are
    those of `load_floor_plan`. Seeds vary the start and the noise. The budget grows with the area that the robot can
    reach (see `slam_gym.scenarios.floor_budget`).
    """
    plan, like = load_floor_plan(path, resolution), like or SCENARIOS["building"]
    return replace(like, name=plan.name, generator=partial(_this_plan, plan), budget=floor_budget(plan, like))


def _this_plan(plan: FloorPlan, _rng: np.random.Generator) -> FloorPlan:
    return plan


def floor_budget(plan: FloorPlan, like: Scenario) -> int:
    """Ticks in which the robot of `like` can explore a floor: reachable area · (2 + 20 m / range of the beams) per m².

    On real floors, a driver that was never lost explored 0.95 of the area after 1.4 to 1.9 ticks per m² with beams of
    20 m, and after 3.9 with beams of 6 m, so that a third to a half of the budget remains for detours and revisits.
    """
    cells = free_cells(plan, like.robot.radius)
    area = len(reachable(plan, cells)) * cells.cell**2
    return int(np.clip(area * (2.0 + 20.0 / like.beams.range), _SHORTEST, _LONGEST))


LOG_SETTINGS = SlamSpec(
    MapSpec(confirmations=3, unconfirmed_age=20),
    new_confidence=1.0 - 1e-12,
    max_accidental_matches=1.0,
    max_chance_probability=0.05,
    trust_marginals=False,
)
"""Settings for real data: those of logs without settings of their own. The reach is taken from the scans. The gate of
new features is wide, 7.4 σ, since the errors of real logs have heavy tails and last for several scans; closer features
are mapped as one."""

VICTORIA_PARK = SlamSpec(MapSpec(confirmations=5, unconfirmed_age=20), reach=80.0, new_confidence=1.0 - 1e-6)
"""A trunk must be seen in five of twenty scans. With two sightings, the map of the first half has 118 more features, of
which 23 are labelled trees; the trajectory is the same."""

MRCLAM = SlamSpec(MapSpec(unconfirmed_age=None), reach=12.0, new_confidence=1.0 - 1e-12, error_length=0.2)
"""Unconfirmed features are kept, and the gate is wide: a robot may see a barcode again only after minutes of drift. It
moves by 2 cm from scan to scan, and a range keeps its error until the robot has moved by decimetres."""

SETTINGS = {"victoria_park": VICTORIA_PARK, "mrclam": MRCLAM}
"""Settings by the first part of a recording's name."""


def slam_for(recording: Recording) -> SlamSpec:
    """The settings for a recording: those chosen for its kind, or `LOG_SETTINGS`."""
    return SETTINGS.get(recording.name.partition("/")[0], LOG_SETTINGS)
