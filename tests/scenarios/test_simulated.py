"""Named scenarios, their seeds, and floor plans from files."""

from dataclasses import FrozenInstanceError, fields, is_dataclass, replace

import numpy as np
import pytest

from slam_gym.envs.explore import ExploreEnv
from slam_gym.scenarios import SCENARIOS, SPLITS, Scenario, from_floor_plan, get_scenario, world_seed
from slam_gym.simulation.episode import survey
from slam_gym.world.floor_plan import save_floor_plan
from slam_gym.world.generators import OfficeGenerator


def test_the_known_scenarios_are_found_by_name() -> None:
    assert list(SCENARIOS) == ["office-small", "office", "aliased", "hall", "crowd", "kidnapped"]
    for name, scenario in SCENARIOS.items():
        assert get_scenario(name) is scenario and scenario.name == name
    with pytest.raises(ValueError, match=r"'offices'; known: office-small, office, aliased, hall, crowd, kidnapped"):
        get_scenario("offices")


@pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=SCENARIOS)
def test_scenarios_are_frozen_to_the_bottom(scenario) -> None:
    def freeze_check(record) -> None:
        for field in fields(record):
            with pytest.raises(FrozenInstanceError):
                setattr(record, field.name, None)
            if is_dataclass(getattr(record, field.name)):
                freeze_check(getattr(record, field.name))

    freeze_check(scenario)
    hash(scenario)  # all of it is immutable


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


def test_train_and_test_seeds_never_overlap() -> None:
    ranges = [range(first, first + count) for first, count in SPLITS.values()]
    assert set(SPLITS) == {"train", "test"} and all(len(r) >= 10_000 for r in ranges)
    assert ranges[0].stop <= ranges[1].start or ranges[1].stop <= ranges[0].start
    ends = {split: (world_seed(split, 0), world_seed(split, count - 1)) for split, (_, count) in SPLITS.items()}
    for split, reach in zip(SPLITS, ranges):
        assert ends[split] == (reach.start, reach.stop - 1)
    for index in (-1, SPLITS["test"][1], 1.5, float("nan")):
        with pytest.raises(ValueError, match=r"of split 'test': expected a whole number 0 … 9999"):
            world_seed("test", index)
    with pytest.raises(ValueError, match=r"unknown split 'validation'; known: train, test"):
        world_seed("validation", 0)


def test_whatever_reset_draws_belongs_to_its_split(monkeypatch) -> None:
    drawn: dict[str, set[int]] = {}
    for split, (first, count) in SPLITS.items():
        env = ExploreEnv("office-small", split=split, action="twist")
        seen = drawn.setdefault(split, set())
        monkeypatch.setattr(env, "_draw_site", _record(env._draw_site, split, seen))
        for seed in range(20):
            env.reset(seed=seed)
        assert len(seen) == 20 and all(first <= world < first + count for world in seen)
    assert not drawn["train"] & drawn["test"]


def _record(draw, split: str, seen: set[int]):
    def draw_and_record(world: int):
        seen.add(world_seed(split, world))
        return draw(world)

    return draw_and_record


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"budget": 0}, "budget"),
        ({"budget": 1.5}, "budget"),
        ({"prior_sigma": 0.0}, "prior_sigma"),
        ({"prior_sigma": float("nan")}, "prior_sigma"),
        ({"grid_resolution": -0.1}, "grid_resolution"),
    ],
)
def test_a_scenario_that_cannot_be_is_refused_by_field(changes, field) -> None:
    with pytest.raises(ValueError, match=f"Scenario.{field}"):
        replace(get_scenario("hall"), **changes)


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
    budgets = [scenario.budget for scenario in scenarios]
    assert budgets[0] == 1_000 <= budgets[1] < budgets[2] <= 20_000
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
