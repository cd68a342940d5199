"""A robot for buildings, and the time that it gets for one."""

from dataclasses import replace

import numpy as np
import pytest

from slam_gym.scenarios import SCENARIOS
from slam_gym.scenarios.buildings import BUILDINGS, floor_budget
from slam_gym.world.floor_plan import Features, FloorPlan
from slam_gym.world.floor_plan_file import load_floor_plan
from slam_gym.world.generators import HallGenerator

NO_FEATURES = Features(np.empty((0, 2)), np.empty(0, np.int64), np.empty(0))


def square(side: float) -> FloorPlan:
    corners = np.array([[0.0, 0.0], [side, 0.0], [side, side], [0.0, side]])
    return FloorPlan("square", np.hstack([corners, np.roll(corners, -1, axis=0)]), NO_FEATURES)


def test_both_robots_are_put_into_the_same_worlds() -> None:
    building, short_sighted = BUILDINGS
    assert building.generator == short_sighted.generator and building.robot == short_sighted.robot
    assert building.sensor.range == building.beams.range == 20.0 and building.beams.count == 90
    assert short_sighted.sensor.range == short_sighted.beams.range == 6.0


def test_the_robot_for_buildings_steers_by_walls_and_no_other_does() -> None:
    assert [s.name for s in SCENARIOS.values() if s.wall_compass] == ["building"]


@pytest.mark.parametrize("side", [25.0, 60.0])
def test_the_budget_follows_the_area_that_can_be_reached(side) -> None:
    building, short_sighted = BUILDINGS
    budget = floor_budget(square(side), building)
    assert budget == pytest.approx(3.0 * (side - 0.4) ** 2, rel=0.03)
    assert floor_budget(square(side), short_sighted) == pytest.approx(budget * (2.0 + 20.0 / 6.0) / 3.0, rel=0.001)
    walled_in = np.concatenate([square(side).walls, [[0.0, side / 4, side, side / 4]]])
    assert floor_budget(FloorPlan("cut", walled_in, NO_FEATURES), building) == pytest.approx(0.75 * budget, rel=0.05)


def test_small_floors_get_a_thousand_ticks_and_a_fat_robot_the_area_that_is_left_to_it() -> None:
    building, _ = BUILDINGS
    assert floor_budget(square(5.0), building) == 1_000
    hall = HallGenerator(length=(40.0, 40.0), width=(40.0, 40.0))(np.random.default_rng(0))
    fat = replace(building, robot=replace(building.robot, radius=0.6))
    assert floor_budget(hall, fat) < floor_budget(hall, building)


def test_real_floors_get_the_time_that_they_take(data_dir) -> None:
    plan = load_floor_plan(data_dir / "kth_floorplans" / "50052748_occ_map.npy.gz", 0.1)
    assert 6_000 < floor_budget(plan, BUILDINGS[0]) < 7_500
