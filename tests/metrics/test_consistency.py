"""NEES against the textbook inverse, its χ² law by Monte-Carlo, and the degenerate covariances of a first pose."""

import math

import numpy as np
import pytest
from scipy.stats import chi2

from slam_gym.metrics.consistency import anees, nees, pose_nees


def random_covariance(rng, d):
    root = rng.normal(size=(d, d))
    return root @ root.T + 0.01 * np.eye(d)


@pytest.mark.parametrize("d", [1, 2, 3, 8])
def test_nees_is_the_textbook_quadratic_form(d):
    rng = np.random.default_rng(d)
    for _ in range(20):
        covariance, error = random_covariance(rng, d), rng.normal(size=d)
        assert nees(error, covariance) == pytest.approx(error @ np.linalg.inv(covariance) @ error)


def test_a_known_pose_has_no_normalised_error_until_it_is_wrong():
    nothing = np.zeros((3, 3))
    assert nees(np.zeros(3), nothing) == 0.0
    assert nees(np.array([0.0, 0.1, 0.0]), nothing) == math.inf
    along_x = np.diag([0.04, 0.0, 0.0])
    assert nees(np.array([0.2, 0.0, 0.0]), along_x) == pytest.approx(1.0)
    tied = np.array([[1.0, 1.0], [1.0, 1.0]])  # both coordinates share one error
    assert nees(np.array([2.0, 2.0]), tied) == pytest.approx(4.0)
    assert nees(np.array([2.0, 2.5]), tied) == math.inf


def test_headings_are_compared_around_the_circle():
    covariance = np.diag([1.0, 1.0, 0.01])
    value = pose_nees(np.array([0.0, 0.0, math.pi - 0.05]), covariance, np.array([1.0, 0.0, 0.05 - math.pi]))
    assert value == pytest.approx(1.0 + 1.0)


def test_the_average_of_a_consistent_filter_follows_its_law():
    rng = np.random.default_rng(0)
    covariance = random_covariance(rng, 3)
    root = np.linalg.cholesky(covariance)
    low, high = chi2.ppf([0.05, 0.95], 60) / 60
    inside = 0
    for _ in range(1000):
        values = np.array([nees(root @ rng.normal(size=3), covariance) for _ in range(20)])
        inside += low < anees(values, 3) < high
    assert 0.87 < inside / 1000 < 0.93  # three standard errors
    optimistic = np.array([nees(root @ rng.normal(size=3), covariance / 2) for _ in range(200)])
    assert anees(optimistic, 3) > chi2.ppf(0.999, 600) / 600
    assert math.isnan(anees(np.empty(0), 3))
