"""Scenarios by name, those that users add, and floor plans from files."""

from dataclasses import replace

import numpy as np
import pytest

from slam_gym.envs.explore import ExploreEnv
from slam_gym.scenarios import SCENARIOS, SPLITS, Scenario, from_floor_plan, get_scenario, register, world_seed
from slam_gym.simulation.episode import survey
from slam_gym.world.floor_plan_file import save_floor_plan
from slam_gym.world.generators import OfficeGenerator
from tests.scenarios.test_scenario import assert_frozen


def test_the_known_scenarios_are_found_by_name() -> None:
    assert list(SCENARIOS)[:6] == ["office-small", "office", "aliased", "hall", "crowd", "kidnapped"]
    for name, scenario in SCENARIOS.items():
        assert get_scenario(name) is scenario and scenario.name == name
    with pytest.raises(ValueError, match=r"'offices'; did you mean 'office'\? known: office-small, office, aliased"):
        get_scenario("offices")


@pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=SCENARIOS)
def test_scenarios_are_frozen_to_the_bottom(scenario) -> None:
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
    monkeypatch.setattr("slam_gym.scenarios.registry.SCENARIOS", dict(SCENARIOS))
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "my_halls.py").write_text(
        "from dataclasses import replace\nfrom slam_gym.scenarios import get_scenario, register\n"
        "BUSY = replace(get_scenario('hall'), name='busy-hall', budget=30)\nregister(BUSY)\nDOORS = 3\n"
    )
    assert get_scenario("my_halls:busy-hall") is get_scenario("my_halls:BUSY")
    assert ExploreEnv("my_halls:busy-hall").scenario.budget == 30
    for name, message in (
        ("my_halls:DOORS", "is of type int, not a Scenario"),
        ("my_halls:calm-hall", "known: office-small"),
        ("no_halls:BUSY", "No module named 'no_halls'; known: office-small"),
    ):
        with pytest.raises(ValueError, match=message):
            get_scenario(name)


@pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=SCENARIOS)
@pytest.mark.parametrize("split", SPLITS)
def test_worlds_are_reproducible_differ_and_can_be_explored(scenario, split) -> None:
    drawn = []
    for index in (0, 1, SPLITS[split][1] - 1):
        first, again = (scenario.generator(np.random.default_rng(world_seed(split, index))) for _ in range(2))
        np.testing.assert_array_equal(first.walls, again.walls)
        np.testing.assert_array_equal(first.features.positions, again.features.positions)
        assert all(p.walls.shape != first.walls.shape or not np.array_equal(p.walls, first.walls) for p in drawn)
        drawn.append(first)
        site = survey(first, scenario)
        assert len(site.cells) > 100 and 20 <= site.observable.sum() <= len(first.features)


def drive(scenario: Scenario, steps: int) -> dict[str, float]:
    env = ExploreEnv(scenario)
    _, info = env.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(steps):
        _, _, over, _, info = env.step(int(rng.choice(np.flatnonzero(info["action_mask"]))))
        if over:
            break
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
    quality = drive(scenarios[0], 5)
    assert quality["map_error"] < 0.9 and quality["coverage"] > 0.3


def test_files_that_are_no_floor_plans_are_refused_by_name(tmp_path) -> None:
    with pytest.raises(FileNotFoundError, match=r"missing\.json"):
        from_floor_plan(tmp_path / "missing.json")
    (tmp_path / "bad.json").write_text('{"walls": [[0, 0, 1, NaN]]}')
    with pytest.raises(ValueError, match=r"bad\.json"):
        from_floor_plan(tmp_path / "bad.json")
    np.save(tmp_path / "image.npy", np.full((50, 50), 254, np.uint8))
    with pytest.raises(ValueError, match=r"image\.npy.*resolution"):
        from_floor_plan(tmp_path / "image.npy")


@pytest.mark.parametrize("file", ["kth_floorplans/50052750_occ_map.npy.gz", "willow_garage/willow-full.pgm"])
def test_real_floors_can_be_driven_and_mapped(data_dir, file) -> None:
    quality = drive(from_floor_plan(data_dir / file, resolution=0.1), 20)
    assert quality["features"] > 20 and quality["precision"] > 0.8
    assert 0.0 < quality["coverage"] < 1.0 and quality["map_error"] < 1.0
