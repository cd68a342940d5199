"""Parts of a panel: figures in columns, tables with bars, keys, and badges that keep apart."""

import math

import numpy as np
import pytest

pytest.importorskip("pygame")

from slam_gym.rendering import symbols
from slam_gym.rendering.canvas import pygame
from slam_gym.rendering.panels import Choice, badges, figures, key, table
from slam_gym.rendering.window import pixels


def sheet(size=(420, 300)):
    surface = pygame.Surface(size, depth=32)
    surface.fill(symbols.PAPER)
    return surface


def ink(surface) -> np.ndarray:
    return (pixels(surface) != symbols.PAPER).any(axis=2)


@pytest.mark.parametrize("columns", [1, 2])
def test_figures_stay_in_their_columns(columns) -> None:
    surface = sheet()
    figures(surface, (("map error", "0.5"), ("pose error", "3 cm"), ("explored", "40 %")), (10, 10), 400, columns)
    drawn = ink(surface)
    assert drawn.any() and not drawn[:, 411:].any() and not drawn[:, :9].any()
    assert drawn[:, 220:].any()
    assert drawn[60:].any() == (columns == 1 and drawn[52:].any())


def test_bars_are_as_long_as_their_fraction() -> None:
    lengths = []
    for fraction in (0.25, 1.0, 7.0, -1.0):
        surface = sheet()
        choices = [Choice("0", False, ("12", ("3.4", fraction))), Choice("*", True, ("none",))]
        table(surface, (10, 20, 380, 0), ((0, "z1 is …"), (64, "feature"), (156, "alone")), choices, "and 2 more")
        bar = (pixels(surface)[:, 200:] == symbols.PLAN).all(axis=2)
        lengths.append(bar.any(axis=0).sum())
    assert lengths[0] == pytest.approx(15, abs=2) and lengths[1] == lengths[2] == pytest.approx(60, abs=2)
    assert 0 < lengths[3] < 5
    assert (pixels(surface) == symbols.TRUTH).all(axis=2).any()


def test_a_key_stands_at_the_foot_of_its_box() -> None:
    surface = sheet()
    top = key(surface, (10, 0, 400, 300), [(symbols.MAPPED, symbols.INK, f"thing {k}") for k in range(7)])
    drawn = ink(surface)
    assert not drawn[:top].any() and drawn[top].any() and drawn[top + 40 :].any()


def test_badges_keep_apart_and_close_to_what_they_name(monkeypatch) -> None:
    from slam_gym.rendering import panels

    put = []
    monkeypatch.setattr(panels, "badge", lambda picture, centre, words: put.append((centre, words)))
    points = [(100.0 + 3.0 * k, 100.0) for k in range(6)]
    badges(sheet(), points)
    assert [words for _, words in put] == list("012345")
    centres = [centre for centre, _ in put]
    for k, one in enumerate(centres):
        assert math.dist(one, points[k]) < 60.0
        assert all(math.dist(one, other) > 19.0 for other in centres[:k])
