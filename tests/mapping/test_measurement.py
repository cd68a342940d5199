"""What a prediction tells of the heading, against the definition."""

import math

import numpy as np
import pytest

from slam_gym.geometry import observe_jacobians
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.types import UNPAIRED, Odometry, Scan


def driven_map(seed, n=12, fej=False):
    """A map after a drive of ten steps past n features, half of them measured at each."""
    rng = np.random.default_rng(seed)
    slam = StochasticMap(MapSpec(first_estimate_jacobians=fej), [1.0, 2.0, 0.7], np.diag([0.01, 0.02, 0.003]))
    points = rng.uniform(-5.0, 5.0, (n, 2))
    slam.add(Scan.from_points(points, sigma=0.1), np.arange(n))
    for _ in range(10):
        motion = np.array([0.5, 0.0, rng.uniform(-0.5, 0.5)])
        slam.predict(Odometry(motion, np.diag([0.01, 0.01, 0.002])))
        seen = slam.prediction(math.inf).positions + 0.1 * rng.standard_normal((n, 2))
        slam.update(Scan.from_points(seen, sigma=0.1), np.where(rng.random(n) < 0.5, np.arange(n), UNPAIRED))
    return slam, rng


@pytest.mark.parametrize("seed", range(20))
def test_heading_is_the_variance_of_the_heading_and_its_covariance_with_what_is_predicted(seed):
    slam, rng = driven_map(seed)
    prediction, rows = slam.prediction(math.inf), rng.permutation(slam.n)[:7]
    variance, across = prediction.heading_variance, prediction.heading_covariances[rows]
    P, pose = slam.covariance, slam.pose
    assert variance == pytest.approx(P[2, 2])
    for row, got in zip(rows, across):
        H, f = np.zeros((2, len(P))), 3 + 2 * int(prediction.features[row])
        H[:, :3], H[:, f : f + 2] = observe_jacobians(pose, slam.mean[f : f + 2])
        np.testing.assert_allclose(got, H @ P[:, 2], rtol=1e-9, atol=1e-12)
    joint = np.block([[prediction.joint(rows), across.reshape(-1, 1)], [across.reshape(1, -1), variance]])
    assert np.linalg.eigvalsh(joint).min() > -1e-12  # of one Gaussian


@pytest.mark.parametrize("fej", [False, True])
@pytest.mark.parametrize("seed", range(10))
def test_the_joint_covariance_holds_the_marginals_whatever_the_order(seed, fej):
    slam, rng = driven_map(seed, fej=fej)
    prediction, rows = slam.prediction(math.inf), rng.integers(0, slam.n, 9)
    joint = prediction.joint(rows)
    np.testing.assert_array_equal(joint, joint.T)
    for k, row in enumerate(rows):
        np.testing.assert_allclose(joint[2 * k : 2 * k + 2, 2 * k : 2 * k + 2], prediction.covariances[row], rtol=1e-9)
