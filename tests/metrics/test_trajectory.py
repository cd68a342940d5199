"""Trajectory errors: invariances, closed forms, and what each of the two does not see."""

import math

import numpy as np
import pytest

from slam_gym.geometry import compose
from slam_gym.metrics.trajectory import ate, rpe


def walk(rng, t=50):
    poses = [rng.uniform(-3, 3, 3)]
    for _ in range(t - 1):
        poses.append(compose(poses[-1], rng.normal([0.3, 0.0, 0.0], [0.1, 0.05, 0.4])))
    return np.array(poses)


def moved(pose, poses):
    return np.array([compose(pose, p) for p in poses])


@pytest.mark.parametrize("seed", range(10))
def test_a_rigidly_moved_trajectory_has_no_error_but_the_raw_one(seed):
    true = walk(np.random.default_rng(seed))
    estimated = moved(np.array([1.0, -2.0, 2.5]), true)
    assert ate(estimated, true, aligned=True) == pytest.approx(0.0, abs=1e-12)
    assert ate(estimated, true) > 0.5
    for delta in (1, 7):
        error = rpe(estimated, true, delta=delta)
        assert error.translation == pytest.approx(0.0, abs=1e-12) and error.rotation == pytest.approx(0.0, abs=1e-12)


def test_absolute_error_of_a_constant_offset():
    true = walk(np.random.default_rng(3))
    assert ate(true + np.array([0.3, 0.4, 1.0]), true) == pytest.approx(0.5)  # positions only
    assert ate(true[:, :2] + np.array([0.3, 0.4]), true[:, :2]) == pytest.approx(0.5)


def test_rpe_of_a_biased_odometer():
    step, true_step = np.array([1.1, 0.0, 0.02]), np.array([1.0, 0.0, 0.0])
    estimated, true = [np.zeros(3)], [np.zeros(3)]
    for _ in range(30):
        estimated.append(compose(estimated[-1], step))
        true.append(compose(true[-1], true_step))
    error = rpe(np.array(estimated), np.array(true))
    assert error.translation == pytest.approx(0.1) and error.rotation == pytest.approx(0.02)
    assert rpe(np.array(estimated), np.array(true), delta=10).rotation == pytest.approx(0.2)


def test_too_short_and_malformed():
    assert math.isnan(ate(np.empty((0, 3)), np.empty((0, 3))))
    assert math.isnan(rpe(np.zeros((2, 3)), np.zeros((2, 3)), delta=2).rotation)
    with pytest.raises(ValueError, match="one shape"):
        ate(np.zeros((4, 3)), np.zeros((5, 3)))
    with pytest.raises(ValueError, match=r"\(t, 3\)"):
        rpe(np.zeros((4, 2)), np.zeros((4, 2)))
    with pytest.raises(ValueError, match="finite"):
        rpe(np.full((4, 3), np.nan), np.zeros((4, 3)))
    with pytest.raises(ValueError, match="delta"):
        rpe(np.zeros((4, 3)), np.zeros((4, 3)), delta=0)
