"""The legend explains what a scene shows, and only that."""

import numpy as np
import pytest

pytest.importorskip("pygame")

from slam_gym.rendering import symbols
from slam_gym.rendering.legend import legend, shown_in
from slam_gym.rendering.scene import Grid, Scene
from slam_gym.rendering.window import pixels

ALL = frozenset({"furniture", "people", "covisibility", "grid", "goals"})


def test_what_is_not_in_the_scene_is_not_in_the_legend() -> None:
    assert shown_in(Scene()) == frozenset()
    grid = Grid(np.zeros((2, 2), np.uint8), np.zeros(3), 0.2)
    scene = Scene(
        people=np.ones((1, 3)),
        furniture=np.ones((1, 5)),
        goals=np.ones((1, 2)),
        covisibility=np.zeros((1, 2), int),
        grid=grid,
    )
    assert shown_in(scene) == ALL
    for colour, name in ((symbols.PERSON[0], "people"), (symbols.FURNITURE[0], "furniture"), (symbols.PLAN, "goals")):
        for shown in (ALL, ALL - {name}):
            assert (pixels(legend(shown, True)) == colour).all(axis=2).any() == (name in shown)


def test_groups_stand_side_by_side_or_above_each_other() -> None:
    stacked, beside = legend(ALL, True), legend(ALL, False)
    assert stacked.get_width() < beside.get_width() and stacked.get_height() > beside.get_height()
    assert legend(frozenset(), True).get_height() < stacked.get_height()


def test_every_entry_has_a_symbol() -> None:
    surface = legend(ALL, True)
    picture = pixels(surface)
    symbols_column = (picture[:, :40] != symbols.PAPER).any(axis=(1, 2))
    words_column = (picture[:, 48:] != symbols.PAPER).any(axis=(1, 2))
    for top in np.flatnonzero(words_column[1:] & ~words_column[:-1]):
        assert symbols_column[top : top + 18].any(), f"words at row {top} without a symbol"
