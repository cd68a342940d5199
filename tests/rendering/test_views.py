"""The view of an exploration: the whole floor, and a panel that covers none of it."""

import numpy as np
import pytest

from slam_gym.rendering import explore_view, symbols
from slam_gym.rendering.canvas import pixels
from slam_gym.rendering.explore_view import arrange, draw_floor
from slam_gym.rendering.scene import Scene
from tests.rollouts import associate, episode, explore, short

pytest.importorskip("pygame")


@pytest.mark.parametrize(
    "bounds", [(0, 0, 24, 14), (-30, 5, -22, 60), (0, 0, 0, 0), (0, 0, 300, 80), (1e4, 1e4, 1e4 + 1, 1e4 + 1)]
)
def test_the_plan_fits_into_the_map_and_the_panel_covers_none_of_it(bounds) -> None:
    size, layout = explore_view.SIZE, arrange(np.array(bounds, float), rows=8)
    corners = (np.reshape(bounds, (2, 2)) - np.array(layout.low)) * layout.scale
    assert (corners >= 10).all() and (corners <= np.array(layout.map_size) - 10).all()
    left, top, width, height = layout.panel
    assert left >= layout.map_size[0] or top >= layout.map_size[1]
    assert (left + width, top + height) == size
    assert layout.map_size[0] * layout.map_size[1] >= 0.4 * size[0] * size[1]
    assert pixels(draw_floor(Scene(), np.array(bounds, float))).shape == (size[1], size[0], 3)


def test_an_episode_is_drawn_with_its_goals_and_what_became_of_the_robot() -> None:
    env = explore(short(60, "kidnapped"), relocation="gcbb")
    for _ in episode(env, 2):
        pass
    goals = env.goals.positions[1:][env.goals.legal[1:]]
    plain, fuller = (
        pixels(explore_view.draw(env.episode, some, covisibility=edges))
        for some, edges in ((goals[:0], False), (goals, True))
    )
    assert plain.shape == fuller.shape == (720, 960, 3) and (plain != fuller).any()
    assert (fuller == symbols.PLAN).all(axis=2).any()
    assert [what for what, _ in explore_view._figures(env.episode)][:5] == [
        "map error", "explored", "features mapped", "pairings right", "pose error",
    ]  # fmt: skip


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
