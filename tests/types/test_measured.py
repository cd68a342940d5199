"""Scans and odometry from users' arrays: what they are, and how they refuse what does not fit."""

import numpy as np
import pytest

from slam_gym.types import UNKNOWN_KIND, Odometry, Scan


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


def test_a_scan_does_not_share_memory_with_what_it_is_made_of() -> None:
    points = np.ones((2, 2))
    scan = Scan.from_points(points, np.eye(2))
    points[:] = 7.0
    assert (scan.points == 1).all()


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
        (lambda: Odometry.from_motion([1, 0], 0.1), r"motion: shape \(2,\), expected \(3,\)"),
        (lambda: Odometry.from_motion([1, 0, 0], [0.1, 0.1]), "sigmas"),
        (lambda: Odometry.from_motion([1, 0, 90], 0.1), r"motion\[2\]: 90 rad .* degrees"),
        (lambda: Odometry.from_motion([1, 0, 0], [0.1, -0.1, 0.1]), "sigmas: -0.1 is negative"),
        (lambda: Scan.from_polar([1, 2], [0.1, -45], 0.1, 0.1), "bearings: -45 rad .* degrees"),
        (lambda: Scan.from_polar([1, -2], [0.1, 0.2], 0.1, 0.1), "ranges: -2 m is negative"),
        (lambda: Scan.from_polar([1], [0.1], 0.1, -0.1), "bearing_sigma: -0.1 is negative"),
        (lambda: Scan.from_points([[1, 2]], sigma=-0.1), "sigma: -0.1 is negative"),
        (lambda: Scan.from_points([[1, 2]], sigma=0.1, sizes=[1], size_sigma=-1), "size_sigma: -1 is negative"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(make, message) -> None:
    with pytest.raises(ValueError, match=message):
        make()
