"""Decisions worked out on the spot are those of `marginal`, which asks a prediction for all of it."""

import numpy as np
import pytest

from slam_gym.association import marginal
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import Odometry, Scan
from tests.slam.test_marginal_step import sight


@pytest.mark.parametrize("seed", range(6))
def test_among_features_that_crowd_each_other(seed: int) -> None:
    """Twice as many features as can be told apart: the answer is of many hypotheses, not of one."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([1.0, -3.0], [6.0, 3.0], (12, 2))
    slam = Slam(SlamSpec(reach=12.0), sight())
    slam.map = StochasticMap(pose_covariance=np.diag([0.2, 0.2, 0.02]) ** 2)
    slam.map.add(Scan.from_points(points, sigma=0.15), np.arange(12))
    slam.map.add(Scan.from_points(points[:6] + rng.normal(0.0, 0.3, (6, 2)), sigma=0.15), np.arange(6))
    slam.covisibility.add(18)
    scan = Scan.from_points(points[3:] + rng.normal(0.0, 0.1, (9, 2)), sigma=0.1)
    expected = marginal(scan, slam.predict_features(scan))
    step = slam.step(Odometry(np.zeros(3), np.zeros((3, 3))), scan, marginal)
    found, posterior = step.hypothesis, step.hypothesis.posterior
    assert posterior is not None and expected.posterior is not None
    assert posterior.probability < 0.999
    np.testing.assert_array_equal(found.features, expected.features)
    np.testing.assert_allclose(posterior.marginals, expected.posterior.marginals, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(posterior.unpaired, expected.posterior.unpaired, rtol=0.0, atol=1e-12)
    assert posterior.log_density == pytest.approx(expected.posterior.log_density, abs=1e-9)
    assert found.joint_distance == pytest.approx(expected.joint_distance, abs=1e-9)
