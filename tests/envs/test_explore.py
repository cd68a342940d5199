"""`Explore-v0`: worlds, what is handed out, masked goals, the end of the budget; and no truth in sight."""

from dataclasses import replace

import numpy as np
import pytest

from slam_gym.association import gcbb
from slam_gym.scenarios import get_scenario, world_generator
from slam_gym.simulation.goals import LOOK, SLOTS
from slam_gym.types import Truth
from slam_gym.world.floor_plan import Door, Features, FloorPlan, Room
from slam_gym.world.floor_plan_file import save_floor_plan
from slam_gym.world.generators import OfficeGenerator
from slam_gym.world.sensor import Sensor
from tests.rollouts import SCENARIOS, differences, episode, explore, short

INFO = ["map_error", "coverage", "pairings_right", "pairings_wrong", "pairings_missed", "pose_nees", "ticks", "pose"]
INFO += ["lost", "missed_loop", "truth"]


def test_world_option_takes_the_world_and_the_seed_the_rest() -> None:
    env = explore("office-small")
    plans = []
    for seed, world in ((0, 5), (1, 5), (0, 6)):
        env.reset(seed=seed, options={"world": world})
        plans.append((env.episode.site.plan.walls, env.episode.base))
    np.testing.assert_array_equal(plans[0][0], plans[1][0])
    assert not np.array_equal(plans[0][1], plans[1][1])
    assert plans[0][0].shape != plans[2][0].shape or not np.array_equal(plans[0][0], plans[2][0])
    drawn = env.scenario.generator(world_generator("train", 6))
    np.testing.assert_array_equal(plans[2][0], drawn.walls)


@pytest.mark.parametrize("action", ["goal", "twist"])
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_observations_are_inside_their_space_and_info_has_fixed_keys(scenario, action) -> None:
    env = explore(scenario, action=action)
    for observation, _, terminated, _, info in episode(env, 12 if action == "goal" else 150, 1, {"world": 2}):
        assert env.observation_space.contains(observation)
        assert all(np.isfinite(part).all() for part in observation.values())
        extra = ["action_mask"] * (action == "goal") + ["map_quality"] * terminated
        assert list(info) == INFO + extra and list(info["truth"]) == ["pose", "sources"]
        assert info["truth"]["sources"].shape == (env.scenario.sensor.max_features,)
        numbers = [info[name] for name in INFO[:-1]]
        assert all(np.isfinite(number).all() for number in numbers) and 0.0 <= info["coverage"] <= 1.0
        assert action == "goal" or info["ticks"] <= 1


def test_info_sums_up_to_the_tally_and_the_ticks() -> None:
    env = explore(short(120, "drift-2"), associator="nearest_neighbour", atlas=False)
    infos = [info for *_, info in episode(env)]
    tally = env.episode.identities.total
    assert min(tally.fp_wrong, tally.fp_spurious, tally.fp_duplicate) > 0
    assert sum(info["pairings_right"] for info in infos) == tally.tp > 100
    assert sum(info["pairings_wrong"] for info in infos) == tally.fp
    assert sum(info["pairings_missed"] for info in infos) == tally.fn
    assert sum(info["ticks"] for info in infos) == 120 == infos[-1]["map_quality"]["ticks"]
    assert infos[-1]["map_quality"] == env.map_quality()


@pytest.mark.parametrize("associator", ["jcbb", "nearest_neighbour", "singles"])
@pytest.mark.parametrize(("action", "steps"), [("goal", 6), ("twist", 80)])
def test_a_lying_truth_changes_no_observation_and_no_reward(associator, action, steps, monkeypatch) -> None:
    env = explore("office", action=action, associator=associator, reward="a_opt", locality="covisibility")
    honest = list(episode(env, steps, seed=2))
    honest_scan = Sensor.scan

    def lie(self, *args):
        scan, truth = honest_scan(self, *args)
        names = np.random.default_rng(0).permutation(1 + len(self._kinds)) - 1  # of SPURIOUS, too
        return scan, Truth(truth.pose + np.array([3.0, -2.0, 1.0]), names[truth.sources + 1])

    monkeypatch.setattr(Sensor, "scan", lie)
    lied_to = list(episode(env, steps, seed=2))
    for one, other in zip(honest, lied_to, strict=True):
        assert not differences(one[:4], other[:4])
        np.testing.assert_array_equal(one[4]["pose"], other[4]["pose"])
        assert not np.array_equal(one[4]["truth"]["pose"], other[4]["truth"]["pose"])
    assert lied_to[1][4]["pose_nees"] > 100.0 * honest[1][4]["pose_nees"]  # it did reach those whom it should


def moved(plan: FloorPlan, by: np.ndarray) -> FloorPlan:
    """The same floor elsewhere in W."""
    features, far = plan.features, np.array([*by, 0.0, 0.0, 0.0])
    return FloorPlan(
        plan.name,
        plan.walls + np.tile(by, 2),
        Features(features.positions + by, features.kinds, features.sizes),
        tuple(Room(room.name, room.polygon + by) for room in plan.rooms),
        tuple(Door(door.position + by, door.width, door.rooms) for door in plan.doors),
        plan.furniture + far,
    )


@pytest.mark.parametrize(("action", "steps"), [("goal", 4), ("twist", 80)])
def test_where_the_building_stands_in_the_world_is_nowhere_to_be_seen(action, steps) -> None:
    office = get_scenario("crowd")
    elsewhere = replace(office, generator=lambda rng: moved(office.generator(rng), np.array([64.0, -32.0])))
    env, twin = (explore(scenario, action=action, reward="d_opt") for scenario in (office, elsewhere))
    for one, other in zip(episode(env, steps, seed=1), episode(twin, steps, seed=1), strict=True):
        for name in one[0]:
            np.testing.assert_allclose(one[0][name].astype(float), other[0][name], rtol=0.0, atol=1e-5, err_msg=name)
        assert one[1] == pytest.approx(other[1], abs=1e-9)
        np.testing.assert_allclose(one[4]["pose"], other[4]["pose"], atol=1e-9)
        apart = other[4]["truth"]["pose"] - one[4]["truth"]["pose"]
        np.testing.assert_allclose(apart, [64.0, -32.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("action", ["goal", "twist"])
def test_spending_the_budget_terminates_and_is_seen_coming(action) -> None:
    env, ticks = explore(short(70), action=action), 0
    for observation, _, terminated, truncated, info in episode(env):
        ticks += info["ticks"]
        assert not truncated and terminated == (ticks == 70)
        assert observation["budget"] == np.float32(1.0 - ticks / 70)
        assert ("map_quality" in info) == terminated
    assert terminated and observation["budget"] == 0.0


def test_a_masked_goal_looks_around() -> None:
    env, twin = explore(), explore()
    _, info = env.reset(seed=4)
    twin.reset(seed=4)
    masked = int(np.flatnonzero(~info["action_mask"])[0])
    assert not differences(env.step(masked), twin.step(LOOK))


def test_masks_agree_with_the_goals_shown_and_looking_around_is_always_legal() -> None:
    env, seen = explore(short(150, "office")), np.zeros(SLOTS, bool)
    for observation, *_, info in episode(env):
        mask = info["action_mask"]
        assert mask[LOOK]
        np.testing.assert_array_equal(mask, observation["goals"].reshape(SLOTS, -1)[:, 0] == 1.0)
        seen |= mask
    assert seen[1:11].any() and seen[11:].any()
    with pytest.raises(AttributeError, match="goal mode"):
        explore(action="twist").action_masks()


def test_settings_of_slam_are_those_of_the_scenario() -> None:
    env = explore(overrides={"slam.reach": 3.0, "slam.locality": False})
    env.reset(seed=0)
    assert env.episode.slam.spec.reach == 3.0 and not env.episode.slam.spec.locality


def test_a_lost_robot_is_searched_for_in_the_locality_asked_for() -> None:
    asked = []

    def search(scan, landmarks, locality):
        asked.append(locality)
        return gcbb(scan, landmarks, locality)

    for kind in ("distance", None):
        env = explore(relocation=search, relocation_locality=kind)
        env.reset(seed=0)
        env.relocate(env.episode.scan, env.episode.slam.map, env.episode.slam.covisibility, 0.5, None)
    assert asked[0] is not None and asked[-1] is None


def test_a_given_floor_plan_is_surveyed_once(tmp_path) -> None:
    plan = OfficeGenerator(rooms=2)(np.random.default_rng(1))
    save_floor_plan(plan, tmp_path / "two.json")
    env = explore(floor_plan=str(tmp_path / "two.json"))
    env.reset(seed=0)
    site = env.episode.site
    env.reset(seed=1)
    assert env.episode.site is site and env.scenario.name == plan.name
    np.testing.assert_array_equal(site.plan.walls, plan.walls)
