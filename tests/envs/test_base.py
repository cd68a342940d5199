"""What holds of every environment: checkers, resets, refusals, twins, snapshots, copies, vectors, pictures, windows."""

import copy
import pickle
import warnings
from itertools import pairwise

import gymnasium as gym
import numpy as np
import pygame
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_sb3

from slam_gym.association import jcbb, nearest_neighbour
from slam_gym.envs.explore import ExploreEnv
from slam_gym.recordings import save
from slam_gym.scenarios import SPLITS, get_scenario, overridden
from slam_gym.simulation.association_runs import CORRIDOR, nearest_frontier
from slam_gym.world.floor_plan_file import save_floor_plan
from slam_gym.world.generators import OfficeGenerator
from tests.recordings import drive
from tests.rollouts import bare, differences, episode, random_action, short

SMALL = short(120)  # a map for Relocate-v0 that is made soon
CASES = {  # every environment, in every way that differs inside
    "explore, goals": ("Explore-v0", dict(scenario=short(150), reward="entropy")),
    "explore, twists": ("Explore-v0", dict(scenario=short(12, "crowd"), action="twist", reward="d_opt")),
    "associate": ("Associate-v0", dict(scenario=short(8), reward="map_error", driver="random")),
    "associate, log": ("Associate-v0", dict(scenario="corridor", candidates=3)),
    "relocate": ("Relocate-v0", dict(scenario=SMALL, kidnappings_per_map=2, node_limit=12)),
}
every_case = pytest.mark.parametrize("case", CASES)
ENVIRONMENTS = ("Explore-v0", "Associate-v0", "Relocate-v0")
every_environment = pytest.mark.parametrize("name", ENVIRONMENTS)


def made(case, **options):
    name, given = CASES[case]
    return bare(name, **given | options)


def small(name, **options):
    """An environment whose resets are quick."""
    return bare(name, **{"scenario": SMALL if name == "Relocate-v0" else short(12)} | options)


# -- checkers ------------------------------------------------------------------------------------------------------

OPTIONS = [  # every value of every option at least once
    ("Explore-v0", dict(scenario="office-small", action="goal", reward="map_error", associator="jcbb", split="train")),
    ("Explore-v0", dict(scenario="aliased", reward="d_opt", associator="singles", locality=None)),
    ("Explore-v0", dict(scenario="crowd", reward="entropy", associator="slam_gym.association:nearest_neighbour")),
    ("Explore-v0", dict(scenario="closure/0", action="twist", associator=jcbb, overrides={"sensor.range": 4.0},
                        locality="covisibility", render_mode="human")),
    ("Explore-v0", dict(floor_plan="plan.json", action="twist", reward="a_opt", associator="true_association",
                        split="test", render_mode="rgb_array", render_covisibility=True)),
    ("Associate-v0", dict(scenario=short(30, "hall"), split="train", driver=nearest_frontier, reward="truth",
                          candidates=5, render_mode="human")),
    ("Associate-v0", dict(split="test", driver="random", reward="map_error", candidates=1, order="nearest_first")),
    ("Associate-v0", dict(scenario=CORRIDOR, split="test", order="fewest_candidates", compatibility="individual",
                          wrong_cost=1.0, render_mode="rgb_array")),
    ("Associate-v0", dict(scenario=short(1), driver="nearest_frontier", compatibility="joint",
                          overrides={"dynamics.people": 1})),
    ("Associate-v0", dict(scenario="recording:arc.npz?looks=12&every=2", split="test", reward="map_error",
                          render_mode="rgb_array")),
    ("Relocate-v0", dict(split="train", locality="covisibility", order="fewest_candidates", heading_tolerance=0.3,
                         associator="true_association", kidnappings_per_map=1, node_cost=0.5)),
    ("Relocate-v0", dict(split="test", locality="two-hop covisibility", sizes=False, associator=jcbb, wrong_cost=5.0,
                         overrides={"sensor.clutter": 1.0}, render_mode="human")),
    ("Relocate-v0", dict(locality="distance", order="nearest_first", candidates=1, outside=1.0, node_limit=1)),
    ("Relocate-v0", dict(locality=None, order="as_scanned", candidates=200, outside=0.0, position_tolerance=1.0,
                         render_mode="rgb_array")),
]  # fmt: skip


@pytest.mark.parametrize(("name", "options"), OPTIONS, ids=[f"{name}-{k}" for k, (name, _) in enumerate(OPTIONS)])
def test_the_checkers_of_gymnasium_and_sb3_find_nothing_to_warn_of(name, options, tmp_path, monkeypatch) -> None:
    if name == "Relocate-v0":
        options = {"scenario": SMALL} | options
    monkeypatch.chdir(tmp_path)
    save_floor_plan(OfficeGenerator(rooms=2)(np.random.default_rng(0)), "plan.json")
    save(drive(), "arc.npz")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gym.make(f"slam_gym/{name}", **options).unwrapped)  # with all render modes
        check_env_sb3(gym.make(f"slam_gym/{name}", **options))


# -- refusals ------------------------------------------------------------------------------------------------------


@every_environment
def test_nothing_works_before_the_first_reset_and_says_so(name) -> None:
    env = small(name, render_mode="rgb_array")
    for use in (lambda: env.step(0), env.render, env.snapshot, env.action_masks):
        with pytest.raises(RuntimeError, match=r"call reset\(\) first"):
            use()
    env.close()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"wrold": 3}, "unknown reset option 'wrold'; known: world"),
        ({"world": -1}, "world -1 of split 'train': expected a whole number 0 … 999999"),
        ({"world": SPLITS["train"][1]}, "world 1000000 of split"),
        ({"world": 0.5}, "world 0.5 of split"),
        (["world"], r"options: expected a dict, got \['world'\]"),
    ],
)
@every_environment
def test_a_bad_reset_is_refused_and_the_episode_goes_on(name, options, message) -> None:
    env, twin = small(name), small(name)
    _, info = env.reset(seed=0)
    twin.reset(seed=0)
    with pytest.raises(ValueError, match=message):
        env.reset(seed=5, options=options)
    action = random_action(env, info, np.random.default_rng(0))
    assert not differences(env.step(action), twin.step(action))
    assert not differences(env.snapshot(), twin.snapshot())


@every_environment
def test_a_bad_action_is_refused_and_changes_nothing(name) -> None:
    env, twin = small(name), small(name)
    _, info = env.reset(seed=0)
    twin.reset(seed=0)
    for wrong in (-1, env.action_space.n, 1.5, np.nan, None, "look", [0, 1], np.array([3])):
        with pytest.raises(ValueError, match="action"):
            env.step(wrong)
    action = random_action(env, info, np.random.default_rng(1))
    assert not differences(env.step(np.array(action)), twin.step(action))  # any integer will do
    assert not differences(env.snapshot(), twin.snapshot())


@every_case
def test_what_is_handed_out_lies_in_its_space_until_the_episode_is_over_and_wants_a_reset(case) -> None:
    env = made(case)
    for observation, reward, terminated, truncated, info in episode(env):
        assert env.observation_space.contains(observation)
        assert all(np.isfinite(part).all() for part in observation.values())
        assert type(reward) is float and type(terminated) is bool and truncated is False
        if "action_mask" in info:
            assert info["action_mask"].dtype == np.bool_ and info["action_mask"].any()
            np.testing.assert_array_equal(info["action_mask"], env.action_masks())
    assert terminated
    with pytest.raises(RuntimeError, match=r"over: call reset\(\)"):
        env.step(env.action_space.sample())
    env.reset(seed=0)
    env.step(env.action_space.sample())


@every_environment
def test_bad_arguments_that_all_have_are_refused_by_name(name) -> None:
    for options, message in (
        ({"split": "validation"}, "split='validation'.*train, test"),
        ({"render_mode": "ansi"}, "render_mode='ansi'.*None, rgb_array, rgb_array_list, human"),
        ({"scenario": "atlantis"}, "office-small, office, aliased, hall, crowd, kidnapped"),
        ({"overrides": {"sensor.reach": 4.0}}, "'sensor.reach': there is no such field"),
        ({"overrides": {"sensor.range": "far"}}, "'sensor.range': expected"),
        ({"overrides": {"robot.radius": 0.02}}, "dynamics.substeps=2: .*pass through walls"),
    ):
        with pytest.raises(ValueError, match=message):
            small(name, **options)


# -- scenarios by name and plain values ----------------------------------------------------------------------------


@every_environment
def test_overrides_change_the_scenario_and_survive_json(name) -> None:
    overrides = {"sensor.range": 4.0, "odometry.turn_per_metre": 0.1, "dynamics.people": 3, "budget": 120}
    spec = gym.make(f"slam_gym/{name}", scenario="office-small", overrides=overrides).spec
    assert spec is not None and spec.kwargs["overrides"] == overrides
    env = gym.make(gym.envs.registration.EnvSpec.from_json(spec.to_json())).unwrapped
    assert env.scenario == overridden(get_scenario("office-small"), overrides)
    twin = bare(name, scenario=overridden(get_scenario("office-small"), overrides | {"budget": np.int64(120)}))
    for one, other in zip(episode(env, 4), episode(twin, 4), strict=True):
        assert not differences(one, other)


# -- same seed, same episode, bit for bit --------------------------------------------------------------------------


@every_case
def test_twins_are_equal_bit_for_bit_whatever_one_did_before(case) -> None:
    fresh, used = made(case), made(case)
    for seed in (3, None):
        used.reset(seed=seed)
        used.step(used.action_space.sample())
    for options in ({}, {"world": 9}):
        for seed in (8, None):  # that of the reset; the actions are the same
            rng = np.random.default_rng(0)
            one, other = fresh.reset(seed=seed, options=options), used.reset(seed=seed, options=options)
            for _ in range(12):
                assert not differences(one, other)
                if len(one) == 5 and one[2]:
                    break
                action = random_action(fresh, one[-1], rng)
                one, other = fresh.step(action), used.step(action)


@every_case
def test_the_agent_may_keep_and_scribble_on_all_that_it_is_given(case) -> None:
    def arrays(value):
        return [a for v in value.values() for a in arrays(v)] if isinstance(value, dict) else [np.asarray(value)]

    kept, env, twin = [], made(case), made(case)
    for one, other in zip(episode(env, 8), episode(twin, 8), strict=True):
        assert not differences(one, other)
        for array in [*one[0].values(), *arrays(one[4])]:
            assert not any(np.shares_memory(array, before) for before in kept)
            kept.append(array)
            if array.ndim and array.dtype != np.bool_:  # the next action is drawn from the mask
                array.fill(1)
        if "action_mask" in one[4]:
            before = env.action_masks()
            env.action_masks().fill(True)
            np.testing.assert_array_equal(env.action_masks(), before)


@every_case
def test_the_episodes_that_follow_a_seed_do_not_depend_on_what_is_done(case) -> None:
    idle, busy = made(case), made(case)
    idle.reset(seed=4)
    assert len(list(episode(busy, 6, seed=4))) > 1
    for _ in range(2):
        assert not differences(idle.reset(), busy.reset())


# -- snapshots and copies ------------------------------------------------------------------------------------------


def underway(case, steps=2):
    """An environment in the middle of its second episode, whose generator has a past; and the last step."""
    env, rng = made(case), np.random.default_rng(1)
    env.reset(seed=9)
    last = env.reset(options=None if case == "relocate" else {"world": 77})
    for _ in range(steps):
        last = env.step(random_action(env, last[-1], rng))
    assert not last[2]
    return env, last


def goes_on_alike(env, other, steps=24) -> None:
    """Both are driven on, over resets without a seed."""
    rng, over = np.random.default_rng(2), False
    info = {"action_mask": env.action_masks()} if isinstance(env.action_space, gym.spaces.Discrete) else {}
    for _ in range(steps):
        action = random_action(env, info, rng)
        one, another = (env.reset(), other.reset()) if over else (env.step(action), other.step(action))
        assert not differences(one, another)
        over, info = len(one) == 5 and one[2], one[-1]
    assert env.action_space.sample() is not None


@every_case
def test_a_snapshot_replays_bit_for_bit_in_the_same_and_in_another_env(case) -> None:
    env, last = underway(case)
    snapshot = pickle.loads(pickle.dumps(env.snapshot()))
    other = made(case)
    assert not differences(other.restore(snapshot), (last[0], last[-1]))
    assert not differences(other.snapshot(), snapshot)
    goes_on_alike(env, other)
    assert not differences(env.restore(snapshot), (last[0], last[-1]))


@pytest.mark.parametrize(
    "duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["copy", "pickle"]
)
@every_case
def test_environments_pickle_and_copy_while_they_run(case, duplicate) -> None:
    env, _ = underway(case)
    env.action_space.seed(5)
    env.np_random.random()  # somebody else draws from it, too
    twin = duplicate(env)
    assert twin is not env and type(twin) is type(env)
    assert not differences(twin.snapshot(), env.snapshot())
    np.testing.assert_array_equal(env.action_space.sample(), twin.action_space.sample())
    goes_on_alike(env, twin)


@pytest.mark.parametrize(
    ("name", "argument"), [("Explore-v0", "associator"), ("Associate-v0", "driver"), ("Relocate-v0", "associator")]
)
def test_where_an_argument_does_not_pickle_snapshots_do_and_copies_work(name, argument) -> None:
    given = nearest_frontier if argument == "driver" else jcbb
    env = small(name, **{argument: lambda *arguments: given(*arguments)})
    _, info = env.reset(seed=0)
    action = random_action(env, info, np.random.default_rng(0))
    with pytest.raises((pickle.PicklingError, AttributeError), match="lambda"):
        pickle.dumps(env)
    assert not differences(pickle.loads(pickle.dumps(env.snapshot())), env.snapshot())
    assert not differences(copy.deepcopy(env).step(action), env.step(action))
    untouched = small(name)
    untouched.np_random = np.random.default_rng(5)
    assert not differences(copy.deepcopy(untouched).reset(), untouched.reset())


# -- pictures ------------------------------------------------------------------------------------------------------


@every_case
def test_pictures_show_what_happens_and_change_nothing(case) -> None:
    env, blind, pictures = made(case, render_mode="rgb_array"), made(case), []
    for one, other in zip(episode(env, 5), episode(blind, 5), strict=True):
        assert not differences(one, other)
        pictures.append(env.render())
        pygame.quit()  # as others do that draw in the same process
    for picture in pictures:
        assert picture.dtype == np.uint8 and picture.ndim == 3 and picture.shape[2] == 3
        assert picture.std() > 10.0, "blank"
    assert all(not np.array_equal(a, b) for a, b in pairwise(pictures))
    np.testing.assert_array_equal(env.render(), pictures[-1])
    env.close()
    env.close()


@every_environment
def test_a_window_shows_every_change_and_closes_twice(name, monkeypatch) -> None:
    from slam_gym.rendering.canvas import Window

    shown, show = [], Window.show
    monkeypatch.setattr(Window, "show", lambda self, picture: (shown.append(picture), show(self, picture)))
    env = small(name, render_mode="human")
    env.reset(seed=0)
    assert len(shown) == 1
    env.step(env.action_space.sample(env.action_masks().astype(np.int8)))
    assert len(shown) >= 2
    for _ in range(2):
        assert env.render() is None and pygame.display.get_surface().get_size() == shown[-1].get_size()
        env.close()
        env.close()
        assert not pygame.display.get_init()
    other = small(name, render_mode="human")
    env.reset(seed=0), other.reset(seed=0), env.close()
    assert other.render() is None and pygame.display.get_init(), "another goes on"
    other.close()
    count = len(shown)
    copy.deepcopy(env)
    assert len(shown) == count, "a replay shows nothing"


def test_a_step_that_fails_is_not_done_and_the_way_back_is_open() -> None:
    calls = []

    def failing(scan, prediction):
        calls.append(len(scan))
        if len(calls) == 4:
            raise ZeroDivisionError("an associator's own mistake")
        return nearest_neighbour(scan, prediction)

    env = ExploreEnv("office-small", associator=failing, action="twist")
    ahead = np.array([0.5, 0.1], np.float32)
    env.reset(seed=3)
    for _ in range(2):
        observation, *_ = env.step(ahead)
    with pytest.raises(ZeroDivisionError, match="own mistake"):
        env.step(ahead)
    with pytest.raises(RuntimeError, match=r"failed half-way: call reset\(\), or restore\(snapshot\(\)\)"):
        env.step(ahead)
    assert len(env.snapshot().actions) == 2
    calls[:] = [0] * 4  # it fails no more
    twin = ExploreEnv("office-small", associator=failing, action="twist")
    twin.restore(env.snapshot())
    assert not differences(copy.deepcopy(env).step(ahead), twin.step(ahead))
    again, _ = env.restore(env.snapshot())
    assert all(np.array_equal(again[name], observation[name]) for name in observation)
    env.step(ahead)
    calls[:] = [0] * 3
    with pytest.raises(ZeroDivisionError):
        env.reset(seed=4)
    for same in (env, copy.deepcopy(env)):
        with pytest.raises(RuntimeError, match=r"call reset\(\)"):
            same.step(ahead)
    assert not differences(env.reset(), twin.reset(seed=4))  # the next reset tries again
    assert not differences(env.step(ahead), twin.step(ahead))
