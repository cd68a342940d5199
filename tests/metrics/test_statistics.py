"""Interquartile mean against scipy, bootstrap intervals by their coverage."""

import math

import numpy as np
import pytest
from scipy.stats import chi2, trim_mean

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


def test_strata_take_the_spread_between_groups_out():
    rng = np.random.default_rng(1)
    strata = np.repeat([0, 1, 2], 20)
    values = rng.normal(0.0, 0.1, 60) + np.array([0.0, 5.0, 10.0])[strata]
    mean = lambda rows: rows.mean(axis=-1)  # noqa: E731
    plain = bootstrap_interval(values, rng, statistic=mean)
    stratified = bootstrap_interval(values, rng, statistic=mean, strata=strata)
    assert stratified.high - stratified.low < 0.1 * (plain.high - plain.low)
    assert stratified.low < values.mean() < stratified.high


def test_pairing_sees_a_difference_that_the_spread_between_seeds_hides():
    rng = np.random.default_rng(2)
    worlds = rng.normal(0.0, 1.0, 30)
    a, b = worlds + rng.normal(0.0, 0.05, 30), worlds + 0.2 + rng.normal(0.0, 0.05, 30)
    difference = bootstrap_interval(a - b, rng)
    assert difference.high < 0.0 and difference.low < -0.2 < difference.high
    assert bootstrap_interval(a, rng).high > bootstrap_interval(b, rng).low


def test_bad_values_are_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="no values"):
        interquartile_mean(np.empty(0))
    for bad in (np.empty(0), np.array([1.0, np.nan]), np.zeros((2, 2))):
        with pytest.raises(ValueError, match="finite values"):
            bootstrap_interval(bad, rng)


# --- NEES against the textbook inverse, its χ² law by Monte Carlo, and the degenerate covariances of a first pose -----


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
