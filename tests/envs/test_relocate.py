"""`Relocate-v0`: arguments, who judges an answer, searches and policies through it, what is handed out, its floors."""

from dataclasses import replace

import numpy as np
import pytest

from slam_gym.association import gcbb
from slam_gym.association.policy import relocator_from_policy
from slam_gym.association.relocation.walk import CANDIDATE_FIELDS, MEASUREMENT_FIELDS
from slam_gym.envs import relocate as module
from slam_gym.envs.relocate import RelocateEnv
from slam_gym.scenarios import from_floor_plan, get_scenario
from slam_gym.simulation.judged import NOT_OFFERED
from slam_gym.simulation.relocation_problems import kidnap
from slam_gym.world.floor_plan_file import save_floor_plan
from slam_gym.world.generators import OfficeGenerator
from tests.oracles.relocation_walks import by_chance
from tests.rollouts import at_random, bare, differences, episode, relocate, short

INFO = ["nodes", "tries", "hidden", "pairings", "needed", "accepted", "action_mask", "truth"]


def by(policy):
    return lambda env, observation, info: policy(observation, info["action_mask"])


def refuse(env, observation, info):
    return len(info["action_mask"]) - 2


def by_truth(env, observation, info):
    action = info["truth"]["action"]
    return refuse(env, observation, info) if action == NOT_OFFERED else action


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"locality": "near"}, "two-hop covisibility"),
        ({"candidates": 0}, "candidates"),
        ({"order": "any"}, "fewest_candidates"),
        ({"node_limit": 0}, "node_limit"),
        ({"outside": 1.5}, "outside=1.5"),
        ({"outside": float("nan")}, "outside=nan"),
        ({"kidnappings_per_map": 0}, "kidnappings_per_map: expected a whole number"),
        ({"associator": "me"}, "jcbb"),
        ({"overrides": {"associator": "me"}}, "jcbb"),
        ({"node_cost": -1.0}, "node_cost=-1"),
        ({"wrong_cost": float("inf")}, "wrong_cost=inf"),
        ({"position_tolerance": -0.1}, "position_tolerance"),
        ({"heading_tolerance": float("nan")}, "heading_tolerance"),
    ],
)
def test_bad_arguments_are_refused_by_name(options, message):
    with pytest.raises(ValueError, match=message):
        RelocateEnv(**options)


def test_the_robot_is_outside_as_often_as_asked_for():
    env = relocate(outside=0.4, kidnappings_per_map=200)
    env.reset(seed=1)
    inside = [env.reset()[1]["truth"]["inside"] for _ in range(199)]
    assert 0.5 < np.mean(inside) < 0.7


def test_the_truth_played_is_right_inside_and_refusing_is_right_outside():
    env = relocate(get_scenario("office-small"), outside=0.5, candidates=200, node_cost=0.01, sizes=False)
    env.reset(seed=0)
    seen = {True: [], False: []}
    for _ in range(40):
        steps = list(episode(env, choose=by_truth, seed=None))
        info = steps[-1][4]
        seen[info["truth"]["inside"]].append(info["score"]["right"])
        total = info["score"]["right"] - 0.01 * (info["nodes"] - steps[0][4]["nodes"])
        assert sum(step[1] for step in steps) == pytest.approx(total) and not info["score"]["wrong"]
    assert np.mean(seen[False]) == 1.0 and np.mean(seen[True]) > 0.7 and min(map(len, seen.values())) > 8


def test_an_answer_is_judged_by_its_pose_and_by_the_tolerances():
    options = dict(outside=0.0, candidates=200, node_cost=0.0, wrong_cost=3.0)
    env = relocate(get_scenario("office-small"), **options)
    strict, believed = relocate(get_scenario("office-small"), position_tolerance=0.0, **options), 0
    for seed in range(6):
        *_, last = episode(env, choose=by_truth, seed=seed)
        *_, judged = episode(strict, choose=by_truth, seed=seed)
        if last[4]["accepted"]:
            believed += 1
            assert (last[1], judged[1]) == (1.0, -3.0) and judged[4]["score"]["wrong"] == 1
        else:
            assert (last[1], judged[1]) == (0.0, 0.0)
        *_, none = episode(env, choose=refuse, seed=seed)
        assert none[1] == 0.0 and none[4]["score"] == {"right": 0, "wrong": 0, "nodes": none[4]["nodes"]}
    assert believed >= 4


@pytest.mark.parametrize(
    ("name", "locality"),
    [
        ("office-small", "covisibility"),
        ("office-small", "two-hop covisibility"),
        ("office-small", None),
        ("aliased", "distance"),
    ],
)
def test_what_gcbb_finds_can_be_played_and_comes_to_the_same(name, locality):
    env = relocate(short(250, name), candidates=500, order="as_scanned", locality=locality, kidnappings_per_map=8)
    env.reset(seed=2)
    for _ in range(8):
        env.reset()
        expected = gcbb(env.kidnapped.scan, env.mapped.landmarks, env.mapped.locality(locality))
        over = False
        while not over:
            action = env.action_of(expected.features)
            assert action is not None
            over = env.step(action)[2]
        found = env.walk.answer()
        np.testing.assert_array_equal(found.features, expected.features)
        np.testing.assert_allclose(found.pose, expected.pose, atol=1e-9)
        np.testing.assert_allclose(found.covariance, expected.covariance, atol=1e-12)
        assert found.effort.nodes == 1 + len(env.kidnapped.scan) and found.effort.tries == 1
        assert found.joint_distance == pytest.approx(expected.joint_distance)
        assert found.min_pairings == expected.min_pairings


def test_a_policy_sees_as_a_relocator_what_it_sees_in_the_environment():
    env, seen, shown = relocate(short(250), order="nearest_first", sizes=False), [], []
    for observation, *_ in episode(env, choose=by(by_chance), seed=4):
        seen.append(observation)

    def policy(observation, mask):
        shown.append(observation)
        return by_chance(observation, mask)

    find = relocator_from_policy(policy, order="nearest_first", sizes=False)
    found = find(env.kidnapped.scan, env.mapped.landmarks, env.mapped.locality("covisibility"))
    assert not differences(shown, seen[:-1])  # the last is that of an episode that is over
    np.testing.assert_array_equal(found.features, env.walk.answer().features)


def test_a_world_asked_for_does_not_depend_on_what_was_mapped_before_nor_disturb_the_series():
    env, twin = relocate(kidnappings_per_map=4), relocate(kidnappings_per_map=4)
    for world in range(5):  # more than are kept
        env.reset(seed=0, options={"world": world})
    for world in (0, 4):
        start = env.reset(seed=world, options={"world": world})
        assert not differences(start, relocate().reset(seed=world, options={"world": world}))
    env.reset(seed=1)
    twin.reset(seed=1)
    env.reset(options={"world": 12})
    env.reset()
    twin.reset()
    assert env.mapped.site.plan.walls.shape == twin.mapped.site.plan.walls.shape
    np.testing.assert_array_equal(env.mapped.landmarks.positions, twin.mapped.landmarks.positions)


@pytest.mark.parametrize(
    "options",
    [
        dict(scenario=short(150, "hall"), split="test", locality="two-hop covisibility", sizes=False),
        dict(scenario=short(150, "aliased"), locality="distance", order="nearest_first", candidates=1, outside=1.0),
        dict(scenario=short(150, "crowd"), locality=None, candidates=200, outside=0.0, node_limit=7),
    ],
)
def test_info_has_fixed_keys_and_agrees_with_the_observation(options):
    env = relocate(**options)
    env.reset(seed=1)
    for _ in range(5):
        for observation, _, terminated, _, info in episode(env, choose=at_random(0), seed=None):
            assert env.observation_space.contains(observation)
            assert list(info) == INFO + ["score"] * terminated
            assert list(info["truth"]) == ["inside", "pose", "features", "action"]
            mask = info["action_mask"]
            assert mask[-2]
            rows = observation["candidates"].reshape(-1, len(CANDIDATE_FIELDS))
            np.testing.assert_array_equal(rows[:, 0] == 1.0, mask[:-2])
            hidden = observation["measurement"][MEASUREMENT_FIELDS.index("hidden")]
            assert (hidden > 0.0) == (info["hidden"] > 0)
            assert info["nodes"] <= env.walk_spec.node_limit
        assert terminated


def test_on_a_floor_plan_robots_are_carried_to_that_floor_or_to_a_world_of_the_scenario(tmp_path):
    path, plan = tmp_path / "two.json", OfficeGenerator(rooms=2)(np.random.default_rng(1))
    save_floor_plan(plan, path)
    env = relocate("office-small", floor_plan=str(path), overrides={"budget": 60}, outside=0.5)
    found = set()
    for seed in range(8):
        _, info = env.reset(seed=seed, options={"world": 0})
        found.add(info["truth"]["inside"])
        np.testing.assert_array_equal(env.mapped.site.plan.walls, plan.walls)
    assert found == {True, False} and len(env.mapped.elsewhere.plan.rooms) > len(plan.rooms)
    assert bare("Relocate-v0", floor_plan=path).scenario.sensor == get_scenario("building").sensor
    only = replace(get_scenario("office-small"), generator=from_floor_plan(path).generator)
    with pytest.raises(ValueError, match=r"outside=0\.5: the scenario has one world only"):
        relocate(only, overrides={"budget": 60}, outside=0.5).reset(seed=0)
    relocate("density/0", overrides={"budget": 60}, outside=1.0).reset(seed=0)  # other posts within the same walls
    with pytest.raises(ValueError, match=r"resolution=0\.1 goes with a floor_plan"):
        relocate(resolution=0.1)


def test_a_lying_truth_changes_no_observation_and_no_mask(monkeypatch):
    env = relocate(short(250), outside=0.0)
    honest = list(episode(env, choose=by(by_chance), seed=2))

    def lie(*args):
        drawn = kidnap(*args)
        return replace(drawn, pose=drawn.pose + 5.0, features=drawn.features[::-1].copy(), inside=False)

    monkeypatch.setattr(module, "kidnap", lie)
    lied_to = list(episode(env, choose=by(by_chance), seed=2))
    for one, other in zip(honest, lied_to, strict=True):
        assert not differences(one[0], other[0])
        assert not differences({k: one[4][k] for k in INFO[:-1]}, {k: other[4][k] for k in INFO[:-1]})
    assert differences(honest[0][4]["truth"], lied_to[0][4]["truth"])
