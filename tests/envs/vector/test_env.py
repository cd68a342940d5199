"""Many worlds are the single environment, many times: bit for bit, in every mode, in this process and in others."""

from functools import partial
from itertools import pairwise
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import vector as wrappers

from slam_gym.association import nearest_neighbour
from slam_gym.envs.vector.worlds import WorldError
from tests.envs.test_base import CASES, ENVIRONMENTS, OPTIONS, SMALL
from tests.rollouts import bare, differences, in_any_process, short, vector_rollout

MODES = list(AutoresetMode)


def many(name, num_envs=2, workers=0, **options):
    """The environment `slam_gym/<name>`, many times."""
    return gym.make_vec(
        f"slam_gym/{name}", num_envs=num_envs, vectorization_mode="vector_entry_point", workers=workers, **options
    )


def small(name, **options):
    return many(name, **{"scenario": SMALL if name == "Relocate-v0" else short(12)} | options)


def legal(envs, rng):
    """A legal action for each world."""
    if isinstance(envs.single_action_space, gym.spaces.Discrete):
        return np.array([rng.choice(np.flatnonzero(mask)) for mask in envs.action_masks()])
    return rng.uniform(-1.0, 1.0, (envs.num_envs, 2)).astype(np.float32)


# -- bit for bit ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("case", CASES)
def test_worlds_are_those_of_gymnasium_s_own_vector_over_autoresets(case, mode) -> None:
    name, options = CASES[case]
    steps = 80 if case == "associate" else 24
    sync = gym.vector.SyncVectorEnv([partial(in_any_process, name, **options)] * 2, autoreset_mode=mode)
    theirs = vector_rollout(sync, steps)
    ours = vector_rollout(many(name, autoreset_mode=mode, **options), steps)
    assert case == "associate, log" or sum(step[2].any() for step in theirs[1:]) >= 1, "no autoreset was tried"
    for one, other in zip(ours, theirs, strict=True):
        assert not differences([_in_order(part) for part in one], [_in_order(part) for part in other])


@pytest.mark.parametrize(("name", "options"), OPTIONS, ids=[f"{name}-{k}" for k, (name, _) in enumerate(OPTIONS)])
def test_each_world_is_the_single_environment_whatever_the_options(name, options, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(Path(__file__).parents[3])
    given = {key: value for key, value in options.items() if key != "render_mode"}
    if "floor_plan" in given:
        given["floor_plan"] = str(_plan(tmp_path))
    envs, alone = many(name, **given), bare(name, **given)
    rng = np.random.default_rng(0)
    infos = envs.reset(seed=[3, 8], options={"world": [2, 4]})[1]
    info = alone.reset(seed=8, options={"world": 4})[1]
    over = False
    for _ in range(3):
        assert not differences(_row(infos, 1), _in_order(info))
        if over:
            break
        actions = legal(envs, rng)
        observations, rewards, terminated, _, infos = envs.step(actions)
        observation, reward, over, _, info = alone.step(actions[1])
        assert not differences({key: part[1] for key, part in observations.items()}, _in_order(observation))
        assert rewards[1] == reward and terminated[1] == over


def _plan(folder):
    from slam_gym.world.floor_plan_file import save_floor_plan
    from slam_gym.world.generators import OfficeGenerator

    save_floor_plan(OfficeGenerator(rooms=2)(np.random.default_rng(0)), folder / "plan.json")
    return folder / "plan.json"


def _row(infos, world):
    """The info of one world, as the single environment has it."""
    info = {key: value for key, value in infos.items() if not key.startswith("_") and infos[f"_{key}"][world]}
    return _in_order({
        key: _row(value, world) if isinstance(value, dict) else value[world] for key, value in info.items()
    })  # fmt: skip


def _in_order(value):
    """With its keys sorted, and its numbers as Python has them."""
    if isinstance(value, dict):
        return {key: _in_order(part) for key, part in sorted(value.items())}
    if isinstance(value, np.ndarray) and value.dtype == object:
        return [_in_order(part) for part in value]
    return value.item() if isinstance(value, np.generic) else value


@pytest.fixture(scope="module")
def spread():
    """Three worlds in two processes."""
    name, options = CASES["explore, goals"]
    envs = many(name, 3, workers=2, **options)
    yield envs
    envs.close()


def test_worlds_in_other_processes_are_those_of_this_one(spread) -> None:
    name, options = CASES["explore, goals"]
    here = many(name, 3, workers=0, **options)
    rng = np.random.default_rng(0)
    one, other = here.reset(seed=5), spread.reset(seed=5)
    ended = 0
    for _ in range(24):
        assert not differences(one, other)
        actions = legal(here, rng)
        np.testing.assert_array_equal(here.action_masks(), spread.action_masks())
        one, other = here.step(actions), spread.step(actions)
        ended += int(one[2].any())
    assert ended, "no autoreset was tried"
    snapshots = spread.call("snapshot")
    assert not differences(here.call("snapshot"), snapshots)
    actions = legal(here, rng)
    one = here.step(actions)
    spread.reset(seed=1)
    assert not differences(spread.restore(snapshots)[0], other[0])
    other = spread.step(actions)
    assert not differences(one, other)


def test_a_world_can_be_asked_for_and_told(spread) -> None:
    spread.reset(seed=5, options={"world": [1, 2, 3]})
    assert spread.get_attr("split") == ("train",) * 3
    assert [snapshot.options for snapshot in spread.call("snapshot")] == [{"world": k} for k in (1, 2, 3)]
    spread.set_attr("nickname", ["a", "b", "c"])
    assert spread.get_attr("nickname") == ("a", "b", "c")
    spread.set_attr("nickname", 7)
    assert spread.get_attr("nickname") == (7, 7, 7)
    assert spread.np_random_seed == (5, 6, 7)
    assert spread.call_in([2, 0], "get_wrapper_attr", "split") == ("train",) * 2
    with pytest.raises(ValueError, match="nickname: 2 values for 3 worlds"):
        spread.set_attr("nickname", [1, 2])
    with pytest.raises(WorldError, match="world 0: AttributeError"):
        spread.call("no_such_thing")


# -- refusals and ends ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_a_bad_action_is_refused_with_its_world_and_no_world_moves(name) -> None:
    envs, twin = small(name), small(name)
    with pytest.raises(RuntimeError, match=r"world 0: no episode yet: call reset\(\) first"):
        envs.step(np.zeros(2, int))
    envs.reset(seed=0), twin.reset(seed=0)
    count = int(envs.single_action_space.n)
    for wrong in ([0, count], [0, -1]):
        with pytest.raises(ValueError, match="world 1: action"):
            envs.step(np.array(wrong))
    for wrong in (0, [0], [0.5, 1.0], [[0], [1]], ["a", "b"]):
        with pytest.raises(ValueError, match=r"expected whole numbers of shape \(2,\)"):
            envs.step(wrong)
    actions = legal(envs, np.random.default_rng(0))
    assert not differences(envs.step(actions), twin.step(actions))


def test_a_twist_outside_the_box_is_refused_with_its_world() -> None:
    envs = small("Explore-v0", action="twist")
    envs.reset(seed=0)
    for wrong in (1.5, np.nan):
        with pytest.raises(ValueError, match=r"world 1: action .* is not two fractions"):
            envs.step(np.array([[0.0, 0.0], [wrong, 0.0]]))


def test_without_autoreset_an_ended_world_is_reset_by_hand_and_alone() -> None:
    envs = many("Explore-v0", scenario=short(12), action="twist", autoreset_mode=AutoresetMode.DISABLED)
    alone = [bare("Explore-v0", scenario=short(12), action="twist") for _ in range(2)]
    envs.reset(seed=3)
    [env.reset(seed=3 + i) for i, env in enumerate(alone)]
    for _ in range(2):
        *_, infos = envs.step(np.zeros((2, 2)))
        [env.step(np.zeros(2)) for env in alone]
    mask = np.array([False, True])
    observations, infos = envs.reset(seed=9, options={"reset_mask": mask})
    assert infos["_ticks"].tolist() == [False, True]
    expected = alone[1].reset(seed=10)[0]
    assert not differences({key: part[1] for key, part in observations.items()}, _in_order(expected))
    for _ in range(10):
        observations, _, terminated, _, infos = envs.step(np.zeros((2, 2)))
    assert terminated.tolist() == [True, False]
    with pytest.raises(RuntimeError, match=r"world 0: the episode is over: call reset\(options="):
        envs.step(np.zeros((2, 2)))
    for wrong in ([True, False], np.zeros(2, bool), np.ones(3, bool)):
        if not isinstance(wrong, list):
            with pytest.raises(ValueError, match="reset_mask"):
                envs.reset(options={"reset_mask": wrong})
    envs.reset(options={"reset_mask": ~mask})
    assert not envs.step(np.zeros((2, 2)))[2].any()


@pytest.mark.parametrize("mode", MODES)
def test_an_episode_that_is_too_long_is_truncated(mode) -> None:
    envs = small("Explore-v0", scenario=short(30), action="twist", max_episode_steps=3, autoreset_mode=mode)
    envs.reset(seed=0)
    for step in range(3):
        *_, terminated, truncated, infos = envs.step(np.zeros((2, 2)))
        assert not terminated.any() and truncated.all() == (step == 2)
    assert ("final_obs" in infos) == (mode is AutoresetMode.SAME_STEP)


@pytest.mark.parametrize("workers", [0, 2])
def test_an_error_in_a_world_names_it_and_a_reset_leads_on(workers) -> None:
    def failing(scan, prediction):
        failing.calls = getattr(failing, "calls", 0) + 1
        if failing.calls == 4:
            raise ZeroDivisionError("an associator's own mistake")
        return nearest_neighbour(scan, prediction)

    envs = many("Explore-v0", 2, workers, scenario=short(30), action="twist", associator=failing)
    envs.reset(seed=0)
    with pytest.raises(WorldError, match=r"world [01]: ZeroDivisionError: an associator's own mistake"):
        for _ in range(4):
            envs.step(np.full((2, 2), 0.5))
    with pytest.raises(WorldError, match=r"world [01]: RuntimeError: the last step failed half-way"):
        envs.step(np.full((2, 2), 0.5))
    envs.reset(seed=0)
    envs.step(np.full((2, 2), 0.5))
    envs.close()
    with pytest.raises(RuntimeError, match="closed"):
        envs.step(np.zeros((2, 2)))
    envs.close()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_envs": 0}, "num_envs=0"),
        ({"workers": -1}, "workers=-1"),
        ({"scenario": "atlantis"}, "atlantis.*office-small"),
        ({"autoreset_mode": "Sometimes"}, "Sometimes"),
        ({"reward": "money"}, "money"),
    ],
)
def test_bad_arguments_are_refused(options, message) -> None:
    with pytest.raises(ValueError, match=message):
        many("Explore-v0", **{"num_envs": 2} | options)


# -- what is handed out --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_what_is_handed_out_lies_in_its_space_and_may_be_kept(name) -> None:
    envs, twin = small(name), small(name)
    rng, over = np.random.default_rng(0), []
    one, other = envs.reset(seed=0), twin.reset(seed=0)
    for _ in range(6):
        assert envs.observation_space.contains(one[0])
        assert not differences(one, other)
        over.append(one[0])
        actions = legal(twin, rng)
        for array in one[0].values():
            array.fill(1)
        envs.action_masks().fill(False)
        one, other = envs.step(actions), twin.step(actions)
    assert not any(np.shares_memory(a[key], b[key]) for a, b in pairwise(over) for key in a)


def test_without_copies_the_arrays_are_the_shared_ones() -> None:
    envs = small("Explore-v0", action="twist", copy=False)
    first = envs.reset(seed=0)[0]
    second = envs.step(np.full((2, 2), 0.5))[0]
    assert all(np.shares_memory(first[key], second[key]) for key in first)


def test_pictures_of_all_worlds() -> None:
    pytest.importorskip("pygame")
    envs = small("Explore-v0", render_mode="rgb_array")
    envs.reset(seed=0)
    pictures = envs.render()
    assert len(pictures) == 2 and not np.array_equal(*pictures)


WRAPPERS = {
    "RecordEpisodeStatistics": wrappers.RecordEpisodeStatistics,
    "NormalizeReward": wrappers.NormalizeReward,
    "ClipReward": partial(wrappers.ClipReward, min_reward=-1.0, max_reward=1.0),
    "DictInfoToList": wrappers.DictInfoToList,
    "FlattenObservation": wrappers.FlattenObservation,
    "TransformReward": partial(wrappers.TransformReward, func=lambda reward: 2.0 * reward),
    "RescaleAction": partial(wrappers.RescaleAction, min_action=-0.5, max_action=0.5),
}


@pytest.mark.parametrize("wrapper", WRAPPERS)
def test_wrappers_of_gymnasium_work_on_it(wrapper) -> None:
    sync = gym.vector.SyncVectorEnv([partial(in_any_process, "Explore-v0", scenario=short(4), action="twist")] * 2)
    ours, theirs = WRAPPERS[wrapper](small("Explore-v0", scenario=short(4), action="twist")), WRAPPERS[wrapper](sync)
    results = [[envs.reset(seed=0)] for envs in (ours, theirs)]
    for _ in range(6):
        actions = np.full((2, 2), 0.25, np.float32)
        for envs, found in zip((ours, theirs), results):
            found.append(envs.step(actions))
    for one, other in zip(*results):
        for a, b in zip(one[:-1], other[:-1]):
            assert not differences(_in_order(a), _in_order(b))
        if wrapper == "RecordEpisodeStatistics" and "episode" in other[-1]:
            assert not differences({k: one[-1]["episode"][k] for k in "rl"}, {k: other[-1]["episode"][k] for k in "rl"})
    ours.close()
    theirs.close()
