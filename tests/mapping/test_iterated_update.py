"""The iterated update against what it iterates towards: the optimum of prior and measurements together."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from slam_gym.geometry import observe
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.types import UNPAIRED, Odometry, Scan

SIGMA = 0.05


def problem(seed: int, iterations: int, heading: float = 0.1) -> tuple[StochasticMap, Scan, np.ndarray]:
    """A map of eight features, its robot's heading poorly known, and a scan of four of them and a stranger."""
    rng = np.random.default_rng(seed)
    m = StochasticMap(MapSpec(iterations=iterations), [1.0, 2.0, 0.5], np.diag([0.05, 0.05, 0.02]) ** 2)
    bearing, distance = rng.uniform(-np.pi, np.pi, 8), rng.uniform(2.0, 6.0, 8)
    m.add(Scan.from_polar(distance, bearing, SIGMA, 0.01), np.arange(8))
    m.predict(Odometry.from_motion([0.5, 0.0, 0.3], [0.1, 0.05, heading]))
    drawn = m.mean + np.linalg.cholesky(m.covariance + 1e-12 * np.eye(19)) @ rng.standard_normal(19)
    features = np.array([0, 3, UNPAIRED, 5, 7])
    points = observe(drawn[:3], drawn[3:].reshape(-1, 2)[[0, 3, 0, 5, 7]]) + SIGMA * rng.standard_normal((5, 2))
    points[2] = 9.0
    return m, Scan.from_points(points, sigma=SIGMA), features


def optimum(m: StochasticMap, scan: Scan, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The state of least cost, by a general solver, and the covariance of the linearisation there."""
    prior, root = m.mean, np.linalg.cholesky(np.linalg.inv(m.covariance)).T
    paired = features != UNPAIRED

    def residuals(x: np.ndarray) -> np.ndarray:
        expected = observe(x[:3], x[3:].reshape(-1, 2)[features[paired]])
        return np.concatenate([root @ (x - prior), ((scan.points[paired] - expected) / SIGMA).ravel()])

    found = least_squares(residuals, prior, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    return found.x, np.linalg.inv(found.jac.T @ found.jac)


@pytest.mark.parametrize("seed", range(12))
def test_iterated_to_the_end_it_is_the_least_squares_optimum(seed: int) -> None:
    m, scan, features = problem(seed, iterations=30)
    mean, covariance = optimum(m, scan, features)
    m.update(scan, features)
    np.testing.assert_allclose(m.mean, mean, atol=2e-5)
    np.testing.assert_allclose(m.covariance, covariance, atol=2e-6)


def test_where_it_is_linear_anyway_iterating_changes_nothing() -> None:
    once, scan, features = problem(0, iterations=1, heading=1e-6)
    often, _, _ = problem(0, iterations=10, heading=1e-6)
    for m in (once, often):
        m.update(scan, features)
    np.testing.assert_allclose(often.mean, once.mean, atol=1e-3)


def test_a_few_iterations_come_closer_to_the_optimum_than_one() -> None:
    errors = {}
    for iterations in (1, 2, 4):
        off = []
        for seed in range(30):
            m, scan, features = problem(seed, iterations, heading=0.2)
            mean, _ = optimum(m, scan, features)
            m.update(scan, features)
            off.append(np.abs(m.mean - mean).max())
        errors[iterations] = np.median(off)
    assert errors[4] < 0.1 * errors[2] < 0.1 * errors[1]


def test_a_feature_paired_twice_is_measured_twice() -> None:
    m, scan, _ = problem(3, iterations=4)
    twice = np.array([0, UNPAIRED, UNPAIRED, UNPAIRED, 0])
    before = m.covariances[0]
    m.update(scan, twice)
    assert np.trace(m.covariances[0]) < np.trace(before) and np.linalg.eigvalsh(m.covariance).min() > 0.0


@pytest.mark.parametrize("settings", [{"iterations": 0}, {"iterations": 2, "first_estimate_jacobians": True}])
def test_settings_that_cannot_be_are_refused(settings) -> None:
    with pytest.raises(ValueError, match=r"MapSpec\.iterations"):
        MapSpec(**settings)
