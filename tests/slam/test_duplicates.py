"""Duplicates of a joined map against the best of all sets of pairs."""

import itertools

import numpy as np
import pytest

from slam_gym.geometry import relative
from slam_gym.mapping.map_joining import join
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.slam.duplicates import find_duplicates
from slam_gym.types import Array, IntArray, Odometry, Scan
from tests.oracles.association import gate


def two_maps(rng: np.random.Generator, shared: int, own: int, spread: float = 1.2) -> tuple[StochasticMap, IntArray]:
    """A join of two small crowded maps; the number of older features, and the true pairs."""
    landmarks = np.array([2.0, 0.0]) + rng.uniform(-spread, spread, (shared + 2 * own, 2))
    base = np.array([0.3, -0.2, 0.1])
    groups = [np.arange(shared + own), np.concatenate([np.arange(shared), np.arange(shared + own, len(landmarks))])]
    maps = []
    for group, pose in zip(groups, (np.zeros(3), base)):
        m, sigma = StochasticMap(MapSpec(unconfirmed_age=None)), 0.12
        seen = np.array([relative(pose, np.array([*landmark, 0.0]))[:2] for landmark in landmarks[group]])
        noisy = seen + sigma * rng.standard_normal(seen.shape)
        unknown = np.full(len(group), np.nan)
        m.add(Scan(noisy, np.tile(sigma**2 * np.eye(2), (len(group), 1, 1)), unknown, unknown), np.arange(len(group)))
        maps.append(m)
    Q = np.diag([0.15, 0.15, 0.05]) ** 2
    maps[0].predict(Odometry(base + np.sqrt(np.diag(Q)) * rng.standard_normal(3), Q))
    pairs = np.column_stack([np.arange(shared), shared + own + np.arange(shared)])
    return join(maps[0], maps[1], renumber=True), pairs


def pair_distance(x: Array, P: Array, pairs: list[tuple[int, int]]) -> float:
    """D² of F_i = F_j for all pairs (j, i), by the formula: ν = H x, S = H P Hᵀ with H = [… I … −I …]."""
    j, i = ((3 + 2 * np.array(column)[:, None] + np.arange(2)).ravel() for column in zip(*pairs))
    HP = P[i] - P[j]
    nu = x[i] - x[j]
    return float(nu @ np.linalg.solve(HP[:, i] - HP[:, j], nu))


def best_pairs(m: StochasticMap, older: int) -> tuple[int, float]:
    """Most pairs, then least D², over every one-to-one path of jointly compatible prefixes."""
    best, x, P = (0, 0.0), m.mean, m.covariance
    stack: list[tuple[int, list[tuple[int, int]]]] = [(older, [])]
    options = {
        i: [j for j in range(older) if pair_distance(x, P, [(j, i)]) < gate(2, 0.9999)] for i in range(older, m.n)
    }
    while stack:
        i, pairs = stack.pop()
        if i == m.n:
            distance = pair_distance(x, P, pairs) if pairs else 0.0
            if len(pairs) > best[0] or (len(pairs) == best[0] and distance < best[1]):
                best = (len(pairs), distance)
            continue
        stack.append((i + 1, pairs))
        for j in options[i]:
            longer = [*pairs, (j, i)]
            if all(j != used for used, _ in pairs) and pair_distance(x, P, longer) < gate(2 * len(longer), 0.99):
                stack.append((i + 1, longer))
    return best


def test_duplicates_equal_the_best_of_all_paths() -> None:
    rng, largest, limits = np.random.default_rng(0), 0, 0
    for _ in range(150):
        shared, own = int(rng.integers(0, 4)), int(rng.integers(0, 3))
        m, _ = two_maps(rng, shared, own)
        found = find_duplicates(m, np.arange(shared + own), np.arange(shared + own, m.n))
        pairs = [(int(j), int(i)) for j, i in found.pairs]
        assert len({j for j, _ in pairs}) == len({i for _, i in pairs}) == len(pairs)
        assert found.dof == 2 * len(pairs)
        if pairs:
            assert found.joint_distance == pytest.approx(pair_distance(m.mean, m.covariance, pairs), rel=1e-6, abs=1e-9)
            assert found.joint_distance < gate(found.dof, 0.99)
        count, distance = best_pairs(m, shared + own)
        largest = max(largest, count)
        if found.effort.limit_hit:
            limits += 1
            continue
        assert len(pairs) == count
        assert found.joint_distance == pytest.approx(distance, rel=1e-6, abs=1e-9)
    assert largest >= 4 and limits <= 3


def test_features_in_common_are_found_under_a_poor_relation() -> None:
    rng, right, wrong = np.random.default_rng(1), 0, 0
    for _ in range(40):
        m, true = two_maps(rng, 6, 2, spread=3.0)
        found = find_duplicates(m, np.arange(8), np.arange(8, 16)).pairs
        hits = len(set(map(tuple, found.tolist())) & set(map(tuple, true.tolist())))
        right, wrong = right + hits, wrong + len(found) - hits
    assert right > 0.9 * 240 and wrong < 0.15 * right


def test_sizes_and_kinds_tell_features_apart() -> None:
    m, exact = StochasticMap(), np.tile(0.01 * np.eye(2), (4, 1, 1))
    points = np.array([[1.0, 0.0], [3.0, 0.0], [1.02, 0.0], [3.01, 0.0]])
    sizes, variances = np.array([0.2, 0.5, 0.9, 0.5]), np.full(4, 1e-3)
    m.add(Scan(points, exact, sizes, variances, np.array([0, 1, 0, 1])), np.arange(4))
    np.testing.assert_array_equal(find_duplicates(m, np.arange(2), np.arange(2, 4)).pairs, [[1, 3]])
    m = StochasticMap()
    m.add(Scan(points, exact, np.full(4, np.nan), np.full(4, np.nan), np.array([0, 1, 0, 2])), np.arange(4))
    np.testing.assert_array_equal(find_duplicates(m, np.arange(2), np.arange(2, 4)).pairs, [[0, 2]])


def test_a_node_limit_is_reported() -> None:
    m, _ = two_maps(np.random.default_rng(2), 6, 2)
    assert find_duplicates(m, np.arange(8), np.arange(8, 16), node_limit=1).effort.limit_hit
    assert not find_duplicates(m, np.arange(8), np.arange(8, 16)).effort.limit_hit


@pytest.mark.parametrize(("older", "newer"), [([0, 0], [1]), ([0], [0]), ([0], [99]), ([-1], [1])])
def test_features_that_make_no_sense_are_refused(older: list[int], newer: list[int]) -> None:
    m, _ = two_maps(np.random.default_rng(3), 2, 1)
    with pytest.raises(ValueError, match="older, newer"):
        find_duplicates(m, np.array(older), np.array(newer))


def test_nothing_to_compare_gives_no_pairs() -> None:
    m, _ = two_maps(np.random.default_rng(4), 2, 1)
    for older, newer in itertools.product(([], [0]), ([], [5])):
        found = find_duplicates(m, np.array(older), np.array(newer))
        assert len(found.pairs) <= min(len(older), len(newer))
