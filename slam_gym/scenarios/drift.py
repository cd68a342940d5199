"""Scenarios in which drift counts: between two looks the robot loses so much of its heading that association decides.

At ten scans a second, with wheels that are good, every associator makes the same map. These wheels are worse, the other
scenarios' by three (level 1) to ten (level 3), and the budgets end where drivers still differ;
that of `patrol` ends long after all has been explored.
"""

from __future__ import annotations

from typing import TypedDict

from slam_gym.mapping.stochastic_map import MapSpec
from slam_gym.scenarios.scenario import Scenario
from slam_gym.slam.slam import SlamSpec
from slam_gym.world.generators import AliasedGenerator, HallGenerator, LoopGenerator, OfficeGenerator
from slam_gym.world.physics import DynamicsSpec
from slam_gym.world.sensor import OdometrySpec, SensorSpec

DRIFT: dict[int, OdometrySpec] = {
    1: OdometrySpec(forward=0.1, lateral=0.03, turn_per_radian=0.1, turn_per_metre=0.1),
    2: OdometrySpec(forward=0.2, lateral=0.05, turn_per_radian=0.2, turn_per_metre=0.2),
    3: OdometrySpec(forward=0.3, lateral=0.1, turn_per_radian=0.3, turn_per_metre=0.3),
}
"""The wheels of each level of drift. Level 0 is `OdometrySpec()`."""


class _Crowd(TypedDict):
    dynamics: DynamicsSpec
    sensor: SensorSpec
    slam: SlamSpec


CROWDED: _Crowd = {
    "dynamics": DynamicsSpec(people=6),
    "sensor": SensorSpec(person_detection=0.3),
    "slam": SlamSpec(MapSpec(confirmations=6, unconfirmed_age=12), new_confidence=1.0 - 1e-6),
}
"""People hide features and are taken for some, so that it takes more sightings to believe in a feature."""

_FEW_AND_BAD = SensorSpec(range=3.5, detection=0.7, clutter=1.0, range_sigma=0.05, bearing_sigma=0.03)
_SHORT_SIGHT = SensorSpec(range=4.0)
_ROUGH = SensorSpec(range=4.0, range_sigma=0.1, bearing_sigma=0.02)
_HALL_SENSOR = SensorSpec(range_sigma=0.04, bearing_sigma=0.015)

DRIFTING: tuple[Scenario, ...] = (
    Scenario(
        "drift-1",  # wheels three times as bad as those of `office`
        OfficeGenerator(),
        budget=450,
        odometry=DRIFT[1],
        associator="learned",
    ),
    Scenario(
        "drift-2",  # seven times as bad: nearest neighbours lose themselves
        OfficeGenerator(),
        budget=450,
        odometry=DRIFT[2],
        associator="learned",
    ),
    Scenario(
        "drift-3",  # ten times as bad: a tick turns by 5° more or less than the wheels say
        OfficeGenerator(),
        budget=450,
        odometry=DRIFT[3],
        associator="learned",
    ),
    Scenario(
        "aliased-drift",  # identical rooms, and wheels that do not tell them apart
        AliasedGenerator(),
        budget=450,
        odometry=DRIFT[2],
        associator="learned",
    ),
    Scenario(
        "hall-drift",  # long views, in which a wrong heading shows most
        HallGenerator(),
        budget=450,
        odometry=DRIFT[2],
        associator="learned",
        sensor=_HALL_SENSOR,
    ),
    Scenario(
        "crowd-drift",  # drift among people, who are taken for features
        OfficeGenerator(),
        budget=450,
        odometry=DRIFT[2],
        associator="learned",
        **CROWDED,
    ),
    Scenario(
        "sparse",  # drift, and a sensor that sees little, seldom and badly
        OfficeGenerator(),
        budget=450,
        odometry=DRIFT[2],
        associator="learned",
        sensor=_FEW_AND_BAD,
    ),
    Scenario(
        "loop",  # only coming round to the start tells how far the map has bent
        LoopGenerator(),
        budget=900,
        odometry=DRIFT[1],
        associator="learned",
        sensor=_SHORT_SIGHT,
    ),
    Scenario(
        "patrol",  # a small office, known at half time: who goes back over it has the better map
        OfficeGenerator(rooms=6),
        budget=1_500,
        odometry=DRIFT[1],
        associator="learned",
        sensor=_ROUGH,
    ),
)
