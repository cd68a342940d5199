"""A panel shows the path, the offer and the truth, and any number of levels and choices fits."""

import numpy as np
import pytest

from slam_gym.rendering import symbols
from slam_gym.rendering.canvas import pixels, pygame
from slam_gym.rendering.panels import PANEL, STAR, Choice, Level, TreePanel, draw_panel

pytest.importorskip("pygame")


RED = (200, 30, 50)
KEY = ((symbols.MAPPED, symbols.MAPPED, "mapped feature"),) * 9


def drawn(levels, at, height=720, **shown) -> np.ndarray:
    surface = pygame.Surface((PANEL, height), depth=32)
    surface.fill(symbols.PAPER)
    figures = (("look", "3 of 9"), ("score", "0.5"), ("paired right", "7"))
    shown = {"columns": ((0, "z is"), (64, "feature")), "choices": [Choice("*", False, ("none",))]} | shown
    draw_panel(surface, (0, 0, PANEL, height), TreePanel(figures, levels, at, KEY, **shown))
    return pixels(surface)


def has(picture, colour) -> bool:
    return bool((picture == colour).all(axis=2).any())


def test_the_path_the_offer_and_the_truth_show() -> None:
    path = [Level("z0", 2, chosen=0, colour=RED), Level("z1", 0, chosen=STAR, colour=RED)]
    here = Level("z2", 12, legal=frozenset({0, 1}), right=1)
    picture = drawn([*path, here, Level("z3", 1)], 2)
    assert has(picture, RED) and has(picture, symbols.PLAN) and has(picture, symbols.TRUTH)
    assert has(picture, symbols.BAND)
    leaf = drawn(path, 2, remarks=("A leaf of 1 pairing", "D² = 3"))
    assert has(leaf, RED) and not has(leaf, symbols.BAND)


@pytest.mark.parametrize("levels", [0, 1, 3, 60])
@pytest.mark.parametrize("height", [480, 720])
def test_any_number_of_levels_and_choices_fits(levels, height) -> None:
    tree = [Level(f"z{k}", k % 12, right=0) for k in range(levels)]
    choices = [Choice(str(k), k == 3, (str(k),)) for k in range(200)] + [Choice("*", False, ("none",))]
    for at in {0, levels // 2, levels}:
        picture = drawn(tree, at, height, choices=choices)
        assert picture.shape == (height, PANEL, 3)
        rows = (picture[:, 18:29] == symbols.PLAN).all(axis=2).any(axis=1)
        badges = int((rows[1:] & ~rows[:-1]).sum())
        assert 2 <= badges <= 12
