"""The located hypothesis: against a library's least squares, and its statistics by Monte Carlo with correlated maps."""

import numpy as np
import pytest
from scipy.stats import chi2

from slam_gym.association.relocation.location import locate
from slam_gym.geometry import transform, wrap_angle
from slam_gym.types import UNPAIRED, Landmarks, Scan
from tests.oracles import relocation as oracles
from tests.oracles.statistics import for_seeds


def plant(rng, k, *, spurious=1, extra=3, sigma=0.05, drift=0.3, keep="dense"):
    """Truth, scan, map and hypothesis of k true pairings, in scrambled order."""
    n, m = k + extra, k + spurious
    true = rng.uniform(-8.0, 8.0, (n, 2))
    P = oracles.correlated(rng, true, sigma, drift)
    mapped = true + (np.linalg.cholesky(P + 1e-15 * np.eye(2 * n)) @ rng.standard_normal(2 * n)).reshape(n, 2)
    pose = np.array([*rng.uniform(-3.0, 3.0, 2), rng.uniform(-np.pi, np.pi)])
    seen = rng.permutation(n)[:k]
    points, noise = oracles.view(rng, pose, np.vstack([true[seen], rng.uniform(-5, 5, (spurious, 2))]), sigma)
    order = rng.permutation(m)
    features = np.concatenate([seen, np.full(spurious, UNPAIRED)])[order]
    return pose, oracles.scan_of(points[order], noise[order]), oracles.landmarks_of(mapped, P, keep=keep), P, features


@pytest.mark.parametrize("keep", ["dense", "blocks", "none"])
@for_seeds(15)
def test_pose_covariance_and_distance_are_those_of_a_library_s_least_squares(seed, keep):
    rng = np.random.default_rng(seed)
    k = 2 + seed % 6
    _, scan, landmarks, P, features = plant(rng, k, keep=keep)
    if keep == "none":
        P = P * np.kron(np.eye(len(landmarks)), np.ones((2, 2)))
    found = locate(scan, landmarks, features)
    pose, covariance, distance = oracles.fit(
        scan, landmarks, P, [(i, j) for i, j in enumerate(features) if j != UNPAIRED]
    )
    np.testing.assert_allclose(found.pose[:2], pose[:2], atol=1e-5)
    assert wrap_angle(found.pose[2] - pose[2]) == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-3, atol=1e-8)
    assert found.joint_distance == pytest.approx(distance, rel=1e-4, abs=1e-6)
    assert found.dof == 2 * k - 3


@pytest.mark.parametrize("k", [2, 4, 8])
def test_the_joint_distance_follows_chi_square_and_the_pose_is_consistent(k):
    """Laws of large numbers over 1 500 correlated maps: mean and .95 quantile of D², mean and .95 quantile of NEES."""
    rng, runs = np.random.default_rng(k), 1500
    distances, nees = np.empty(runs), np.empty(runs)
    for run in range(runs):
        pose, scan, landmarks, _, features = plant(rng, k, sigma=0.01, drift=0.02)
        found = locate(scan, landmarks, features)
        error = found.pose - pose
        error[2] = wrap_angle(error[2])
        distances[run], nees[run] = found.joint_distance, error @ np.linalg.solve(found.covariance, error)
    for values, dof in ((distances, 2 * k - 3), (nees, 3)):
        assert values.mean() == pytest.approx(dof, abs=4.0 * np.sqrt(2.0 * dof / runs))
        assert np.mean(values > chi2.ppf(0.95, dof)) == pytest.approx(0.05, abs=4.0 * np.sqrt(0.05 * 0.95 / runs))


@pytest.mark.parametrize("k", [0, 1])
def test_fewer_than_two_pairings_have_no_pose(k):
    _, scan, landmarks, _, features = plant(np.random.default_rng(1), 4)
    features[np.flatnonzero(features != UNPAIRED)[k:]] = UNPAIRED
    found = locate(scan, landmarks, features)
    assert np.isnan(found.pose).all() and np.isnan(found.covariance).all()
    assert (found.joint_distance, found.dof) == (0.0, 0)


def test_measurements_at_one_point_determine_no_heading():
    scan = oracles.scan_of(np.ones((2, 2)), np.tile(0.01 * np.eye(2), (2, 1, 1)))
    found = locate(scan, oracles.landmarks_of([[0.0, 0.0], [0.0, 0.0]], 0.01 * np.eye(4)), np.array([0, 1]))
    assert np.isnan(found.pose).all() and found.joint_distance == np.inf and found.dof == 1


def test_points_without_error_are_located_exactly():
    pose, true = np.array([1.0, -2.0, 3.0]), np.array([[0.0, 0.0], [5.0, 1.0], [2.0, 4.0]])
    scan = oracles.scan_of((true - pose[:2]) @ oracles.rotation(3.0), np.zeros((3, 2, 2)))
    found = locate(scan, oracles.landmarks_of(true, np.zeros((6, 6))), np.arange(3))
    np.testing.assert_allclose(found.pose, pose, atol=1e-9)
    assert found.joint_distance < 1e-6


def test_bad_input_is_refused_by_name():
    _, scan, landmarks, P, features = plant(np.random.default_rng(2), 4)
    with pytest.raises(ValueError, match="decisions for"):
        locate(scan, landmarks, features[:-1])
    with pytest.raises(ValueError, match="for a map of"):
        locate(scan, landmarks, np.where(features == UNPAIRED, UNPAIRED, len(landmarks)))
    with pytest.raises(ValueError, match="joint covariance"):
        locate(scan, oracles.landmarks_of(landmarks.positions, -P), features)
    with pytest.raises(ValueError, match="joint covariance"):
        locate(scan, oracles.landmarks_of(landmarks.positions, np.full_like(P, np.nan)), features)
    scan.points[0, 0] = np.nan
    with pytest.raises(ValueError, match="measurement 0"):
        locate(scan, landmarks, features)


def test_the_distance_is_that_of_the_pose_where_gauss_newton_does_not_converge():
    for seed in range(200):
        rng = np.random.default_rng(seed)
        spread = 0.05 * rng.normal(size=(2, 2, 2, 2))  # elongated
        R, P = spread @ spread.swapaxes(2, 3) + 1e-6 * np.eye(2)
        z, F = rng.uniform(-0.2, 0.2, (2, 2, 2))
        found = locate(Scan.from_points(z, R), Landmarks.from_points(F, P), np.arange(2))
        x, C = transform(found.pose, z), oracles.rotation(found.pose[2])
        distance = sum((F[k] - x[k]) @ np.linalg.solve(P[k] + C @ R[k] @ C.T, F[k] - x[k]) for k in range(2))
        assert found.joint_distance == pytest.approx(distance, rel=1e-4, abs=1e-6), seed
