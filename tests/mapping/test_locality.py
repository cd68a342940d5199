"""Localities against their definitions."""

import itertools

import numpy as np
import pytest

from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.locality import (
    covisible,
    hypothesis_bound,
    hypothesis_count,
    linked,
    locality_sizes,
    restricted,
    same_local_map,
    within,
)
from slam_gym.types import UNPAIRED, BoolArray, IntArray, Locality
from tests.oracles.statistics import for_seeds


def dense(locality: Locality) -> BoolArray:
    """(n, n); each row is ascending without repetitions, and sizes are those of the rows."""
    n = len(locality)
    out = np.zeros((n, n), np.bool_)
    for j in range(n):
        assert np.all(np.diff(locality.of(j)) > 0)
        out[j, locality.of(j)] = True
    np.testing.assert_array_equal(locality_sizes(locality, n), out.sum(axis=1))
    return out


def random_graph(rng: np.random.Generator, n: int) -> tuple[CovisibilityGraph, IntArray]:
    """A graph and its counts (n, n)."""
    graph, counts = CovisibilityGraph(), np.zeros((n, n), np.int64)
    graph.add(n)
    for _ in range(int(rng.integers(0, n + 1))):
        seen = rng.choice(n, int(rng.integers(0, min(n, 5) + 1)), replace=False)
        graph.see_together(seen)
        counts[np.ix_(seen, seen)] += 1
    return graph, counts


def test_covisibility_equals_powers_of_the_relation() -> None:
    rng = np.random.default_rng(0)
    for _ in range(150):
        n = int(rng.integers(1, 25))
        graph, counts = random_graph(rng, n)
        hops = int(rng.integers(1, 5))
        once = ((counts > 0) | np.eye(n, dtype=np.bool_)).astype(np.int64)
        expected = np.linalg.matrix_power(once, hops) > 0
        np.testing.assert_array_equal(dense(covisible(graph, hops)), expected)


def test_distance_equals_all_pairs() -> None:
    rng = np.random.default_rng(1)
    for _ in range(100):
        positions = rng.uniform(-5, 5, (int(rng.integers(0, 40)), 2))
        distance = rng.uniform(0.0, 6.0)
        apart = np.hypot(*(positions[:, None] - positions).transpose(2, 0, 1))
        np.testing.assert_array_equal(dense(within(positions, distance)), apart <= distance)
    twice = np.ones((3, 2))
    assert dense(within(twice, 0.0)).all()  # features in one place


def test_local_maps_equal_the_definition() -> None:
    rng = np.random.default_rng(2)
    for _ in range(100):
        map_of = rng.choice([0, 1, 5, 7], int(rng.integers(0, 30)))
        np.testing.assert_array_equal(dense(same_local_map(map_of)), map_of[:, None] == map_of)


# --- what is refused --------------------------------------------------------------------------------------------------


def test_among_some_features_the_relation_is_that_of_the_whole_map() -> None:
    rng = np.random.default_rng(0)
    pairs = np.array([pair for pair in itertools.combinations(range(12), 2) if rng.random() < 0.2])
    for hops in (1, 2):
        locality, chosen = linked(12, pairs, hops), np.sort(rng.permutation(12)[:7])
        among = restricted(locality, chosen)
        assert among is not None
        np.testing.assert_array_equal(dense(among), dense(locality)[np.ix_(chosen, chosen)])
    assert restricted(None, chosen) is None


def test_what_makes_no_sense_is_refused() -> None:
    graph, _ = random_graph(np.random.default_rng(8), 5)
    with pytest.raises(ValueError, match="hops"):
        covisible(graph, hops=0)
    for pairs in ([[0, 3]], [[0, 1], [1, 1]], [[-1, 0]]):
        with pytest.raises(ValueError, match="pairs"):
            linked(3, np.array(pairs))
    for distance in (-1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="distance"):
            within(np.zeros((2, 2)), distance)
    with pytest.raises(ValueError, match=r"positions\[1\]"):
        within(np.array([[0.0, 0.0], [np.nan, 0.0]]), 1.0)
    with pytest.raises(ValueError, match="positions"):
        within(np.zeros((2, 3)), 1.0)
    with pytest.raises(ValueError, match=r"map_of\[1\]"):
        same_local_map([0, -1])
    with pytest.raises(ValueError, match="locality"):
        locality_sizes(within(np.zeros((3, 2)), 1.0), 4)


def test_an_empty_map_has_an_empty_locality() -> None:
    for locality in (covisible(CovisibilityGraph()), within(np.empty((0, 2)), 1.0), same_local_map([])):
        assert len(locality) == 0 and len(locality.members) == 0
    np.testing.assert_array_equal(locality_sizes(None, 4), [4, 4, 4, 4])


def enumerated(n: int, m: int, local: list[set[int]]) -> int:
    """Hypotheses with all later pairings local to the first one: every m-tuple is written out and looked at."""
    count = 0
    for decisions in itertools.product([UNPAIRED, *range(n)], repeat=m):
        paired = [j for j in decisions if j != UNPAIRED]
        count += not paired or set(paired[1:]) <= local[paired[0]]
    return count


@for_seeds(40)
def test_equation_9_22_bounds_the_hypotheses_and_is_exact_for_localities_of_one_size(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, m, dense_pairs = int(rng.integers(1, 6)), int(rng.integers(1, 5)), rng.choice([0.0, 0.4, 1.0])
    local = [{j} for j in range(n)]
    for a, b in itertools.combinations(range(n), 2):
        if rng.random() < dense_pairs:
            local[a].add(b)
            local[b].add(a)
    counted, sizes = enumerated(n, m, local), np.array([len(members) for members in local])
    largest = round(hypothesis_bound(n, m, int(sizes.max())))
    assert round(hypothesis_count(sizes, m)) == counted <= largest <= (n + 1) ** m
    assert (counted == largest) == (m == 1 or sizes.min() == sizes.max())
    assert hypothesis_bound(n, m, float(sizes.mean())) <= counted * (1 + 1e-12)
    assert hypothesis_bound(n, m, n) == pytest.approx((n + 1) ** m)
