"""Walls correct the wheels as far as they tell, and no further."""

import math

import numpy as np
import pytest

from slam_gym.geometry import compose
from slam_gym.navigation.wall_compass import WallCompass
from slam_gym.types import Array, Beams, Odometry
from slam_gym.world.ray_casting import NOTHING, Packed, cast, outlines, wall_index
from tests.oracles.statistics import nees_of_each

BEARINGS = np.linspace(-math.pi, math.pi, 90, endpoint=False)
REACH, SIGMA = 20.0, 0.03
WHEELS = np.array([0.009, 0.003, 0.008])


def box(length: float, width: float) -> Packed:
    return wall_index(outlines(np.array([[0.0, 0.0, length, width, 0.0]])))


HALL, ENDLESS = box(24.0, 9.0), box(400.0, 9.0)


def sweep(walls: Packed, pose: Array, rng: np.random.Generator) -> Beams:
    ranges = cast(walls, pose[:2], pose[2] + BEARINGS, REACH, NOTHING)
    noisy = np.where(ranges < REACH, np.minimum(ranges + SIGMA * rng.standard_normal(len(ranges)), REACH), REACH)
    return Beams(BEARINGS, noisy, REACH)


def drive(walls: Packed, start: Array, motion: Array, ticks: int, seed: int) -> tuple[Array, Array, Array]:
    """Errors of the corrected motions (t, 3), their covariances (t, 3, 3) and the errors of the wheels (t, 3)."""
    rng, compass, pose = np.random.default_rng(seed), WallCompass(SIGMA), start
    compass.corrected(Odometry(np.zeros(3), np.diag(WHEELS**2)), sweep(walls, pose, rng))
    errors, covariances, drift = [], [], []
    for _ in range(ticks):
        pose = compose(pose, motion)
        noise = WHEELS * rng.standard_normal(3)
        found = compass.corrected(Odometry(motion + noise, np.diag(WHEELS**2)), sweep(walls, pose, rng))
        errors.append(found.motion - motion)
        covariances.append(found.covariance)
        drift.append(noise)
    return np.array(errors), np.array(covariances), np.array(drift)


@pytest.mark.parametrize("turn", [0.0, 0.03, -0.15])
def test_in_a_hall_the_heading_is_kept_and_what_is_claimed_holds(turn: float) -> None:
    motion = np.array([0.05 if turn == 0.0 else 0.02, 0.0, turn])
    errors, covariances, drift = drive(HALL, np.array([-5.0, 1.0, 0.1]), motion, 150, seed=1)
    assert errors[:, 2].std() < 0.35 * drift[:, 2].std()
    assert abs(errors[:, 2].sum()) < 0.03  # where the wheels are off by .1 after so many ticks, as often as not by more
    assert 0.5 < nees_of_each(errors, covariances).mean() / 3.0 < 1.2
    assert (np.linalg.eigvalsh(covariances) > 0.0).all()
    assert np.linalg.eigvalsh(np.diag(WHEELS**2) - covariances).min() > -1e-12  # it never knows less than the wheels


def test_the_way_along_a_corridor_without_ends_in_sight_remains_that_of_the_wheels() -> None:
    errors, covariances, drift = drive(ENDLESS, np.array([0.0, 1.0, 0.0]), np.array([0.1, 0.0, 0.0]), 150, seed=2)
    assert errors[:, 0] == pytest.approx(drift[:, 0], abs=2e-3)
    assert covariances[:, 0, 0] == pytest.approx(WHEELS[0] ** 2, rel=0.02)
    assert errors[:, 2].std() < 0.35 * drift[:, 2].std()
    assert 0.5 < nees_of_each(errors, covariances).mean() / 3.0 < 1.2


def test_out_of_reach_of_every_wall_the_wheels_have_the_word() -> None:
    report = Odometry(np.array([0.1, 0.01, 0.05]), np.diag(WHEELS**2))
    nothing, compass = Beams(BEARINGS, np.full(90, REACH), REACH), WallCompass(SIGMA)
    for _ in range(3):
        found = compass.corrected(report, nothing)
        assert (found.motion == report.motion).all() and (found.covariance == report.covariance).all()


def test_walls_that_cannot_be_those_before_say_nothing() -> None:
    rng, compass = np.random.default_rng(4), WallCompass(SIGMA)
    still = Odometry(np.zeros(3), np.diag(WHEELS**2))
    compass.corrected(still, sweep(HALL, np.array([-5.0, 1.0, 0.1]), rng))
    found = compass.corrected(still, sweep(HALL, np.array([-3.0, -1.0, 0.6]), rng))  # it was carried there
    assert (found.motion == 0.0).all() and (found.covariance == still.covariance).all()
