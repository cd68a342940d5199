"""The equations of the filter against a textbook EKF, finite differences, and the laws an estimator keeps."""

import numpy as np
import pytest
from scipy.stats import chi2

from slam_gym.geometry import observe, transform, wrap_angle
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.types import UNPAIRED, Odometry
from tests.mapping.small_maps import KEEP, START, START_COVARIANCE, h, landmarks, mapped, smallest_over_largest
from tests.oracles.geometry import numerical, observe_jacobians, transform_jacobians
from tests.oracles.map import SIGMA, KnownAssociation, TextbookMap, make_scan, random_covariances, wander

# --- against the textbook ---------------------------------------------------------------------------------------------


def test_equals_textbook_ekf_through_growth_and_removal() -> None:
    rng = np.random.default_rng(3)
    twins = KnownAssociation(
        StochasticMap(KEEP, START, START_COVARIANCE, capacity=1),
        TextbookMap(START, START_COVARIANCE),
    )
    for number, step in enumerate(wander(rng, 120, landmarks(rng, 40), reach=4.0)):
        twins.step(step)
        if number % 20 == 19:
            gone = np.sort(rng.choice(twins.map.n, 3, replace=False))
            kept = twins.map.remove(gone)
            twins.textbook.remove(gone)
            twins.sources = [twins.sources[j] for j in kept]
        np.testing.assert_allclose(twins.map.mean, twins.textbook.x, rtol=0, atol=1e-9)
        np.testing.assert_allclose(twins.map.covariance, twins.textbook.P, rtol=0, atol=1e-10)
    assert twins.map.n > 20


def test_joint_update_with_one_feature_paired_twice() -> None:
    m, textbook, _ = mapped()
    rng = np.random.default_rng(1)
    features = np.array([4, UNPAIRED, 4, 1, UNPAIRED])
    points = h(m.mean, np.maximum(features, 0)).reshape(-1, 2) + rng.normal(0, 0.03, (5, 2))
    scan = make_scan(points, random_covariances(rng, SIGMA, len(features)))
    m.update(scan, features)
    textbook.update(scan, features)
    np.testing.assert_allclose(m.mean, textbook.x, rtol=0, atol=1e-10)
    np.testing.assert_allclose(m.covariance, textbook.P, rtol=0, atol=1e-11)


@pytest.mark.parametrize(("f", "jacobians"), [(transform, transform_jacobians), (observe, observe_jacobians)])
def test_the_jacobians_of_the_textbook_are_those_of_finite_differences(f, jacobians) -> None:
    point = np.array([3.0, -1.5])
    by_pose, by_point = jacobians(START, point)
    np.testing.assert_allclose(by_pose, numerical(lambda pose: f(pose, point[None])[0], START), rtol=0, atol=1e-8)
    np.testing.assert_allclose(by_point, numerical(lambda z: f(START, z[None])[0], point), rtol=0, atol=1e-8)


# --- laws -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("nonsense", [False, True], ids=["EKF", "EKF fed nonsense"])
def test_stays_symmetric_and_psd_over_thousands_of_random_steps(nonsense: bool) -> None:
    """Noises of very different sizes (some of them singular), random pairings, growth and removal.

    Measurements agree with the estimate up to their noise, or have nothing to do with it.
    """
    rng = np.random.default_rng(8)
    m, worst = StochasticMap(KEEP, capacity=1), np.inf
    for number in range(4000):
        sigma = 10.0 ** rng.uniform(-4, 0, 3) * rng.integers(0, 2, 3)
        m.predict(Odometry(rng.normal(0, 0.3, 3), np.diag(sigma**2)))
        features, scale = rng.integers(UNPAIRED, m.n, rng.integers(0, 8)), 10.0 ** rng.uniform(-3, 0)
        points = rng.uniform(-5, 5, (len(features), 2))
        if m.n and not nonsense:
            expected = h(m.mean, np.maximum(features, 0)).reshape(-1, 2) + rng.normal(0, scale, points.shape)
            points = np.where(features[:, None] == UNPAIRED, points, expected)
        scan = make_scan(points, random_covariances(rng, scale, len(features)))
        m.update(scan, features)
        m.add(scan, np.flatnonzero(features == UNPAIRED)[: 40 - m.n])
        if rng.random() < 0.1 and m.n:
            m.remove(rng.choice(m.n, rng.integers(0, m.n), replace=False))
        m.end_of_step()
        if number % 20 == 0 and m.n:
            worst = min(worst, smallest_over_largest(m))
    assert np.all(np.isfinite(m.mean)) and worst >= -1e-9


@pytest.mark.parametrize("lost", [10.0, 1e4, 1e7])
def test_stays_psd_when_a_loop_closure_collapses_a_huge_uncertainty(lost: float) -> None:
    rng = np.random.default_rng(2)
    points, R = rng.uniform(-5, 5, (20, 2)), np.tile(1e-4 * np.eye(2), (20, 1, 1))
    m, scan = StochasticMap(KEEP), make_scan(points, R)
    m.add(scan, np.arange(10))
    m.predict(Odometry(np.zeros(3), np.diag([lost**2, lost**2, 1e-2])))
    m.add(scan, np.arange(10, 20))
    before = m.covariance[0, 0]
    for _ in range(30):
        m.update(make_scan(points[:10], R[:10]), np.arange(10))
        assert smallest_over_largest(m) >= -1e-9
        m.predict(Odometry(np.zeros(3), np.diag([1e-4, 1e-4, 1e-6])))
    assert m.covariance[0, 0] < 1e-5 * before


# --- consistency ------------------------------------------------------------------------------------------------------


def test_nees_lies_in_its_chi_square_interval() -> None:
    """Known associations, moderate heading noise: the mean NEES of 60 runs, of the pose and of the whole state."""
    runs, world = 60, landmarks(np.random.default_rng(12), 12)
    pose_nees, state_nees, dimensions = 0.0, 0.0, 0
    for seed in range(runs):
        rng = np.random.default_rng([17, seed])
        known = KnownAssociation(StochasticMap(KEEP))
        for step in wander(rng, 40, world, q=np.diag([0.01, 0.01, 0.004]) ** 2):
            known.step(step)
        m = known.map
        error = m.mean - np.concatenate([step.pose, world[known.sources].ravel()])
        error[2] = wrap_angle(error[2])
        pose_nees += error[:3] @ np.linalg.solve(m.pose_covariance, error[:3])
        state_nees += error @ np.linalg.solve(m.covariance, error)
        dimensions += len(error)
    low, high = chi2.ppf([0.005, 0.995], 3 * runs)
    assert low < pose_nees < high
    low, high = chi2.ppf([0.005, 0.995], dimensions)
    assert low < state_nees < high
