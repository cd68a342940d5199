"""Location-independent constraints: by their formulas, by their laws, and by Monte Carlo what they refuse."""

from dataclasses import replace

import numpy as np
import pytest

from slam_gym.association.relocation.constraints import binary_test, map_arrays, orientation_test
from slam_gym.association.relocation.problem import problem_of
from slam_gym.types import UNKNOWN_KIND
from tests.oracles import relocation as oracles
from tests.oracles.statistics import for_seeds


def unary(scan, landmarks, confidence=0.99):
    """Which measurement may come from which feature by what they are."""
    return problem_of(scan, map_arrays(landmarks), None, confidence).allowed


def binary(scan, landmarks, *pairs, confidence=0.99):
    """Whether two pairings agree in their distances."""
    problem = problem_of(scan, map_arrays(landmarks), None, confidence)
    return binary_test(problem.scan, problem.mapped, *pairs[0], *pairs[1])


def orientation(scan, landmarks, *pairs):
    """Whether three pairings go round in the same sense."""
    problem = problem_of(scan, map_arrays(landmarks), None, 0.99)
    return orientation_test(problem.scan, problem.mapped, *zip(*pairs))


def plant(seed, n=6, *, keep="dense", sigma=0.05, drift=0.5, spread=2.0):
    """As many measurements as features, all of them features seen from somewhere, in the map's order."""
    rng = np.random.default_rng(seed)
    true = rng.uniform(-spread, spread, (n, 2))
    P = oracles.correlated(rng, true, sigma, drift)
    mapped = true + (np.linalg.cholesky(P + 1e-15 * np.eye(2 * n)) @ rng.standard_normal(2 * n)).reshape(n, 2)
    pose = np.array([*rng.uniform(-2.0, 2.0, 2), rng.uniform(-np.pi, np.pi)])
    points, noise = oracles.view(rng, pose, true, sigma)
    landmarks = oracles.landmarks_of(mapped, P, keep=keep)
    return oracles.scan_of(points, noise), landmarks, P if keep != "none" else P * np.kron(np.eye(n), np.ones((2, 2)))


@pytest.mark.parametrize("keep", ["dense", "blocks", "none"])
@for_seeds(12)
def test_binary_and_orientation_are_their_formulas(seed, keep):
    scan, landmarks, P = plant(seed, keep=keep, spread=0.3 + 0.5 * (seed % 4))
    rng, answers = np.random.default_rng(seed), []
    for _ in range(40):
        (i, k, p), (j, l, q) = rng.permutation(6)[:3], rng.permutation(6)[:3]
        found = binary(scan, landmarks, (i, j), (k, l))
        assert found == oracles.agree_in_distance(scan, landmarks, P, (i, j), (k, l), 0.99)
        turned = orientation(scan, landmarks, (i, j), (k, l), (p, q))
        assert turned == oracles.same_sense(scan, landmarks, P, [(i, j), (k, l), (p, q)], 0.99)
        answers += [(found, turned)]
    if keep != "none" and seed % 4:
        assert {found for found, _ in answers} == {True, False} == {turned for _, turned in answers}


def test_binary_refuses_right_pairs_as_rarely_as_its_confidence_says():
    """.95 with 1 200 correlated maps, the drift far above the gate that marginals would give."""
    refused = 0
    for seed in range(1200):
        scan, landmarks, _ = plant(seed, 2, sigma=0.02, drift=0.02, spread=3.0)
        refused += not binary(scan, landmarks, (0, 0), (1, 1), confidence=0.95)
    assert 0.035 < refused / 1200 < 0.065


@pytest.mark.parametrize("distance", [0.0, 0.02, 0.1])
def test_points_nearer_than_their_noise_are_seldom_refused(distance):
    """Their distance is not Gaussian: the gate of the linearised formula would refuse far too many."""
    rng, refused = np.random.default_rng(5), 0
    for _ in range(400):
        true = np.array([[0.0, 0.0], [distance, 0.0]])
        points, noise = oracles.view(rng, np.array([3.0, 2.0, 1.0]), true, 0.05)
        landmarks = oracles.landmarks_of(true + 0.05 * rng.standard_normal((2, 2)), 0.0025 * np.eye(4))
        refused += not binary(oracles.scan_of(points, noise), landmarks, (0, 0), (1, 1))
    assert refused / 400 <= 0.02


def test_sizes_and_kinds_by_definition():
    rng = np.random.default_rng(9)
    m, n = 30, 40
    nan_or = lambda values: np.where(rng.random(len(values)) < 0.2, np.nan, values)  # noqa: E731
    scan = oracles.scan_of(
        rng.standard_normal((m, 2)),
        np.tile(np.eye(2), (m, 1, 1)),
        sizes=nan_or(rng.uniform(0.1, 0.5, m)),
        size_variances=nan_or(rng.uniform(0.0, 0.01, m)),
        kinds=rng.choice([UNKNOWN_KIND, 0, 1], m),
    )
    landmarks = oracles.landmarks_of(
        rng.standard_normal((n, 2)),
        np.eye(2 * n),
        sizes=nan_or(rng.uniform(0.1, 0.5, n)),
        size_variances=nan_or(rng.uniform(0.0, 0.01, n)),
        kinds=rng.choice([UNKNOWN_KIND, 0, 1], n),
    )
    expected = [[oracles.agree_in_what_they_are(scan, landmarks, i, j, 0.95) for j in range(n)] for i in range(m)]
    np.testing.assert_array_equal(unary(scan, landmarks, 0.95), expected)
    assert 0 < np.mean(expected) < 1


def test_error_free_sizes_must_be_equal():
    zeros = np.zeros(1)
    scan = oracles.scan_of([[0.0, 0.0]], np.eye(2), sizes=np.array([0.3]), size_variances=zeros)
    for size, passes in ((0.3, True), (0.31, False)):
        landmarks = oracles.landmarks_of([[0.0, 0.0]], np.eye(2), sizes=np.array([size]), size_variances=zeros)
        assert unary(scan, landmarks).item() is passes


def test_bad_input_is_refused_by_name():
    scan, landmarks, P = plant(1)
    with pytest.raises(ValueError, match="confidence"):
        unary(scan, landmarks, 1.0)
    with pytest.raises(ValueError, match=r"Landmarks.covariance: shape"):
        unary(scan, replace(landmarks, covariance=P[:-1]))
    with pytest.raises(ValueError, match=r"Landmarks.sizes: shape"):
        unary(scan, replace(landmarks, sizes=np.zeros(2)))
    with pytest.raises(ValueError, match=r"Landmarks.block_starts"):
        unary(scan, replace(landmarks, block_starts=np.zeros(3, np.int64)))
    with pytest.raises(ValueError, match=r"Scan.size_variances: measurement 0"):
        unary(replace(scan, size_variances=np.full(6, -1.0)), landmarks)
    with pytest.raises(ValueError, match=r"Scan.kinds: shape"):
        unary(replace(scan, kinds=np.zeros(2, np.int64)), landmarks)
    for field, match in (("positions", "not finite"), ("covariances", "not PSD"), ("size_variances", "negative")):
        spoilt = getattr(landmarks, field).copy()
        spoilt[2] = np.nan if field == "positions" else -1.0
        with pytest.raises(ValueError, match=rf"Landmarks.{field}\[2\] is {match}"):
            unary(scan, replace(landmarks, **{field: spoilt}))
