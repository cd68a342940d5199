"""Symbols: colours that can be told apart, and marks for every kind of thing."""

import itertools

import numpy as np
import pytest

pytest.importorskip("pygame")

from slam_gym.metrics.association import Decision
from slam_gym.rendering import symbols
from slam_gym.rendering.canvas import Canvas
from slam_gym.rendering.window import pixels


def test_colours_that_stand_side_by_side_differ_clearly() -> None:
    colours = [symbols.DECISIONS[code] for code in list(Decision)[:5]] + [symbols.PLAN, symbols.MAPPED, symbols.INK]
    for one, other in itertools.combinations(colours, 2):
        assert np.abs(np.subtract(one, other)).sum() > 25, (one, other)
    for other in (symbols.PLAN, symbols.DECISIONS[Decision.RIGHT], symbols.MAPPED):
        assert np.abs(np.subtract(symbols.TRUTH, other)).sum() > 100, other


def test_every_decision_has_a_colour_and_every_kind_of_feature_a_shape() -> None:
    assert set(symbols.DECISIONS) == set(Decision)
    shapes = []
    for kind in range(3):
        canvas = Canvas((40, 40), (0.0, 0.0), 1.0, symbols.PAPER)
        symbols.true_features(canvas, np.array([[20.0, 20.0]]), np.array([kind]), 8.0)
        shapes.append(pixels(canvas.picture()).tobytes())
    assert len(set(shapes)) == 3


def test_many_edges_are_paler_than_few() -> None:
    shades = []
    for copies in (1, 2000):
        canvas = Canvas((40, 40), (0.0, 0.0), 1.0, symbols.PAPER)
        symbols.covisibility(canvas, np.tile([[[0.0, 20.0], [40.0, 20.0]]], (copies, 1, 1)))
        shades.append(pixels(canvas.picture()).astype(int).min())
    assert shades[0] < shades[1] < 255


def test_provisional_landmarks_are_hollow() -> None:
    canvas = Canvas((40, 20), (0.0, 0.0), 1.0, symbols.PAPER)
    symbols.landmarks(canvas, np.array([[10.0, 10.0], [30.0, 10.0]]), np.array([False, True]), 5.0)
    picture = pixels(canvas.picture())
    assert tuple(picture[10, 10]) == symbols.MAPPED and tuple(picture[10, 30]) == symbols.PAPER
