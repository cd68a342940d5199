"""Paths as lines against the same over whole arrays; pure pursuit turns first, slows down, rests, keeps its limits."""

import math

import numpy as np
import pytest

from slam_gym.navigation.pursuit import PursuitSpec, follow, next_stretch


def test_the_next_stretch_and_the_rest_make_up_the_path() -> None:
    path = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 20.0], [30.0, 20.0]])
    stretch, rest = next_stretch(path, np.array([1.0, 0.2]), 15.0)
    np.testing.assert_allclose(stretch, [[0, 0], [4, 0], [4, 12.0]])
    np.testing.assert_array_equal(rest, path[2:])
    stretch, rest = next_stretch(path, np.array([20.0, 20.1]), 15.0)
    np.testing.assert_array_equal(stretch, path[2:])
    assert len(rest) == 0


def test_follow_turns_first_slows_down_and_rests():
    path = np.array([[0.0, 0.0], [5.0, 0.0]])
    forward, turn = follow(np.array([0.0, 0.0, 0.0]), path)
    assert forward == pytest.approx(1.0) and turn == pytest.approx(0.0)
    for heading in (math.pi - 0.01, 2.0, 0.8):  # facing away: turn on the spot, the shorter way round
        assert follow(np.array([0.0, 0.0, heading]), path) == (0.0, -1.0)
        assert follow(np.array([0.0, 0.0, -heading]), path) == (0.0, 1.0)
    assert 0.0 < follow(np.array([4.9, 0.0, 0.0]), path)[0] < 0.6
    assert follow(np.array([5.0, 0.01, 1.0]), path) == (0.0, 0.0)
    assert follow(np.zeros(3), np.empty((0, 2))) == (0.0, 0.0)
    beside = follow(np.array([1.0, 0.3, 0.0]), path)
    mirrored = follow(np.array([1.0, -0.3, 0.0]), path)
    assert beside[1] < 0 and beside == pytest.approx((mirrored[0], -mirrored[1]))


def test_follow_stays_within_the_fractions_whatever_it_is_given():
    rng = np.random.default_rng(7)
    spec = PursuitSpec(max_speed=0.6, max_turn=1.0)
    for _ in range(500):
        path = rng.normal(scale=3.0, size=(rng.integers(1, 6), 2))
        path = np.repeat(path, rng.integers(1, 3), axis=0)  # stretches of no length
        forward, turn = follow(np.array([*rng.normal(scale=3.0, size=2), rng.uniform(-9, 9)]), path, spec)
        assert 0.0 <= forward <= 1.0 and -1.0 <= turn <= 1.0
