"""Real buildings, and a robot for them: halls of 30 m want eyes that reach across.

A robot that sees 6 m is blind in the middle of such a hall, and no association helps it: features are met again after
hundreds of metres, by a pose that has gone wrong by metres. One that sees 20 m keeps features in view.
"""

from __future__ import annotations

import numpy as np

from slam_gym.mapping.stochastic_map import MapSpec
from slam_gym.scenarios.scenario import Scenario
from slam_gym.slam.slam import SlamSpec
from slam_gym.world.floor_plan import FloorPlan
from slam_gym.world.generators import OfficeGenerator
from slam_gym.world.reachability import free_cells, indoor
from slam_gym.world.sensor import BeamSpec, SensorSpec

_LARGE_ROOMS = OfficeGenerator(rooms=8, room_width=(8.0, 16.0), room_depth=(8.0, 16.0), corridor_width=(3.0, 5.0))

BUILDINGS: tuple[Scenario, ...] = (
    Scenario(
        "building",  # large rooms, and a robot that sees across them: by default that of floor plan files
        _LARGE_ROOMS,
        budget=3_000,
        slam=SlamSpec(
            MapSpec(unconfirmed_age=5),
            new_confidence=1.0 - 1e-6,
            max_chance_probability=0.05,  # jambs stand in pairs
        ),
        sensor=SensorSpec(range=20.0),  # 9 features in sight on real floors, more than 20 in one scan of thirty
        beams=BeamSpec(count=90, range=20.0),
        wall_compass=True,  # where a hall shows no feature, its walls still say where the robot is heading
    ),
    Scenario(
        "short-sighted",  # the robot of `office` in the same rooms: blind in their middle: who drives matters
        _LARGE_ROOMS,
        budget=5_000,
    ),
)

_SHORTEST, _LONGEST = 1_000, 100_000  # [ticks]


def floor_budget(plan: FloorPlan, like: Scenario) -> int:
    """Ticks in which `like`'s robot can explore a floor: reachable area · (2 + 20 m / range of the beams) per m².

    On real floors a driver that never lost itself knew .95 of the area after 1.4 to 1.9 ticks per m² with beams of
    20 m, and after 3.9 with beams of 6 m, so that a third to a half of the budget is left for detours and revisits.
    """
    cells = free_cells(plan, like.robot.radius)
    area = len(indoor(plan, cells)) * cells.cell**2
    return int(np.clip(area * (2.0 + 20.0 / like.beams.range), _SHORTEST, _LONGEST))
