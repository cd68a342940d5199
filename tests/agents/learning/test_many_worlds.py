"""The worlds as Stable-Baselines3 asks for them: its contract at the ends of episodes, masks, calls of some worlds."""

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from agents.learning.many_worlds import WorldsForLearning
from tests.rollouts import bare, differences, short


def many(**options):
    given = {"scenario": short(60), "autoreset_mode": "SameStep", "workers": 0} | options
    return gym.make_vec("slam_gym/Explore-v0", num_envs=2, **given)


def test_they_do_what_a_dummy_of_monitored_environments_does() -> None:
    keys = ("map_error", "coverage")
    makers = [lambda: Monitor(bare("Explore-v0", scenario=short(60)), info_keywords=keys)] * 2
    theirs, ours = DummyVecEnv(makers), WorldsForLearning(many(), 10.0, keys)
    theirs.seed(4), ours.seed(4)
    assert not differences(dict(sorted(theirs.reset().items())), ours.reset())
    ends, rng = 0, np.random.default_rng(0)
    for _ in range(30):
        masks = np.stack(theirs.env_method("action_masks"))
        np.testing.assert_array_equal(masks, np.stack(ours.env_method("action_masks")))
        actions = np.array([rng.choice(np.flatnonzero(mask)) for mask in masks])
        (one, *rest), (other, *others) = theirs.step(actions), ours.step(actions)
        assert not differences(dict(sorted(one.items())), other)
        np.testing.assert_allclose(others[0], 10.0 * rest[0], rtol=1e-6)
        np.testing.assert_array_equal(others[1], rest[1])
        for expected, info in zip(rest[2], others[2]):
            assert info["map_error"] == expected["map_error"]
            if "episode" in expected:
                ends += 1
                told = {key: value for key, value in expected["episode"].items() if key != "t"}
                assert info["episode"] == pytest.approx(told, abs=1e-5)
                assert info["TimeLimit.truncated"] is False
                assert set(info["map_quality"]) == set(expected["map_quality"])
                for key, part in expected["terminal_observation"].items():
                    np.testing.assert_array_equal(info["terminal_observation"][key], part)
    assert ends >= 4


def test_an_episode_that_is_too_long_is_truncated_for_stable_baselines() -> None:
    envs = WorldsForLearning(many(action="twist", max_episode_steps=2))
    envs.reset()
    envs.step(np.zeros((2, 2)))
    _, _, dones, infos = envs.step(np.zeros((2, 2)))
    assert dones.all() and all(info["TimeLimit.truncated"] is True for info in infos)
    assert not envs.has_attr("action_masks") and envs.has_attr("split")


def test_some_worlds_can_be_asked_and_told_and_put_somewhere() -> None:
    envs = WorldsForLearning(many())
    envs.set_options({"world": 3})
    envs.reset()
    assert [snapshot.options for snapshot in envs.env_method("snapshot")] == [{"world": 3}] * 2
    assert envs.get_attr("split", indices=1) == ["train"]
    envs.set_attr("nickname", "b", indices=[1])
    assert envs.get_attr("nickname", indices=[1]) == ["b"]
    assert envs.env_is_wrapped(Monitor) == [False, False]
    assert len(envs.env_method("action_masks", indices=[0])) == 1
    envs.set_options([{"world": 3}, {}])
    with pytest.raises(ValueError, match="all environments or none"):
        envs.reset()
    envs.close()


def test_only_worlds_that_are_reset_in_the_same_step_will_do() -> None:
    with pytest.raises(ValueError, match="autoreset_mode=NextStep"):
        WorldsForLearning(many(autoreset_mode="NextStep"))
