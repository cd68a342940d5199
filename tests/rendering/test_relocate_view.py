"""The view of a relocation: a picture for every state, inside and outside of the map."""

from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("pygame")

from slam_gym.rendering import relocate_view
from slam_gym.rendering.window import pixels
from tests.rollouts import episode, relocate, short


@pytest.mark.parametrize("outside", [0.0, 1.0])
@pytest.mark.parametrize("name", ["office-small", "hall"])
def test_pictures_of_every_state_differ(name, outside) -> None:
    env = relocate(short(150, name), outside=outside, node_limit=30, render_mode="rgb_array")
    pictures = []
    for _ in episode(env, seed=1):
        pictures.append(env.render())
        assert pictures[-1].dtype == np.uint8 and pictures[-1].shape == (720, 1140, 3)
        assert len(np.unique(pictures[-1][::3, ::3].astype(np.int32) @ [65536, 256, 1])) > 50
    assert all(not np.array_equal(a, b) for a, b in pairwise(pictures[:-1]))


def test_a_picture_may_be_small_and_the_offer_large() -> None:
    env = relocate(candidates=200, locality=None)
    env.reset(seed=0)
    surface = relocate_view.draw(env.walk, env.mapped, env.kidnapped, env._figures(), (800, 560))
    assert pixels(surface).shape == (560, 800, 3)
