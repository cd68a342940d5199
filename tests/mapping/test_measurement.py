"""What the map expects to measure, and what it tells of the heading, against the definitions."""

import math

import numpy as np
import pytest

from slam_gym.geometry import observe_jacobians
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.types import UNPAIRED, Odometry, Scan
from tests.mapping.small_maps import FEJ, h, mapped, numerical
from tests.oracles.map import make_scan


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


def test_prediction_is_first_order_propagation_of_h() -> None:
    m, _, _ = mapped()
    prediction = m.prediction(100.0)
    assert len(prediction) == m.n
    H = numerical(lambda x: h(x, prediction.features), m.mean)
    expected = H @ m.covariance @ H.T
    np.testing.assert_allclose(prediction.positions.ravel(), h(m.mean, prediction.features), atol=1e-12)
    joint = prediction.joint(np.arange(m.n))
    np.testing.assert_allclose(joint, expected, rtol=0, atol=1e-9)
    for j, marginal in enumerate(prediction.covariances):
        np.testing.assert_allclose(marginal, expected[2 * j : 2 * j + 2, 2 * j : 2 * j + 2], rtol=0, atol=1e-9)


def test_reach_is_widened_by_three_sigma() -> None:
    m = StochasticMap()
    points = np.array([[4.9, 0.0], [5.2, 0.0], [0.0, 5.2], [-5.2, 0.0], [20.0, 0.0]])
    R = np.array([np.eye(2) * 0.01**2, np.eye(2) * 0.05**2, np.diag([0.01, 0.1]) ** 2, *[np.eye(2) * 0.08**2] * 2])
    m.add(make_scan(points, R), np.arange(5))
    prediction = m.prediction(5.0)
    np.testing.assert_array_equal(prediction.features, [0, 2, 3])
    np.testing.assert_allclose(prediction.positions, points[[0, 2, 3]])
    np.testing.assert_allclose(prediction.covariances, R[[0, 2, 3]])


def test_joint_of_any_rows_in_any_order() -> None:
    m, _, _ = mapped(FEJ)
    prediction = m.prediction(100.0)
    whole = prediction.joint(np.arange(len(prediction)))
    rows = np.array([6, 0, 6, 3])
    entries = np.column_stack([2 * rows, 2 * rows + 1]).ravel()
    np.testing.assert_allclose(prediction.joint(rows), whole[np.ix_(entries, entries)], rtol=0, atol=1e-15)
    np.testing.assert_array_equal(whole, whole.T)
