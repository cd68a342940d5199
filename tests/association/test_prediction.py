"""Predictions from users' arrays, and some rows of them."""

import numpy as np
import pytest

from slam_gym.association.prediction import Prediction


def random_covariance(k: int) -> np.ndarray:
    A = np.random.default_rng(1).standard_normal((2 * k, 2 * k))
    return A @ A.T


def test_a_prediction_does_not_share_memory_with_what_it_is_made_of() -> None:
    points, covariance = np.ones((2, 2)), np.eye(4)
    prediction = Prediction.from_gaussian(points, covariance)
    points[:], covariance[:] = 7.0, 7.0
    assert (prediction.positions == 1).all()
    np.testing.assert_array_equal(prediction.joint(np.array([1, 0])), np.eye(4))


def test_marginals_are_the_blocks_of_a_joint_covariance() -> None:
    P = random_covariance(3)
    prediction = Prediction.from_gaussian(np.zeros((3, 2)), P)
    for j in range(3):
        np.testing.assert_array_equal(prediction.covariances[j], P[2 * j : 2 * j + 2, 2 * j : 2 * j + 2])
    np.testing.assert_array_equal(prediction.joint(np.array([2])), P[4:, 4:])


def test_a_covariance_that_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match=r"covariance: shape \(3, 3\), expected \(2, 2\)"):
        Prediction.from_gaussian([[1, 2]], np.eye(3))
