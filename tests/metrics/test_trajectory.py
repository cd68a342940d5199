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
    rng = np.random.default_rng(seed)
    true = walk(rng)
    estimated = moved(np.array([1.0, -2.0, 2.5]), true)
    for error in (ate(estimated, true), rpe(estimated, true), rpe(estimated, true, delta=7)):
        assert error.translation == pytest.approx(0.0, abs=1e-12) and error.rotation == pytest.approx(0.0, abs=1e-12)
    raw = ate(estimated, true, aligned=False)
    assert raw.translation > 0.5 and raw.rotation == pytest.approx(2.5)


def test_constant_offsets():
    true = walk(np.random.default_rng(3))
    shifted = ate(true + np.array([0.3, 0.4, 0.0]), true, aligned=False)
    assert shifted.translation == pytest.approx(0.5) and shifted.rotation == pytest.approx(0.0, abs=1e-12)
    turned = ate(true + np.array([0.0, 0.0, 2 * math.pi + 0.1]), true)  # a heading bias that no alignment removes
    assert turned.translation == pytest.approx(0.0, abs=1e-12) and turned.rotation == pytest.approx(0.1)


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
    assert math.isnan(ate(np.empty((0, 3)), np.empty((0, 3))).translation)
    assert math.isnan(rpe(np.zeros((2, 3)), np.zeros((2, 3)), delta=2).rotation)
    with pytest.raises(ValueError, match=r"\(t, 3\)"):
        ate(np.zeros((4, 3)), np.zeros((5, 3)))
    with pytest.raises(ValueError, match="finite"):
        rpe(np.full((4, 3), np.nan), np.zeros((4, 3)))
    with pytest.raises(ValueError, match="delta"):
        rpe(np.zeros((4, 3)), np.zeros((4, 3)), delta=0)
