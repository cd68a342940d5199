"""Wrappers: the same numbers in another form, masks where they belong, and the checkers of Gymnasium and SB3."""

import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as sb3_check_env

from slam_gym.envs.wrappers import FlatObservation, MaskInObservation, RecordEveryTick
from tests.rollouts import bare

IDS = ("Explore-v0", "Associate-v0", "Relocate-v0")
SMALL = {"scenario": "office-small", "overrides": {"budget": 12}}
WRAPPED = {
    "flat": FlatObservation,
    "masked": MaskInObservation,
    "flat and masked": lambda env: MaskInObservation(FlatObservation(env)),
    "masked, then flat": lambda env: FlatObservation(MaskInObservation(env)),
}


@pytest.mark.parametrize("how", WRAPPED)
@pytest.mark.parametrize("name", IDS)
def test_observations_are_those_of_the_environment_in_another_form(name, how):
    plain, env = bare(name, **SMALL), WRAPPED[how](bare(name, **SMALL))
    whole, info = plain.reset(seed=3)
    seen, _ = env.reset(seed=3)
    env = pickle.loads(pickle.dumps(env))
    for _ in range(3):
        assert env.observation_space.contains(seen)
        names = [name for name in plain.observation_space.spaces if name != "image"]
        parts = [whole[name].ravel() for name in names]
        if how.startswith("flat"):
            vector = seen["observations"] if how == "flat and masked" else seen
            np.testing.assert_allclose(vector, np.concatenate(parts), atol=1e-6)
        if how in ("masked", "flat and masked"):
            np.testing.assert_array_equal(seen["action_mask"], info["action_mask"])
        action = int(info["action_mask"].argmax())
        (whole, _, over, _, info), (seen, *_) = plain.step(action), env.step(action)
        if over:
            break


@pytest.mark.filterwarnings("ignore:.*different from the unwrapped version")
@pytest.mark.parametrize("how", ["flat", "flat and masked"])
def test_checkers_are_content(how):
    check_env(WRAPPED[how](bare("Explore-v0", **SMALL)), skip_render_check=True)
    sb3_check_env(WRAPPED[how](bare("Explore-v0", **SMALL)))


def test_masks_are_found_through_wrappers_and_made_from_specs_again():
    env = MaskInObservation(FlatObservation(gym.make("slam_gym/Explore-v0", **SMALL)))
    env.reset(seed=0)
    assert env.get_wrapper_attr("action_masks")().any()
    again = gym.make(env.spec)
    assert isinstance(again, MaskInObservation) and again.observation_space == env.observation_space


@pytest.mark.parametrize(
    ("wrap", "name", "options", "said"),
    [
        (MaskInObservation, "Explore-v0", {"action": "twist"}, "masks are for discrete actions"),
        (lambda env: FlatObservation(FlatObservation(env)), "Explore-v0", {}, "expected a Dict"),
        (lambda env: RecordEveryTick(env, "films"), "Explore-v0", {"render_mode": "rgb_array"}, "rgb_array_list"),
    ],
)
def test_what_cannot_be_wrapped_is_refused_by_name(wrap, name, options, said):
    with pytest.raises(ValueError, match=said):
        wrap(bare(name, scenario="office-small", **options))


def test_a_film_of_goals_has_a_picture_of_every_tick(tmp_path):
    pytest.importorskip("pygame")
    pytest.importorskip("moviepy")
    env = gym.make("slam_gym/Explore-v0", render_mode="rgb_array_list", **SMALL)
    film = RecordEveryTick(env, str(tmp_path), episode_trigger=lambda episode: episode == 1)
    film.reset(seed=1)
    film.step(0)
    assert not env.render(), "pictures of an episode that is not filmed are not kept"
    _, info = film.reset(seed=0)
    ticks = 0
    for _ in range(2):
        _, _, over, _, info = film.step(int(info["action_mask"].nonzero()[0][-1]))
        ticks += info["ticks"]
        if over:
            break
    assert len(film.recorded_frames) == 1 + ticks > 3
    film.close()
    assert list(tmp_path.glob("*.mp4"))
