"""Features of a map from users' arrays, and localities in compressed rows."""

import numpy as np
import pytest

from slam_gym.types import Landmarks, Locality
from tests.association.test_prediction import random_covariance


def test_marginals_are_the_blocks_of_a_joint_covariance() -> None:
    P = random_covariance(3)
    landmarks = Landmarks.from_points(np.zeros((3, 2)), covariance=P)
    for j in range(3):
        np.testing.assert_array_equal(landmarks.covariances[j], P[2 * j : 2 * j + 2, 2 * j : 2 * j + 2])


def test_one_way_of_telling_covariances_is_asked_for() -> None:
    with pytest.raises(ValueError, match="exactly one of the three"):
        Landmarks.from_points([[1, 2]], sigma=0.1, covariance=np.eye(2))


def test_a_locality_is_read_row_by_row() -> None:
    locality = Locality(np.array([0, 2, 4, 5]), np.array([0, 1, 0, 1, 2]))
    assert len(locality) == 3 and [locality.of(j).tolist() for j in range(3)] == [[0, 1], [0, 1], [2]]
