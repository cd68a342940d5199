"""Tokens of goals: finite, in their places, and of what the environment shows now."""

import numpy as np
import pytest

from agents.drivers.goal_tokens import COMMON, OWN, TOKEN_FIELDS, ticks_left, tokens_of
from agents.drivers.information_gain import GainSpec, rates
from agents.evaluation.episodes import ExploreArguments, reset_arguments
from slam_gym.envs.goal_observation import GOAL_FIELDS, unsquash_goals
from slam_gym.envs.observation import METRES, PIXELS


@pytest.fixture(scope="module")
def steps():
    """Observations, infos and ticks used of an episode driven by chance."""
    env, rng, used, over, out = (
        ExploreArguments("office-small", split="train").make("goal"),
        np.random.default_rng(0),
        0,
        False,
        [],
    )
    observation, info = env.reset(**reset_arguments(0))
    while not over:
        out.append((observation, info, used))
        observation, _, over, _, info = env.step(int(rng.choice(np.flatnonzero(info["action_mask"]))))
        used += info["ticks"]
    return out


def test_tokens_are_finite_and_tell_what_the_goals_are(steps):
    for observation, info, used in steps:
        tokens, goals = tokens_of(observation, used), unsquash_goals(observation["goals"])
        assert tokens.fields.shape == (16, len(TOKEN_FIELDS)) == (16, len(OWN) + len(COMMON))
        assert np.isfinite(tokens.fields).all() and np.abs(tokens.fields).max() <= 4.0
        assert np.allclose(tokens.places, np.column_stack([goals["x"], goals["y"]]))
        fresh = goals["revisit"] < 0.5
        assert np.allclose(tokens.rates[fresh], rates(goals | {"reduction": np.zeros(16)}, GainSpec())[fresh])
        assert (tokens.rates[~fresh] == 0.0).all()
        kinds = tokens.fields[:, [TOKEN_FIELDS.index(f"is {kind}") for kind in ("look around", "frontier")]]
        assert (kinds.sum(axis=1)[info["action_mask"] & fresh] == 1.0).all()
        assert (tokens.fields[:, len(OWN) :] == tokens.fields[0, len(OWN) :]).all()


def test_the_map_around_a_goal_is_that_of_the_image():
    image = np.zeros((3, PIXELS, PIXELS), np.uint8)
    image[0, : PIXELS // 2] = 255  # all that lies ahead is free
    goals = np.zeros((16, len(GOAL_FIELDS)), np.float32)
    goals[1:3, 1] = (0.3, -0.3)  # one ahead, one behind, in squashed metres
    shown = {"goals": goals.ravel(), "image": image, "uncertainty": np.zeros(3), "budget": np.ones(1)}
    fields = tokens_of(shown, 0.0).fields
    for name, ahead in (("free within 3", 1.0), ("unknown within 3", 0.0), ("wall within 3", 0.0)):
        column = fields[:, TOKEN_FIELDS.index(name)]
        assert column[1] == ahead and column[2] == (1.0 - ahead if name[0] != "w" else 0.0)
    assert METRES / PIXELS == 0.5  # [m] the reaches around a goal are of this pixel


def test_what_is_left_follows_from_what_was_used():
    assert ticks_left(0.75, 100.0) == pytest.approx(300.0)
    assert ticks_left(1.0, 0.0) == ticks_left(0.9999, 100.0) > 1000.0 and ticks_left(0.0, 100.0) == 0.0


def test_in_an_episode_the_ticks_left_are_right(steps):
    for observation, _, used in steps[1:]:
        assert ticks_left(float(observation["budget"][0]), used) == pytest.approx(300 - used, abs=0.01)
