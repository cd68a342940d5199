"""The constructors from users' arrays: what they make, and how they refuse what does not fit."""

from dataclasses import replace

import numpy as np
import pytest

from slam_gym.types import UNKNOWN_KIND, Landmarks, Odometry, Prediction, Scan


def test_a_scan_from_points_knows_nothing_of_sizes_and_kinds() -> None:
    scan = Scan.from_points([[1, 2], [3, 4]], sigma=0.1)
    np.testing.assert_array_equal(scan.covariances, np.tile(0.1**2 * np.eye(2), (2, 1, 1)))
    assert np.isnan(scan.sizes).all() and (scan.kinds == UNKNOWN_KIND).all()
    assert len(Scan.from_points([], sigma=0.1)) == 0


def test_a_polar_scan_has_the_covariance_of_its_linearisation() -> None:
    rng = np.random.default_rng(0)
    r, beta, sigma_r, sigma_beta = np.array([4.0, 7.0]), np.array([0.6, -2.0]), 0.05, 0.01
    scan = Scan.from_polar(r, beta, sigma_r, sigma_beta)
    np.testing.assert_allclose(scan.points, np.column_stack([r * np.cos(beta), r * np.sin(beta)]))
    drawn_r = r + sigma_r * rng.standard_normal((200_000, 2))
    drawn_beta = beta + sigma_beta * rng.standard_normal((200_000, 2))
    for i in range(2):
        x, y = drawn_r[:, i] * np.cos(drawn_beta[:, i]), drawn_r[:, i] * np.sin(drawn_beta[:, i])
        np.testing.assert_allclose(scan.covariances[i], np.cov(x, y), rtol=0.03, atol=2e-5)


def test_what_is_made_does_not_share_memory_with_what_was_given() -> None:
    points, covariance = np.ones((2, 2)), np.eye(4)
    scan, prediction = Scan.from_points(points, np.eye(2)), Prediction.from_gaussian(points, covariance)
    points[:], covariance[:] = 7.0, 7.0
    assert (scan.points == 1).all() and (prediction.positions == 1).all()
    np.testing.assert_array_equal(prediction.joint(np.array([1, 0])), np.eye(4))


def test_marginals_are_the_blocks_of_a_joint_covariance() -> None:
    A = np.random.default_rng(1).standard_normal((6, 6))
    P = A @ A.T
    prediction = Prediction.from_gaussian(np.zeros((3, 2)), P)
    landmarks = Landmarks.from_points(np.zeros((3, 2)), covariance=P)
    for j in range(3):
        block = P[2 * j : 2 * j + 2, 2 * j : 2 * j + 2]
        np.testing.assert_array_equal(prediction.covariances[j], block)
        np.testing.assert_array_equal(landmarks.covariances[j], block)
    np.testing.assert_array_equal(prediction.joint(np.array([2])), P[4:, 4:])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Scan.from_points([[1, 2, 3]], sigma=0.1), r"points: shape \(1, 3\), expected \(m, 2\)"),
        (lambda: Scan.from_points([1, 2], sigma=0.1), r"points: shape \(2,\)"),
        (lambda: Scan.from_points([["a", 2]], sigma=0.1), "points: expected numbers"),
        (lambda: Scan.from_points([[1, 2]]), "exactly one"),
        (lambda: Scan.from_points([[1, 2]], np.eye(2), sigma=0.1), "exactly one"),
        (lambda: Scan.from_points([[1, 2]], [0.1]), r"covariances: shape \(1,\), expected \(1, 2, 2\)"),
        (lambda: Scan.from_points([[1, 2]], sigma=[0.1, 0.2]), "sigma: shape"),
        (lambda: Scan.from_points([[1, 2]], sigma=0.1, sizes=[1]), "both or neither"),
        (lambda: Scan.from_points([[1, 2]], sigma=0.1, kinds=[0.5]), "kinds: float64"),
        (lambda: Scan.from_polar([1, 2], [0.1], 0.1, 0.1), "bearings: shape"),
        (lambda: Prediction.from_gaussian([[1, 2]], np.eye(3)), r"covariance: shape \(3, 3\), expected \(2, 2\)"),
        (lambda: Landmarks.from_points([[1, 2]], sigma=0.1, covariance=np.eye(2)), "exactly one of the three"),
        (lambda: Odometry.from_motion([1, 0], 0.1), r"motion: shape \(2,\), expected \(3,\)"),
        (lambda: Odometry.from_motion([1, 0, 0], [0.1, 0.1]), "sigmas"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(make, message) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def test_some_rows_of_a_prediction_are_those_of_all() -> None:
    P = np.diag(np.arange(1.0, 9.0))
    whole = Prediction.from_gaussian([[0, 0], [1, 0], [2, 0], [3, 0]], P)
    whole = replace(whole, local=lambda rows: np.subtract.outer(rows, rows) % 2 == 0)
    some = whole.rows(np.array([1, 3]))
    assert some.features.tolist() == [1, 3] and len(some) == 2
    np.testing.assert_array_equal(some.positions, [[1, 0], [3, 0]])
    np.testing.assert_array_equal(some.joint(np.array([1, 0])), np.diag([7.0, 8.0, 3.0, 4.0]))
    assert some.local is not None and some.local(np.array([0, 1])).all()
