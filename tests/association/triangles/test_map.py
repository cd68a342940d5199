"""What an index asks of a map beforehand, against direct formulas, and that shared drift does not count."""

import math

import numpy as np
from scipy.stats import chi2

from slam_gym.association.triangles.index import FeatureIndex
from slam_gym.association.triangles.map import chance_tubes, crowding, relative_covariances, usual_reach
from slam_gym.types import SPURIOUS, UNPAIRED
from tests.association.triangles.small_maps import SIGMA, field, landmarks_at, triangles_within, view


def test_drift_that_near_features_share_does_not_open_the_gates() -> None:
    rng = np.random.default_rng(11)
    truth = field(rng, 120)
    J = np.zeros((240, 3))
    J[0::2, 0] = J[1::2, 1] = 1.0
    J[0::2, 2], J[1::2, 2] = -truth[:, 1], truth[:, 0]
    shared = J @ np.diag([1.0, 1.0, 0.02]) ** 2 @ J.T
    covariance = shared + SIGMA**2 * np.eye(240)
    drawn = truth.ravel() + np.linalg.cholesky(covariance) @ rng.standard_normal(240)
    landmarks = landmarks_at(drawn.reshape(-1, 2), covariance=covariance)
    relative = relative_covariances(landmarks)
    assert np.median(np.trace(relative, axis1=1, axis2=2)) < 0.1 * np.median(
        np.trace(landmarks.covariances, axis1=1, axis2=2)
    )
    index, right = FeatureIndex(landmarks), 0
    for _ in range(40):
        scan, _, sources = view(rng, truth, 10, 3)
        answer = index.relocate(scan, landmarks)
        right += answer.accepted
        if answer.accepted:
            paired = answer.features != UNPAIRED
            assert np.all(answer.features[paired & (sources != SPURIOUS)] == sources[paired & (sources != SPURIOUS)])
            assert answer.dof == 2 * answer.pairings - 3
    assert right >= 36


def test_independent_features_have_their_marginals_for_relative_errors() -> None:
    landmarks = landmarks_at(field(np.random.default_rng(32), 40))
    np.testing.assert_array_equal(relative_covariances(landmarks), landmarks.covariances)


def test_crowding_is_the_sum_of_falling_factorials_of_the_others_in_the_square() -> None:
    positions, width = np.random.default_rng(33).uniform(0.0, 30.0, (120, 2)), 9.0
    apart = np.abs(positions[:, None] - positions[None]).max(2)
    others = (apart <= width / 2.0).sum(1) - 1
    expected = [
        max(
            sum(float(math.perm(int(k), p)) for k in others) / width ** (2 * p),
            len(positions) * (others.mean() / width**2) ** p,
        )
        for p in range(64)
    ]
    np.testing.assert_allclose(crowding(positions, width), expected, rtol=1e-9)
    assert not crowding(positions[:0], width).any()


def test_tubes_of_chance_are_volumes_of_balls_of_the_gate() -> None:
    tubes = chance_tubes(8, 0.95)
    assert not tubes[:2].any()
    for k in range(2, 9):
        d = 2 * k - 3
        ball = math.pi ** (d / 2) / math.gamma(d / 2 + 1) * chi2.ppf(0.95, d) ** (d / 2)
        np.testing.assert_allclose(tubes[k], 2.0 * math.pi * k * math.sqrt(k - 1) * ball, rtol=1e-9)


def test_the_usual_reach_has_some_23_features_within_it_or_so_many_triangles_as_are_allowed() -> None:
    positions = field(np.random.default_rng(34), 60)
    apart = np.sort(np.hypot(*(positions[:, None] - positions[None]).transpose(2, 0, 1)), axis=1)
    np.testing.assert_allclose(usual_reach(positions, 1e6), np.median(apart[:, 23]), rtol=1e-12)
    short = usual_reach(positions, 10.0)
    assert len(triangles_within(positions, short)) <= 10.0 * 60 < len(triangles_within(positions, short / 0.9))
    assert usual_reach(positions[:2], 64.0) == 11.0
