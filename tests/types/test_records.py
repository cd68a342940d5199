"""Records from users' arrays: what they are, what they say of themselves, and how they refuse what does not fit."""

from dataclasses import replace

import numpy as np
import pytest

from slam_gym.association.prediction import Prediction
from slam_gym.types import UNKNOWN_KIND, UNPAIRED, Effort, Landmarks, Odometry, Relocation, Scan


def test_a_scan_from_points_knows_nothing_of_sizes_and_kinds() -> None:
    scan = Scan.from_points([[1, 2], [3, 4]], sigma=0.1)
    np.testing.assert_array_equal(scan.covariances, np.tile(0.1**2 * np.eye(2), (2, 1, 1)))
    assert np.isnan(scan.sizes).all() and (scan.kinds == UNKNOWN_KIND).all()
    for nothing in ([], (), np.empty(0), np.empty((0, 2))):
        assert Scan.from_points(nothing, sigma=0.1).covariances.shape == (0, 2, 2)


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


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.int32, list])
def test_a_scan_is_made_of_fresh_doubles_by_rows_whatever_it_is_made_from(kind) -> None:
    """Compiled functions would be compiled anew for another order."""
    points, one = np.array([[1, 3], [2, 4]], np.int32 if kind is list else kind).T, np.array([[2.0, 0.5], [0.5, 1.0]])
    scan = Scan.from_points(points.tolist() if kind is list else points, one)
    assert scan.points.tolist() == [[1.0, 2.0], [3.0, 4.0]] and scan.points.dtype == np.float64
    assert scan.points.flags.c_contiguous and not np.shares_memory(scan.points, points)
    np.testing.assert_array_equal(scan.covariances, [one, one])
    scan.covariances[0] = 0.0  # each its own
    assert (scan.covariances[1] == one).all() and one[0, 0] == 2.0
    fortran = np.asfortranarray(np.tile(np.eye(2), (2, 1, 1)))
    assert Scan.from_points(points, fortran).covariances.flags.c_contiguous


def test_sigmas_sizes_and_kinds_are_for_each() -> None:
    scan = Scan.from_points(np.zeros((2, 2)), sigma=[0.5, 2.0], sizes=[0.3, np.nan], size_sigma=0.1, kinds=[3, -2])
    np.testing.assert_array_equal(scan.covariances, [0.25 * np.eye(2), 4.0 * np.eye(2)])
    np.testing.assert_array_equal(scan.sizes, [0.3, np.nan])
    np.testing.assert_allclose(scan.size_variances, [0.01, np.nan])
    assert scan.kinds.dtype == np.int64 and scan.kinds.tolist() == [3, UNKNOWN_KIND]
    assert Scan.from_points([], sigma=0.1, kinds=[]).kinds.dtype == np.int64


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Scan.from_points([[1, 2, 3]], sigma=0.1), r"points: shape \(1, 3\), expected \(m, 2\)"),
        (lambda: Scan.from_points([1, 2], sigma=0.1), r"points: shape \(2,\)"),
        (lambda: Scan.from_points([["a", 2]], sigma=0.1), "points: expected numbers"),
        (lambda: Scan.from_points(np.ma.masked_equal([[1, 2]], 2), sigma=0.1), "points: MaskedArray"),
        (lambda: Scan.from_points(np.array([[1, 2j]]), sigma=0.1), "points: complex numbers"),
        (lambda: Scan.from_points([[1, 2]], sigma=np.ma.masked_equal([1], 1)), "sigma: MaskedArray"),
        (lambda: Scan(*(np.matrix(part) for part in Scan.from_points([[1, 2]], sigma=1).arrays)), "points: matrix"),
        (lambda: Scan.from_points([[1, 2]]), "exactly one"),
        (lambda: Scan.from_points([[1, 2]], np.eye(2), sigma=0.1), "exactly one"),
        (lambda: Scan.from_points([[1, 2]], [0.1]), r"covariances: shape \(1,\), expected \(1, 2, 2\)"),
        (lambda: Scan.from_points([[1, 2]], sigma=[0.1, 0.2]), "sigma: shape"),
        (lambda: Scan.from_points([[1, 2], [3]], sigma=0.1), "points: expected numbers"),
        (lambda: Scan.from_points([[1, 2]], sigma=0.1, sizes=[1]), "both or neither"),
        (lambda: Scan.from_points([[1, 2]], sigma=0.1, size_sigma=1), "both or neither"),
        (lambda: Scan.from_points([[1, 2]], sigma=0.1, sizes=[1, 2], size_sigma=1), r"sizes: shape \(2,\)"),
        (lambda: Scan.from_points([[1, 2]], sigma=0.1, sizes=[1], size_sigma=[1, 2]), r"size_sigma: shape \(2,\)"),
        (lambda: Scan.from_points([[1, 2]], sigma=0.1, kinds=[1, 2]), r"kinds: .* expected \(1,\) integers"),
        (lambda: Scan.from_points([[1, 2]], sigma=0.1, kinds=["door"]), r"kinds: .* expected \(1,\) integers"),
        (lambda: Scan.from_points([[1, 2]], sigma=0.1, kinds=[0.5]), "kinds: float64"),
        (lambda: Scan.from_points([[1, 2]], sigma=0.1, kinds=[-1]), "kinds: -1, expected .* or -2"),
        (lambda: Scan.from_polar([1, 2], [0.1], 0.1, 0.1), "bearings: shape"),
        (lambda: Odometry.from_motion([1, 0], 0.1), r"motion: shape \(2,\), expected \(3,\)"),
        (lambda: Odometry.from_motion([1, 0, 0], [0.1, 0.1]), "sigmas"),
        (lambda: Odometry.from_motion([1, 0, 90], 0.1), r"motion\[2\]: 90 rad .* degrees"),
        (lambda: Odometry.from_motion([1, 0, 0], [0.1, -0.1, 0.1]), "sigmas: -0.1 is negative"),
        (lambda: Scan.from_polar([1, 2], [0.1, -45], 0.1, 0.1), "bearings: -45 rad .* degrees"),
        (lambda: Scan.from_polar([1, -2], [0.1, 0.2], 0.1, 0.1), "ranges: -2 m is negative"),
        (lambda: Scan.from_polar([1], [0.1], 0.1, -0.1), "bearing_sigma: -0.1 is negative"),
        (lambda: Scan.from_points([[1, 2]], sigma=-0.1), "sigma: -0.1 is negative"),
        (lambda: Scan.from_points([[1, 2]], sigma=0.1, sizes=[1], size_sigma=-1), "size_sigma: -1 is negative"),
        (lambda: Prediction.from_gaussian([[1, 2]], np.eye(3)), r"covariance: shape \(3, 3\), expected \(2, 2\)"),
        (lambda: Landmarks.from_points([[1, 2]], sigma=0.1, covariance=np.eye(2)), "exactly one of the three"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(make, message) -> None:
    with pytest.raises(ValueError, match=message):
        make()


FEATURES = np.array([4, UNPAIRED, 0, 7])


def test_a_relocation_needs_enough_pairings_at_one_pose_only() -> None:
    found = Relocation(FEATURES, np.zeros(3), np.eye(3), 1.0, 3, 3, ambiguous=False, ties=0, effort=Effort())
    assert found.accepted
    assert not replace(found, min_pairings=4).accepted and not replace(found, ambiguous=True).accepted


def test_a_prediction_does_not_share_memory_with_what_it_is_made_of() -> None:
    points, covariance = np.ones((2, 2)), np.eye(4)
    prediction = Prediction.from_gaussian(points, covariance)
    points[:], covariance[:] = 7.0, 7.0
    assert (prediction.positions == 1).all()
    np.testing.assert_array_equal(prediction.joint(np.array([1, 0])), np.eye(4))


def test_marginals_are_the_blocks_of_a_joint_covariance() -> None:
    A = np.random.default_rng(1).standard_normal((6, 6))
    P = A @ A.T
    prediction = Prediction.from_gaussian(np.zeros((3, 2)), P)
    for told in (Landmarks.from_points(np.zeros((3, 2)), covariance=P), prediction):
        for j in range(3):
            np.testing.assert_array_equal(told.covariances[j], P[2 * j : 2 * j + 2, 2 * j : 2 * j + 2])
    np.testing.assert_array_equal(prediction.joint(np.array([2])), P[4:, 4:])
