"""What an agent sees: squashed values come back, unknown is zero, the nearest come first."""

import numpy as np
import pytest

from slam_gym.envs.observation import (
    FEATURES,
    POINT_FIELDS,
    observation_space,
    observe,
    squash,
    unsquash,
)
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.navigation.explored_grid import ExploredGrid
from slam_gym.types import Prediction, Scan

NOTHING = Scan.from_points(np.empty((0, 2)), sigma=0.1)
NOTHING_EXPECTED = Prediction.from_gaussian(np.empty((0, 2)), np.empty((0, 0)))


def observed(scan, measurements, prediction=NOTHING_EXPECTED, pose_covariance=None) -> dict:
    slam_map, grid = StochasticMap(pose_covariance=pose_covariance), ExploredGrid(np.array([-5.0, -5.0, 5.0, 5.0]))
    return observe(scan, prediction, slam_map, grid, measurements, 1.0)


def rows(vector: np.ndarray) -> np.ndarray:
    return vector.reshape(-1, len(POINT_FIELDS)).astype(float)


@pytest.mark.parametrize("scale", [0.05, 1.0, 6.0])
def test_squashed_values_come_back_and_stay_below_one(scale) -> None:
    values = np.array([-1e4, -3.0, -0.01, 0.0, 0.01, 3.0, 1e4])
    squashed = squash(values, scale)
    assert (np.abs(squashed) < 1.0).all() and (np.diff(squashed) > 0.0).all()
    np.testing.assert_allclose(unsquash(squashed, scale), values, rtol=2e-3)
    assert np.isfinite(unsquash(np.array([-1.0, 1.0], np.float32), scale)).all()


def test_a_scan_is_shown_nearest_first_and_unknown_sizes_are_zero() -> None:
    points = np.array([[4.0, 3.0], [1.0, 0.0], [0.0, -2.0]])
    covariances = np.array([np.diag([0.04, 0.01]), [[0.01, 0.005], [0.005, 0.01]], np.zeros((2, 2))])
    scan = Scan.from_points(points, covariances=covariances, sizes=[1.0, np.nan, 3.0], size_sigma=[0.1, np.nan, 0.1])
    shown = rows(observed(scan, 5)["scan"])
    np.testing.assert_array_equal(shown[:, 0], [1, 1, 1, 0, 0])
    assert not shown[3:].any()
    np.testing.assert_allclose(unsquash(shown[:3, 1:3], 6.0), points[[1, 2, 0]], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(unsquash(shown[:3, 3], 0.1), [0.1, 0.0, 0.2], rtol=1e-5)
    np.testing.assert_allclose(shown[:3, 4], [0.5, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(unsquash(shown[:3, 6], 1.0), [0.0, 3.0, 1.0], rtol=1e-5)
    assert len(rows(observed(scan, 2)["scan"])) == 2


def test_of_many_features_the_nearest_are_shown() -> None:
    points = np.random.default_rng(0).uniform(-9.0, 9.0, (FEATURES + 8, 2))
    prediction = Prediction.from_gaussian(points, 0.01 * np.eye(2 * len(points)))
    shown = rows(observed(NOTHING, 5, prediction)["features"])
    nearest = points[np.argsort(np.hypot(*points.T))[:FEATURES]]
    np.testing.assert_allclose(unsquash(shown[:, 1:3], 6.0), nearest, rtol=1e-4, atol=1e-5)


def test_uncertainty_is_in_standard_deviations() -> None:
    shown = observed(NOTHING, 5, pose_covariance=np.diag([0.04, 0.0, 0.0025]))["uncertainty"].astype(float)
    np.testing.assert_allclose(shown, [0.2 / 0.3, 0.0, 0.05 / 0.1], rtol=1e-6)


def test_goals_are_part_of_the_space_in_goal_mode_only() -> None:
    assert set(observation_space(9, None)) | {"goals"} == set(observation_space(9, (16, 8)))
    assert observation_space(9, (16, 8))["goals"].shape == (128,)
    assert observation_space(9, None)["scan"].shape == (9 * len(POINT_FIELDS),)
