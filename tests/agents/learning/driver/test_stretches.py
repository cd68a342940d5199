"""Stretches of a path: their length, what they cost, and what is in sight at the end of each."""

import math

import numpy as np
import pytest

from agents.learning.driver.stretches import FREE_TURN, SPEED, STRETCH, TURN, Surroundings, drive_along, look
from slam_gym.geometry import compose
from slam_gym.world.ray_casting import WallIndex

WALLS = np.array([[-5.0, -5.0, 15.0, -5.0], [15.0, -5.0, 15.0, 5.0], [15.0, 5.0, -5.0, 5.0], [-5.0, 5.0, -5.0, -5.0],
                  [4.0, 0.5, 4.0, 5.0]])  # fmt: skip
FEATURES = np.array([[3.0, 0.0], [5.0, 3.0], [-3.0, 0.0], [12.0, 0.0]])  # ahead, behind a wall, behind, far away
BASE, HERE, GOAL = np.array([1.0, -0.5, 0.3]), np.zeros(3), np.array([2.0, 0.0])


@pytest.fixture(scope="module")
def around():
    bearings = np.linspace(-math.pi, math.pi, 40, endpoint=False)
    seen = FEATURES.copy()
    return Surroundings(WallIndex(WALLS).packed, seen, np.full(4, 1e-3), np.zeros(3), 0.1, 6.0, 2.0, bearings, 6.0)


def driven(around, path, count, arrived=0.0, ticks=1000, here=HERE):
    sighted = np.zeros(len(FEATURES), np.int64)
    return drive_along(around, here, np.asarray(path, float), count, arrived, ticks, sighted), sighted


def test_a_look_sees_what_is_near_ahead_and_not_hidden(around):
    sighted = np.zeros(4, np.int64)
    ranges = look(around, HERE, sighted)
    assert list(sighted) == [1, 0, 0, 0]
    assert np.array_equal(ranges, WallIndex(WALLS).cast(np.zeros(2), around.bearings, 6.0))
    look(around, np.array([0.0, 0.0, math.pi]), sighted)
    assert list(sighted) == [1, 0, 1, 0]


def test_poses_are_in_the_frame_of_the_start(around):
    moved = around._replace(base=BASE)
    one, two = (np.zeros(4, np.int64) for _ in range(2))
    there = np.array([0.7, 0.4, -1.0])
    assert np.allclose(look(moved, there, one), look(around, compose(BASE, there), two), atol=1e-9)
    assert np.array_equal(one, two)


def test_stretches_are_of_one_length_and_end_where_the_path_does(around):
    found, sighted = driven(around, [HERE[:2], GOAL], 100)
    steps = np.diff(np.concatenate([np.zeros((1, 2)), found.poses[:, :2]]), axis=0)
    assert np.allclose(np.hypot(*steps[:-1].T), STRETCH * SPEED) and np.allclose(found.poses[-1, :2], GOAL)
    assert found.ticks == STRETCH * len(found.poses) and found.passed == 2 and sighted[0] > 1
    assert len(driven(around, [HERE[:2], GOAL], 100, arrived=0.5)[0].poses) < len(found.poses)
    assert len(driven(around, [HERE[:2], GOAL], 100, ticks=9)[0].poses) == 3


def test_turns_take_time(around):
    path = [HERE[:2], [0.5, 0.0], [0.5, 2.0]]
    found, _ = driven(around, path, 100)
    straight = STRETCH * len(found.poses)
    assert found.ticks - straight == round(TURN * (0.5 * math.pi - FREE_TURN)) and found.poses[-1, 2] == 0.5 * math.pi


def test_a_few_at_a_time_come_to_the_same(around):
    path = np.array([HERE[:2], [0.5, 0.3], [1.0, -0.8], [2.0, 0.0]])
    whole, counted = driven(around, path, 100)
    here, poses, ranges, ticks, sighted = HERE, [], [], 0, np.zeros(4, np.int64)
    while len(path) > 1:
        part, seen = driven(around, path, 2, here=here)
        here, ticks, sighted = part.poses[-1], ticks + part.ticks, sighted + seen
        path = np.concatenate([here[None, :2], path[part.passed :]])
        poses.append(part.poses)
        ranges.append(part.ranges)
    assert np.allclose(np.concatenate(poses), whole.poses) and np.allclose(np.concatenate(ranges), whole.ranges)
    assert ticks == whole.ticks and np.array_equal(sighted, counted)
