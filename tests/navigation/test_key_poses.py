"""Key poses move with their anchors, come and go with them, and stay where they have none."""

import math

import numpy as np
import pytest

from slam_gym.geometry import compose, observe, transform
from slam_gym.navigation.key_poses import MOST_ANCHORS, KeyPoses
from slam_gym.types import NO_ID

NONE, NOTHING = np.empty(0, np.int64), np.empty((0, 2))


def everything(keys, ids, positions, tolerance=0.1, reach=6.0):
    return keys.moved(np.arange(len(keys)), ids, positions, reach, tolerance)


def field(rng, count=12, first=0):
    """Features of a map: ids, not in ascending order, and positions."""
    return rng.permutation(np.arange(first, first + count)), rng.uniform(-6, 6, (count, 2))


@pytest.mark.parametrize("seed", range(10))
def test_a_key_pose_is_taken_along_when_its_anchors_move_together(seed):
    rng = np.random.default_rng(seed)
    ids, positions = field(rng)
    keys, pose, motion = KeyPoses(), rng.uniform(-3, 3, 3), np.array([*rng.uniform(-2, 2, 2), rng.uniform(-1, 1)])
    keys.open(pose, ids[:6], ids, positions)
    assert len(everything(keys, ids, positions).rows) == 0
    moved = everything(keys, ids, transform(motion, positions))
    np.testing.assert_array_equal(moved.rows, [0])
    np.testing.assert_array_equal(moved.before[0], pose)
    expected = compose(motion, pose)
    assert np.hypot(*(moved.after[0] - expected)[:2]) < 0.05
    assert abs(math.remainder(moved.after[0, 2] - expected[2], 2 * math.pi)) < 0.02  # stiff by a little
    keys.place(moved)
    assert len(everything(keys, ids, transform(motion, positions)).rows) == 0
    np.testing.assert_array_equal(keys.drawn_last(np.array([0])), moved.after)


def test_the_fit_is_the_least_squares_one_but_for_its_stiffness():
    rng = np.random.default_rng(1)
    ids, positions = field(rng, 8)
    keys, pose = KeyPoses(), np.array([1.0, 2.0, 0.5])
    keys.open(pose, ids, ids, positions)
    there = transform(np.array([0.5, -0.2, 0.3]), positions) + rng.normal(0, 0.1, (8, 2))
    found = everything(keys, ids, there).after[0]

    def cost(at):
        return ((transform(at, observe(pose, positions)) - there) ** 2).sum() + 1.0 - math.cos(at[2] - pose[2])

    for nudge in rng.normal(0, 0.01, (50, 3)):
        assert cost(found) < cost(found + nudge)


def test_one_anchor_shifts_and_does_not_turn():
    keys, ids = KeyPoses(), np.array([7])
    keys.open(np.array([0.0, 0.0, 1.0]), ids, ids, np.array([[2.0, 1.0]]))
    moved = everything(keys, ids, np.array([[2.5, 0.0]]))
    np.testing.assert_allclose(moved.after, [[0.5, -1.0, 1.0]], atol=1e-12)


def test_small_motions_are_none_and_a_turn_counts_by_the_length_of_the_beams():
    rng = np.random.default_rng(2)
    ids, positions = field(rng)
    keys = KeyPoses()
    keys.open(np.zeros(3), ids, ids, positions)
    shifted, turned = positions + np.array([0.09, 0.0]), transform(np.array([0.0, 0.0, 0.02]), positions)
    assert len(everything(keys, ids, shifted).rows) == 0 and len(everything(keys, ids, turned).rows) == 0
    assert len(everything(keys, ids, shifted, tolerance=0.08).rows) == 1
    assert len(everything(keys, ids, turned, reach=20.0).rows) == 1


def test_a_key_pose_without_its_anchors_is_gone_until_one_comes_back():
    rng = np.random.default_rng(3)
    ids, positions = field(rng)
    keys, pose = KeyPoses(), np.array([1.0, 0.0, 0.0])
    keys.open(pose, ids[:4], ids, positions)
    for others in (ids[4:], NONE):
        moved = everything(keys, others, positions[: len(others)])
        assert np.isnan(moved.after).all() and np.array_equal(moved.before[0], pose)
    keys.place(moved)
    assert not keys.drawn.any() and len(everything(keys, ids[4:], positions[4:]).rows) == 0
    back = everything(keys, ids[3:], positions[3:] + np.array([2.0, 0.0]))
    assert np.isnan(back.before).all()
    np.testing.assert_allclose(back.after, [[3.0, 0.0, 0.0]], atol=1e-12)
    keys.place(back)
    assert keys.drawn.all()


def test_a_key_pose_that_never_had_an_anchor_stays():
    keys = KeyPoses()
    keys.open(np.ones(3), np.array([NO_ID]), NONE, NOTHING)
    assert len(everything(keys, NONE, NOTHING).rows) == 0
    assert len(everything(keys, *field(np.random.default_rng(0))).rows) == 0


def test_who_sees_little_hangs_on_what_the_one_before_saw():
    rng = np.random.default_rng(4)
    ids, positions = field(rng)
    keys = KeyPoses()
    keys.open(np.zeros(3), ids[:5], ids, positions)
    keys.open(np.array([3.0, 0.0, 0.0]), np.array([NO_ID, ids[7]]), ids, positions)
    turn = np.array([0.0, 0.0, 0.5])
    moved = everything(keys, ids[:5], transform(turn, positions[:5]))  # without the one feature of its own
    np.testing.assert_allclose(moved.after[1, :2], [3 * math.cos(0.5), 3 * math.sin(0.5)], atol=0.1)


def test_what_is_seen_from_its_end_anchors_a_key_pose_as_well():
    rng = np.random.default_rng(5)
    ids, positions = field(rng)
    keys = KeyPoses()
    keys.open(np.zeros(3), ids[:4], ids, positions)
    keys.open(np.array([0.5, 0.0, 0.0]), ids[4:8], ids, positions)
    moved = everything(keys, ids[4:8], positions[4:8] + np.array([0.0, 1.0]))
    np.testing.assert_allclose(moved.after, [[0.0, 1.0, 0.0], [0.5, 1.0, 0.0]], atol=1e-9)


def test_anchors_and_key_poses_are_as_many_as_one_likes():
    rng = np.random.default_rng(6)
    ids, positions = field(rng, 3 * MOST_ANCHORS)
    keys = KeyPoses()
    for k in range(100):
        keys.open(np.array([0.1 * k, 0.0, 0.0]), ids, ids, positions)
    moved = everything(keys, ids, positions + np.array([0.0, 0.3]))
    np.testing.assert_allclose(moved.after, moved.before + np.array([0.0, 0.3, 0.0]), atol=1e-9)
    assert len(keys) == len(moved.rows) == 100


def test_features_that_become_one_anchor_what_either_did():
    rng = np.random.default_rng(7)
    ids, positions = field(rng)
    keys, younger = KeyPoses(), ids[:6]
    keys.open(np.zeros(3), younger, ids, positions)
    keys.fuse(np.column_stack([ids[6:], younger]))
    turned = transform(
        np.array([1.0, 0.0, 0.4]), positions[:6]
    )  # the older ones are where the younger should have been
    moved = everything(keys, ids[6:], turned)
    np.testing.assert_allclose(moved.after, [[1.0, 0.0, 0.4]], atol=0.05)
