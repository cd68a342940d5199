"""Loops that are found, and those that must not be: other buildings, mirror images, motions beyond the prior."""

import math

import numpy as np
import pytest
from scipy.linalg import block_diag

from slam_gym.geometry import transform
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.slam.places.fusion import find_loop
from slam_gym.slam.places.recognition import RecognitionSpec, as_scan
from slam_gym.types import Array, Odometry, Scan
from tests.oracles.geometry import rigid_motions
from tests.oracles.statistics import for_seeds
from tests.slam.rings import enter

SIDE, SIGMA = 12.0, 0.05  # [m] of a square of features, and of each position


def layered(
    rng: np.random.Generator, older: Array, newer: Array, drift: float = 0.4
) -> tuple[StochasticMap, CovisibilityGraph]:
    """A map of `older` (a, 2), and long afterwards of `newer` (b, 2), seen by a robot that has drifted in between."""
    m, graph = StochasticMap(MapSpec(unconfirmed_age=None)), CovisibilityGraph()
    for points, error in ((older, np.zeros(3)), (newer, np.array([drift, drift, 0.05 * drift]))):
        Q = np.diag(error**2) + 1e-12 * np.eye(3)
        m.predict(Odometry(error * rng.standard_normal(3), Q))  # where in truth it is at the origin again
        enter(m, graph, points, rng, SIGMA)
        m.step += 100
    m.step -= 100
    return m, graph


def field(rng: np.random.Generator, count: int) -> Array:
    return rng.uniform(-SIDE / 2.0, SIDE / 2.0, (count, 2))


def loop_in(m: StochasticMap, graph: CovisibilityGraph) -> Array:
    return find_loop(m, graph, RecognitionSpec())


def test_what_is_seen_again_is_found_and_paired_rightly() -> None:
    for seed in range(5):
        rng = np.random.default_rng(seed)
        older = field(rng, 40)
        m, graph = layered(rng, older, older[:14])
        pairs = loop_in(m, graph)
        assert len(pairs) >= 10, f"seed {seed}"
        np.testing.assert_array_equal(pairs[:, 0], pairs[:, 1] - 40)
        assert len(find_loop(m, graph, RecognitionSpec(above_mirror=20))) == 0  # of at most 14


def test_other_ground_is_not_taken_for_old() -> None:
    closed = 0
    for seed in range(40):
        rng = np.random.default_rng((1, seed))
        closed += len(loop_in(*layered(rng, field(rng, 40), field(rng, 14)))) > 0
    assert closed == 0  # bounds the rate by 3 / 40 at 95 %


def test_the_mirror_image_of_old_ground_is_not_taken_for_it() -> None:
    for seed in range(10):
        rng = np.random.default_rng((2, seed))
        older = field(rng, 40)
        m, graph = layered(rng, older, older[:14] * np.array([1.0, -1.0]))
        assert len(loop_in(m, graph)) == 0, f"seed {seed}"


def test_ground_that_looks_alike_but_is_too_far_is_not_taken_for_old() -> None:
    for seed in range(5):
        rng = np.random.default_rng((3, seed))
        older = field(rng, 40)
        elsewhere = transform(np.array([2.5, 1.0, 0.3]), older[:14])
        m, graph = layered(rng, np.concatenate([older, field(rng, 10)]), elsewhere, drift=0.05)
        assert len(loop_in(m, graph)) == 0, f"seed {seed}"


def test_features_that_one_scan_saw_both_are_not_the_same() -> None:
    rng = np.random.default_rng(4)
    older = field(rng, 40)
    m, graph = layered(rng, older, older[:14])
    pairs = loop_in(m, graph)
    graph.see_together(pairs[0])
    assert len(loop_in(m, graph)) == 0


def test_few_pairs_close_no_loop() -> None:
    rng = np.random.default_rng(5)
    older = field(rng, 40)
    assert len(loop_in(*layered(rng, older, np.concatenate([older[:7], field(rng, 7)])))) == 0


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


WRONG = {
    "every": 0,
    "recent": 0,
    "group": 2,
    "min_pairs": 2,
    "above_mirror": -1,
    "min_fraction": 1.5,
    "confidence": 1.0,
}


@pytest.mark.parametrize(("name", "value"), [*WRONG.items(), ("inflation", 0.5), ("inflation", math.inf)])
def test_settings_that_are_none_are_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        RecognitionSpec(**{name: value})  # type: ignore[arg-type]


def test_a_search_that_is_unknown_is_refused() -> None:
    with pytest.raises(ValueError, match="unknown relocator"):
        RecognitionSpec(search="nobody")
