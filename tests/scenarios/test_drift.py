"""The scenarios in which drift counts: what their wheels and their rooms are there for."""

import numpy as np
import pytest

from slam_gym.geometry import compose, relative
from slam_gym.scenarios import SCENARIOS, get_scenario
from slam_gym.scenarios.drift import DRIFT, DRIFTING
from slam_gym.simulation.episode import survey
from slam_gym.world.physics import Motion
from slam_gym.world.sensor import OdometrySpec, Sensor


def test_they_are_known_by_name() -> None:
    assert [scenario.name for scenario in DRIFTING] == [
        "drift-1", "drift-2", "drift-3", "aliased-drift", "hall-drift", "crowd-drift", "sparse", "loop",
        "patrol",
    ]  # fmt: skip
    assert all(SCENARIOS[scenario.name] is scenario for scenario in DRIFTING)


def test_each_level_loses_more_of_its_way_than_the_one_before() -> None:
    scenario = get_scenario("office")
    site = survey(scenario.generator(np.random.default_rng(0)), scenario)
    way = Motion(moved=np.array([0.1, 0.0, 0.05]), wheels=np.array([0.1, 0.0, 0.05]), contact=False)
    lost = []
    for wheels in (OdometrySpec(), *DRIFT.values()):
        sensor = Sensor(site.plan, site.index, scenario.sensor, scenario.beams, wheels)
        rng, errors = np.random.default_rng(1), []
        for _ in range(100):
            believed = true = np.zeros(3)
            for _ in range(20):
                believed, true = compose(believed, sensor.odometry(way, rng).motion), compose(true, way.moved)
            errors.append(relative(true, believed))
        lost.append(np.sqrt(np.mean(np.square(errors), axis=0)))
    assert (np.diff(lost, axis=0) > 0.0).all()
    assert lost[3][2] > 5.0 * lost[0][2]  # the heading at level 3


@pytest.mark.parametrize("seed", range(3))
def test_the_sides_of_the_loop_do_not_see_each_other(seed) -> None:
    scenario = get_scenario("loop")
    plan = scenario.generator(np.random.default_rng(seed))
    centres = np.array([room.centre for room in plan.rooms])
    gaps = np.hypot(*(centres[:, None] - centres[None]).T)
    assert gaps[~np.eye(4, dtype=bool)].min() > scenario.sensor.range
    assert not survey(plan, scenario).index.visible(centres[0], centres[1:], np.zeros(3)).any()
