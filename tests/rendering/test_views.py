"""The view of an exploration: the whole floor, and a panel that covers none of it."""

import numpy as np
import pytest

from slam_gym.metrics.association import Decision
from slam_gym.rendering import explore_view, symbols
from slam_gym.rendering.canvas import pixels, pygame
from slam_gym.rendering.explore_view import arrange, draw_floor
from slam_gym.rendering.panels import PANEL, STAR, ActionRow, TreeLevel, TreePanel, draw_panel
from slam_gym.rendering.scene import Scene
from tests.rendering.test_scene import count
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
    assert [what for what, _ in explore_view._figures(env.episode)][:7] == [
        "tick", "map error", "explored", "mapped", "true features", "paired right", "pose error",
    ]  # fmt: skip


@pytest.mark.parametrize("scenario", ["corridor", short(20)])
def test_every_stage_has_its_picture(scenario) -> None:
    env, pictures = associate(scenario, render_mode="rgb_array", candidates=3), set()
    for number, _ in enumerate(episode(env, seed=3)):
        over = env.walk is None
        if number % 20 == 0 or over:
            picture = env.render()
            assert picture.shape == (720, 960, 3) and picture.std() > 10.0
            assert (picture == symbols.CHOICE).all(axis=2).any()  # its entry of the key
            candidates = (picture[:, :540] == symbols.PLAN).all(axis=2)
            assert over or candidates.any(), "no gate of what is on offer"
            pictures.add(picture.tobytes())
    assert over and len(pictures) > 3
    np.testing.assert_array_equal(env.render(), env.render())


# --- a panel shows the path, the offer and the truth, and any number of levels and choices fits -----------------------

WRONG = symbols.DECISIONS[Decision.WRONG]
KEY = ((symbols.MAPPED, symbols.MAPPED, "mapped feature"),) * 9


def drawn(levels, at, height=720, **shown) -> np.ndarray:
    surface = pygame.Surface((PANEL, height), depth=32)
    surface.fill(symbols.PAPER)
    figures = (("look", "3 of 9"), ("score", "0.5"), ("paired right", "7"))
    shown = {"headings": ("z is", "feature"), "choices": [ActionRow("*", False, ("none",))]} | shown
    draw_panel(surface, (0, 0, PANEL, height), TreePanel(figures, levels, at, KEY, **shown))
    return pixels(surface)


def test_the_path_the_offer_and_the_truth_show() -> None:
    path = [
        TreeLevel("z0", 2, chosen=0, decision=Decision.WRONG),
        TreeLevel("z1", 0, chosen=STAR, decision=Decision.WRONG),
    ]
    here = TreeLevel("z2", 12, legal=frozenset({0, 1}), right=1)
    picture = drawn([*path, here, TreeLevel("z3", 1)], 2)
    for colour in (WRONG, symbols.PLAN, symbols.TRUTH, symbols.BAND):
        assert count(picture, colour) > 0, colour
    leaf = drawn(path, 2, remarks=("A leaf of 1 pairing", "D² = 3"))
    assert count(leaf, WRONG) > 0 == count(leaf, symbols.BAND)


@pytest.mark.parametrize("levels", [0, 1, 3, 60])
@pytest.mark.parametrize("height", [480, 720])
def test_any_number_of_levels_and_choices_fits(levels, height) -> None:
    tree = [TreeLevel(f"z{k}", k % 12, right=0) for k in range(levels)]
    choices = [ActionRow(str(k), k == 3, (str(k),)) for k in range(200)] + [ActionRow("*", False, ("none",))]
    for at in {0, levels // 2, levels}:
        picture = drawn(tree, at, height, choices=choices)
        assert picture.shape == (height, PANEL, 3)
        rows = (picture[:, 18:29] == symbols.PLAN).all(axis=2).any(axis=1)
        badges = int((rows[1:] & ~rows[:-1]).sum())
        assert 2 <= badges <= 12
