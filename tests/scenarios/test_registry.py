"""Scenarios by name, those that users add, floor plans from files, and settings of recordings."""

from dataclasses import replace

import numpy as np
import pytest

from slam_gym import scenarios
from slam_gym.envs.associate import AssociateEnv
from slam_gym.envs.explore import ExploreEnv
from slam_gym.geometry import compose, relative
from slam_gym.recordings import Recording
from slam_gym.scenarios import SCENARIOS, SPLITS, Scenario, floor_budget, from_floor_plan, get_scenario, register
from slam_gym.scenarios.suite import EXPERIMENTS, get_level
from slam_gym.simulation.episode import survey
from slam_gym.world.floor_plan import FloorPlan
from slam_gym.world.floor_plan_file import save_floor_plan
from slam_gym.world.generators import OfficeGenerator
from slam_gym.world.physics import Motion
from slam_gym.world.ray_casting import NOTHING, seen_from
from slam_gym.world.sensor import OdometrySpec, Sensor
from tests.recordings.test_recording import by_hand
from tests.rollouts import episode, explore
from tests.scenarios.test_scenario import assert_frozen
from tests.world.test_reachability import NO_FEATURES, rectangle


def test_the_known_scenarios_are_found_by_name() -> None:
    assert list(SCENARIOS)[:6] == ["office-small", "office", "aliased", "hall", "crowd", "kidnapped"]
    for name, scenario in SCENARIOS.items():
        assert get_scenario(name) is scenario and scenario.name == name
    with pytest.raises(ValueError, match=r"'offices'; did you mean 'office'\? known: office-small, office, aliased"):
        get_scenario("offices")


def test_scenarios_are_frozen_to_the_bottom() -> None:
    for scenario in SCENARIOS.values():
        assert_frozen(scenario)


def test_a_user_s_scenario_is_found_by_its_name(monkeypatch) -> None:
    for name in list(SCENARIOS):
        monkeypatch.setitem(SCENARIOS, name, SCENARIOS[name])
    mine = replace(get_scenario("office-small"), name="mine", budget=40)
    monkeypatch.setitem(SCENARIOS, "mine", mine)  # taken back at the end of the test, as the others are
    del SCENARIOS["mine"]
    register(mine)
    register(mine)  # the same again, as when the cell of a notebook is run twice
    assert get_scenario("mine") is mine and ExploreEnv("mine").scenario is mine
    with pytest.raises(ValueError, match="another scenario 'mine'"):
        register(replace(mine, budget=41))
    for name in ("", "closure/0", "mine/2"):
        with pytest.raises(ValueError, match="is empty or has a slash"):
            register(replace(mine, name=name))


def test_a_scenario_in_a_user_s_module_is_found_through_the_module(monkeypatch, tmp_path) -> None:
    monkeypatch.setattr("slam_gym.scenarios.SCENARIOS", dict(SCENARIOS))
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "my_halls.py").write_text(
        "from dataclasses import replace\nfrom slam_gym.scenarios import get_scenario, register\n"
        "BUSY = replace(get_scenario('hall'), name='busy-hall', budget=30)\nregister(BUSY)\nDOORS = 3\n"
    )
    assert get_scenario("my_halls:busy-hall") is get_scenario("my_halls:BUSY")
    assert ExploreEnv("my_halls:busy-hall").scenario == AssociateEnv("my_halls:busy-hall").scenario
    for name, message in (
        ("my_halls:DOORS", "is of type int, not a Scenario"),
        ("my_halls:calm-hall", "known: office-small"),
        ("no_halls:BUSY", "No module named 'no_halls'; known: office-small"),
    ):
        with pytest.raises(ValueError, match=message):
            get_scenario(name)


WORLDS = {(scenario.generator, scenario.sensor.range): scenario for scenario in SCENARIOS.values()}
"""A scenario of each kind of world: the others differ in wheels, in who walks about, or in what is measured."""


@pytest.mark.parametrize("scenario", WORLDS.values(), ids=lambda scenario: scenario.name)
@pytest.mark.parametrize("split", SPLITS)
def test_worlds_are_reproducible_differ_and_can_be_explored(scenario, split) -> None:
    drawn = []
    for index in (0, 1, SPLITS[split][1] - 1):
        first, again = (scenario.generator(np.random.default_rng(scenarios.world_seed(split, index))) for _ in range(2))
        np.testing.assert_array_equal(first.walls, again.walls)
        np.testing.assert_array_equal(first.features.positions, again.features.positions)
        assert all(p.walls.shape != first.walls.shape or not np.array_equal(p.walls, first.walls) for p in drawn)
        drawn.append(first)
        site = survey(first, scenario)
        assert len(site.cells) > 100 and 20 <= site.observable.sum() <= len(first.features)


def drive(scenario: Scenario, steps: int) -> dict[str, float]:
    env = explore(scenario)
    list(episode(env, steps))
    return env.map_quality()


def test_a_floor_plan_file_becomes_a_scenario_with_a_budget_for_its_size(tmp_path) -> None:
    plans = [OfficeGenerator(rooms=rooms)(np.random.default_rng(3)) for rooms in (2, 12, 100)]
    scenarios = []
    for i, plan in enumerate(plans):
        save_floor_plan(plan, tmp_path / f"{i}.json")
        scenarios.append(from_floor_plan(tmp_path / f"{i}.json"))
        np.testing.assert_array_equal(scenarios[-1].generator(np.random.default_rng(0)).walls, plan.walls)
        assert (scenarios[-1].sensor.range, scenarios[-1].beams.range, scenarios[-1].beams.count) == (20.0, 20.0, 90)
    budgets = [scenario.budget for scenario in scenarios]
    assert budgets[0] == 1_000 <= budgets[1] < budgets[2] <= 20_000
    near = from_floor_plan(tmp_path / "2.json", like=get_scenario("short-sighted"))
    assert near.sensor == SCENARIOS["office"].sensor and near.budget > 1.5 * budgets[2]
    same = ExploreEnv(floor_plan=tmp_path / "2.json", overrides={"beams.range": near.beams.range}).scenario
    assert same.budget == near.budget, "the budget is that of the robot with its overrides"
    quality = drive(scenarios[0], 5)
    assert quality["map_error"] < 0.9 and quality["coverage"] > 0.3


def test_a_real_floor_can_be_driven_and_mapped(data_dir) -> None:
    quality = drive(from_floor_plan(data_dir / "kth_floorplans" / "50052750_occ_map.npy.gz", resolution=0.1), 6)
    assert quality["features"] > 20 and quality["precision"] > 0.8
    assert 0.0 < quality["coverage"] < 1.0 and quality["map_error"] < 1.0


def square(side: float) -> FloorPlan:
    return FloorPlan("square", rectangle(0.0, 0.0, side, side), NO_FEATURES)


@pytest.mark.parametrize("side", [25.0, 60.0])
def test_the_budget_follows_the_area_that_can_be_reached(side) -> None:
    building, short_sighted = SCENARIOS["building"], SCENARIOS["short-sighted"]
    budget = floor_budget(square(side), building)
    assert budget == pytest.approx(3.0 * (side - 0.4) ** 2, rel=0.03)
    assert floor_budget(square(side), short_sighted) == pytest.approx(budget * (2.0 + 20.0 / 6.0) / 3.0, rel=0.001)
    walled_in = np.concatenate([square(side).walls, [[0.0, side / 4, side, side / 4]]])
    assert floor_budget(FloorPlan("cut", walled_in, NO_FEATURES), building) == pytest.approx(0.75 * budget, rel=0.05)


def test_each_level_loses_more_of_its_way_than_the_one_before() -> None:
    scenario = get_scenario("office")
    site = survey(scenario.generator(np.random.default_rng(0)), scenario)
    way = Motion(moved=np.array([0.1, 0.0, 0.05]), wheels=np.array([0.1, 0.0, 0.05]), contact=False)
    lost = []
    for wheels in (OdometrySpec(), *scenarios.DRIFT.values()):
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
    centres = np.array([room.polygon.mean(axis=0) for room in plan.rooms])
    gaps = np.hypot(*(centres[:, None] - centres[None]).T)
    assert gaps[~np.eye(4, dtype=bool)].min() > scenario.sensor.range
    assert not seen_from(survey(plan, scenario).index, centres[:1], centres[1:], np.zeros(3), np.inf, NOTHING).any()


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("victoria_park", scenarios.VICTORIA_PARK),
        ("mrclam/MRCLAM_Dataset6/robot3", scenarios.MRCLAM),
        ("mine", scenarios.LOG_SETTINGS),
        ("mine/mrclam", scenarios.LOG_SETTINGS),
    ],
)
def test_the_first_part_of_the_name_decides(name, settings) -> None:
    assert scenarios.slam_for(replace(Recording(**by_hand()), name=name)) == settings


# --- the levels of the association suite: frozen settings, each sweep turning one knob --------------------------------


def test_every_level_is_found_by_its_id_and_frozen_to_the_bottom():
    for level in (level for experiment in EXPERIMENTS.values() for level in experiment.levels):
        assert get_level(level.id) is level and level.scenario.name == level.id
        assert get_scenario(level.id) is level.scenario
        assert_frozen(level)


def test_a_sweep_turns_one_knob_and_nothing_else():
    for name, experiment in EXPERIMENTS.items():
        knobs = [level.knob for level in experiment.levels]
        assert len(set(knobs)) == len(knobs) >= 3 and knobs in (sorted(knobs), sorted(knobs, reverse=True))
        assert [level.number for level in experiment.levels] == list(range(len(knobs)))
        assert {level.experiment for level in experiment.levels} == {name}
    blind = {name: {level.blind for level in EXPERIMENTS[name].levels} for name in EXPERIMENTS}
    assert all((len(found) > 1) == (name in ("closure", "drift")) for name, found in blind.items())


@pytest.mark.parametrize(
    ("id", "said"),
    [
        ("closures/1", r"experiment='closures'; did you mean 'closure'\? known: closure, drift"),
        ("closure", "'closure': expected closure/0 … closure/4"),
        ("closure/5", "expected closure/0 … closure/4"),
        ("closure/-1", "expected closure/0"),
        ("closure/1/2", "expected closure/0"),
    ],
)
def test_an_id_that_is_none_is_refused_with_those_that_are(id, said):
    for find in (get_level, ExploreEnv, AssociateEnv) if id.startswith("closure/") else (get_level,):
        with pytest.raises(ValueError, match=said):
            find(id)
