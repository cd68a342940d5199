"""Whether pairs may be the same: the two parts of D², and what one pair adds, against their definitions."""

import numpy as np
import pytest

from slam_gym.association.compatibility import chi2_gate
from slam_gym.mapping.stochastic_map import MapSpec, MapState, StochasticMap
from slam_gym.slam.places.recognition import RecognitionSpec
from slam_gym.slam.places.verification import agreeing, agreement
from slam_gym.types import Array, IntArray
from tests.oracles.geometry import differences, rigid_motions


def map_of(positions: Array, covariance: Array) -> StochasticMap:
    """A map of features (n, 2) with this covariance (3 + 2n, 3 + 2n)."""
    n = len(positions)
    zeros = np.zeros(n, np.int64)
    counted, sized = np.stack([np.arange(n), zeros + 5, zeros, zeros, zeros - 1, zeros]), np.full((2, n), np.nan)
    mean = np.append(np.zeros(3), positions.ravel())
    return StochasticMap.of_state(MapSpec(), MapState(mean, covariance, counted, sized, 9, n))


def twice(rng: np.random.Generator, k: int, sigma: float = 0.05, motion: float = 0.5) -> tuple[StochasticMap, IntArray]:
    """A map that holds k features twice, drawn from its own covariance: the second ones moved together besides."""
    truth = rng.uniform(-8.0, 8.0, (k, 2))
    G = rigid_motions(truth - truth.mean(axis=0))
    common = np.diag([motion, motion, 0.02 * motion]) ** 2
    P = 1e-4 * np.eye(3 + 4 * k)
    P[3:, 3:] = sigma**2 * np.eye(4 * k)
    P[3 + 2 * k :, 3 + 2 * k :] += G @ common @ G.T
    error = np.linalg.cholesky(P) @ rng.standard_normal(len(P))
    positions = np.concatenate([truth, truth]) + error[3:].reshape(-1, 2)
    return map_of(positions, P), np.column_stack([np.arange(k), k + np.arange(k)])


def parts(m: StochasticMap, pairs: IntArray) -> tuple[float, float]:
    """D² and its minimum over rigid motions, by solving the linear systems in full."""
    H = differences(pairs, m.n)
    C, nu = H @ m.covariance[3:, 3:] @ H.T, H @ m.positions.ravel()
    G = rigid_motions(m.positions[pairs[:, 1]])
    delta = np.linalg.solve(G.T @ np.linalg.solve(C, G), G.T @ np.linalg.solve(C, nu))
    left = nu - G @ delta
    return float(nu @ np.linalg.solve(C, nu)), float(left @ np.linalg.solve(C, left))


def test_shape_and_motion_are_the_parts_of_the_joint_distance() -> None:
    m, pairs = twice(np.random.default_rng(0), 9)
    found, (total, shape) = agreement(m, pairs), parts(m, pairs)
    assert found.shape == pytest.approx(shape, rel=1e-6) and found.dof == 15
    assert found.shape + found.motion == pytest.approx(total, rel=1e-6)


def test_both_parts_follow_their_chi_squared_distributions() -> None:
    found = [agreement(*twice(np.random.default_rng(seed), 6)) for seed in range(400)]
    shape, motion = np.array([each.shape for each in found]), np.array([each.motion for each in found])
    # means of 400 draws of χ² with 9 and 3 degrees of freedom: ± 4 standard errors
    assert abs(shape.mean() - 9.0) < 4.0 * np.sqrt(18.0 / 400.0)
    assert abs(motion.mean() - 3.0) < 4.0 * np.sqrt(6.0 / 400.0)
    assert 0.90 < np.mean(shape < chi2_gate(9, 0.95)) < 0.99


def test_the_pair_that_the_others_speak_against_is_dropped_and_no_other() -> None:
    m, pairs = twice(np.random.default_rng(2), 12, motion=0.05)
    wrong = pairs.copy()
    wrong[[3, 7], 1] = wrong[[7, 3], 1]
    left = agreeing(m, wrong, RecognitionSpec(), prior=True)
    assert {tuple(pair) for pair in left.tolist()} <= {tuple(pair) for pair in pairs.tolist()}
    assert len(left) >= 9


def test_a_motion_that_the_map_thinks_impossible_is_refused_where_the_prior_counts() -> None:
    m, pairs = twice(np.random.default_rng(3), 10, motion=0.1)
    moved = m.positions
    moved[10:] += np.array([3.0, 0.0])  # thirty standard deviations
    far = map_of(moved, m.covariance)
    assert len(agreeing(far, pairs, RecognitionSpec(), prior=True)) == 0
    assert len(agreeing(far, pairs, RecognitionSpec(), prior=False)) >= 9
    moved[10:] -= np.array([2.05, 0.0])  # nine and a half, which an inflation by three admits
    assert len(agreeing(map_of(moved, m.covariance), pairs, RecognitionSpec(), prior=True)) >= 9
