"""The view of an association: a picture for every stage, for scenarios and logs, that changes with the decision."""

import numpy as np
import pytest

pytest.importorskip("pygame")

from slam_gym.rendering import associate_view, symbols
from slam_gym.rendering.window import pixels
from tests.rollouts import associate, episode, short


@pytest.mark.parametrize("scenario", ["corridor", short(20)])
def test_every_stage_has_its_picture(scenario) -> None:
    env, pictures = associate(scenario, render_mode="rgb_array", candidates=3), set()
    for number, _ in enumerate(episode(env, seed=3)):
        over = env.walk is None
        if number % 20 == 0 or over:
            picture = env.render()
            assert picture.shape == (720, 1140, 3) and picture.std() > 10.0
            assert (picture == symbols.CHOICE).all(axis=2).any()  # its entry of the key
            candidates = (picture[:, :700] == symbols.PLAN).all(axis=2)
            assert over or candidates.any(), "no gate of what is on offer"
            pictures.add(picture.tobytes())
    assert over and len(pictures) > 3
    np.testing.assert_array_equal(env.render(), env.render())


def test_a_picture_may_be_small() -> None:
    env = associate(short(20))
    env.reset(seed=1)
    surface = associate_view.draw(env.run, env.walk, env._answers, (("look", "1 of 9"),), (700, 480))
    assert pixels(surface).shape == (480, 700, 3)
