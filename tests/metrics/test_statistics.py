"""Interquartile mean against scipy, bootstrap intervals by their coverage."""

import math

import numpy as np
import pytest
from scipy.stats import trim_mean

from slam_gym.metrics.consistency import anees, nees, pose_nees
from slam_gym.metrics.statistics import bootstrap_interval, interquartile_mean
from tests.oracles.statistics import random_covariance


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 7, 30, 101])
def test_interquartile_mean_is_the_trimmed_mean(n):
    values = np.random.default_rng(n).standard_cauchy((6, n))
    np.testing.assert_allclose(interquartile_mean(values), trim_mean(values, 0.25, axis=1))
    assert interquartile_mean(values[0]) == pytest.approx(trim_mean(values[0], 0.25))


def test_interval_covers_the_true_value_about_as_often_as_it_says():
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(300):
        interval = bootstrap_interval(rng.normal(3.0, 1.0, 40), rng, resamples=400)
        assert interval.low <= interval.estimate <= interval.high
        hits += interval.low <= 3.0 <= interval.high
    assert 0.90 < hits / 300 < 0.985


def test_bad_values_are_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="no values"):
        interquartile_mean(np.empty(0))
    with pytest.raises(ValueError, match="NaN"):
        interquartile_mean(np.array([1.0, math.nan]))
    for bad in (np.empty(0), np.array([1.0, np.nan]), np.zeros((2, 2))):
        with pytest.raises(ValueError, match="finite values"):
            bootstrap_interval(bad, rng)


# --- NEES against the textbook inverse, and the degenerate covariances of a first pose -------------------------------


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


def test_the_average_is_that_of_one_degree_of_freedom():
    assert anees(np.array([1.5, 3.0, 9.0]), 3) == pytest.approx(1.5)
    assert math.isnan(anees(np.empty(0), 3))
