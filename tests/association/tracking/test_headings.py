"""The parts of a prediction against samples of the robot that it is about."""

import math

import numpy as np
import pytest

from slam_gym.association.prediction import Expected, Prediction, predict
from slam_gym.association.tracking.headings import NARROW, joint_in, parts_of
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.types import Odometry, Scan


def predicted(turn_sigma, second_order=False):
    """From a robot that has turned, over features that it knows a little."""
    map_ = StochasticMap(MapSpec(second_order=second_order))
    map_.add(Scan.from_points([[5.0, 1.0], [4.0, -3.0], [-2.0, 3.0]], sigma=0.1), np.arange(3))
    map_.predict(Odometry.from_motion([0.3, 0.0, 0.4], [0.05, 0.02, turn_sigma]))
    return map_, predict(map_, 20.0)


def headings(prediction):
    """The expected features, and the parts of their mixture."""
    expected = Expected(*prediction.arrays)
    return expected, list(parts_of(expected))


def test_a_heading_that_is_well_known_is_left_as_it_is():
    assert len(headings(Prediction.from_gaussian([[1.0, 2.0]], np.eye(2)))[1]) == 1
    _, prediction = predicted(0.01)
    _, (part,) = headings(prediction)
    assert part.log_weight == 0.0
    np.testing.assert_array_equal(part.positions, prediction.positions)


@pytest.mark.parametrize(("second_order", "off"), [(False, 0.05), (True, 0.2)])
@pytest.mark.parametrize("sigma", [0.12, 0.2, 0.3])
def test_the_parts_together_are_where_the_features_are_seen_from(sigma, second_order, off):
    """Mean and covariance of all features, by the rotation itself; of second order, they count the bend twice."""
    map_, prediction = predicted(sigma, second_order)
    true_mean, truth = sampled(map_)
    mean, covariance = moments(*headings(prediction))
    scale, error = math.sqrt(truth.max()), np.abs(mean - true_mean).max()
    assert error < off * scale
    assert second_order or error < 0.5 * np.abs(prediction.positions.ravel() - true_mean).max()
    assert covariance == pytest.approx(truth, abs=max(off, 0.1) * scale**2)


def sampled(map_, draws=200_000):
    """Mean (2k,) and covariance (2k, 2k) of all features in R, by the rotation itself."""
    rng, n = np.random.default_rng(0), map_.n
    states = rng.multivariate_normal(np.concatenate([map_.pose, map_.positions.ravel()]), map_.covariance, draws)
    c, s = np.cos(states[:, 2, None]), np.sin(states[:, 2, None])
    x, y = states[:, 3::2] - states[:, :1], states[:, 4::2] - states[:, 1:2]
    seen = np.stack([c * x + s * y, c * y - s * x], axis=2).reshape(draws, 2 * n)
    return seen.mean(axis=0), np.cov(seen.T)


def moments(expected, parts):
    """Mean (2k,) and covariance (2k, 2k) of a mixture."""
    weights, every = np.exp([part.log_weight for part in parts]), np.arange(len(parts[0].positions))
    assert weights.sum() == pytest.approx(1.0)
    means = np.array([part.positions.ravel() for part in parts])
    second = sum(
        w * (joint_in(expected, part, every) + np.outer(m, m)) for w, m, part in zip(weights, means, parts, strict=True)
    )
    return weights @ means, second - np.outer(weights @ means, weights @ means)


def test_the_covariance_of_a_part_is_one():
    expected, parts = headings(predicted(0.2)[1])
    for part in parts:
        whole = joint_in(expected, part, np.arange(3))
        assert (np.linalg.eigvalsh(whole) > 0.0).all() and part.variance == pytest.approx(NARROW**2)
        assert joint_in(expected, part, np.array([2, 0])) == pytest.approx(whole[np.ix_([4, 5, 0, 1], [4, 5, 0, 1])])
        for j in range(3):
            assert part.covariances[j] == pytest.approx(whole[2 * j : 2 * j + 2, 2 * j : 2 * j + 2])


def test_a_heading_that_nobody_knows_is_not_split_for_ever():
    assert len(headings(predicted(3.0)[1])[1]) <= 11
