"""The covariances with which a part of the map is searched for, what the search finds, and its settings."""

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.spatial import cKDTree

from slam_gym.geometry import observe
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.slam.places.recognition import RecognitionSpec, as_scan, least_pairs, recognise
from slam_gym.types import UNPAIRED, Array, Odometry, Scan
from tests.oracles.geometry import rigid_motions
from tests.oracles.statistics import for_seeds


def drifting(rng: np.random.Generator, n: int) -> StochasticMap:
    """A map of n features that share most of their errors, as after a long way from its base."""
    m = StochasticMap(MapSpec(unconfirmed_age=None))
    m.predict(Odometry(np.array([20.0, 5.0, 1.0]), np.diag([0.8, 0.8, 0.1]) ** 2))
    for _ in range(n):
        m.predict(Odometry(np.array([0.3, 0.0, 0.1]), np.diag([0.02, 0.02, 0.01]) ** 2))
        unknown = np.full(1, np.nan)
        m.add(Scan(rng.uniform(-3, 3, (1, 2)), 0.02**2 * np.eye(2)[None], unknown, unknown), np.array([0]))
    return m


def without_pose(points: Array, S: Array) -> Array:
    """The information that errors with covariance S hold once a rigid motion has been fitted to them: D² = eᵀ(·)e."""
    G, W = rigid_motions(points), np.linalg.inv(S)
    out: Array = W - W @ G @ np.linalg.inv(G.T @ W @ G) @ G.T @ W
    return out


@for_seeds(25)
def test_a_group_never_claims_more_than_the_map_knows(seed: int) -> None:
    """D² of any error, a pose being fitted, is at most what the true covariance makes of it; for every subset too."""
    rng = np.random.default_rng(seed)
    m, group = drifting(rng, 12), rng.permutation(12)[:8]
    scan = as_scan(m, group)
    entries = (3 + 2 * group[:, None] + np.arange(2)).ravel()
    P, claimed = m.covariance[np.ix_(entries, entries)], block_diag(*scan.covariances)
    np.testing.assert_array_equal(scan.points, m.positions[group])
    for _ in range(5):
        subset = rng.permutation(8)[: int(rng.integers(2, 9))]
        rows = (2 * subset[:, None] + np.arange(2)).ravel()
        true = without_pose(scan.points[subset], P[np.ix_(rows, rows)] + 1e-12 * np.eye(len(rows)))
        ours = without_pose(scan.points[subset], claimed[np.ix_(rows, rows)])
        for _ in range(20):
            e = rng.standard_normal(len(rows))
            assert e @ ours @ e <= (1.0 + 1e-6) * (e @ true @ e)
    drift = np.trace(P) / len(P)
    assert np.trace(claimed) / len(claimed) < 0.1 * drift  # and yet what is common does not count


def seen_once(points: Array, rng: np.random.Generator) -> StochasticMap:
    """A map of points (n, 2) [m] in R, each seen once."""
    m, sigma = StochasticMap(MapSpec(unconfirmed_age=None)), 0.05
    m.add(Scan.from_points(points + rng.normal(0.0, sigma, points.shape), sigma=sigma), np.arange(len(points)))
    return m


@for_seeds(3)
def test_a_part_of_a_dense_map_is_recognised_by_default(seed: int) -> None:
    """Among 1 600 features a metre from each other, many sets of three fit any triangle, and each is examined."""
    rng, n, pose = np.random.default_rng(seed), 1600, np.array([20.0, 15.0, 2.0])
    points = np.argwhere(np.ones((40, 40))) + rng.uniform(-0.4, 0.4, (n, 2))
    pairs = np.sort(cKDTree(points).query_pairs(2.5, output_type="ndarray"), axis=1)
    graph, near = CovisibilityGraph(), np.hypot(*observe(pose, points).T).argsort()
    graph.add(n)
    graph.link(pairs)
    old, new = seen_once(points, rng), seen_once(observe(pose, points[near[:20]]), rng)
    found = recognise(new, np.arange(20), old, graph, np.arange(n), RecognitionSpec())
    assert found is not None and found.pairings >= 18
    assert np.isin(found.features, [UNPAIRED, *near[:20]]).all()
    np.testing.assert_allclose(found.pose, pose, atol=0.1)


def test_each_doubling_of_what_is_searched_requires_one_more_pair() -> None:
    assert [least_pairs(among, RecognitionSpec()) for among in (8, 100, 101, 200, 201, 1600)] == [8, 8, 9, 9, 10, 12]


def test_a_loop_of_more_pairs_than_the_recent_part_has_features_is_refused() -> None:
    for name in ("min_loop_pairs", "min_pairs"):
        with pytest.raises(ValueError, match=f"{name}: 9 is more than group, 8"):
            RecognitionSpec(**{"min_pairs": 5, name: 9, "group": 8})
