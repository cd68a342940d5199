"""Pure pursuit: turns first, slows down, rests, and keeps its limits."""

import math

import numpy as np
import pytest

from slam_gym.navigation.polyline import length_left
from slam_gym.navigation.pursuit import PursuitSpec, follow, steer


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


def test_a_tick_of_driving_asks_for_speeds_and_how_far_it_is():
    rng = np.random.default_rng(1)
    for _ in range(20):
        path, pose, goal = (
            rng.uniform(0.0, 9.0, (rng.integers(2, 9), 2)),
            rng.uniform(0.0, 6.0, 3),
            rng.uniform(0, 9, 2),
        )
        left, gap, forward, turn = steer(pose, path, goal, tuple(PursuitSpec()))
        assert (forward, turn) == follow(pose, path) and left == length_left(path, pose[:2])
        assert gap == pytest.approx(math.dist(goal, pose[:2]))
