"""The covisibility graph against a dictionary of counts."""

from collections import Counter
from itertools import combinations

import numpy as np
import pytest

from slam_gym.mapping.covisibility import CovisibilityGraph, among, mark_local
from slam_gym.types import UNPAIRED


class DictGraph:
    """Counts of pairs (i, j), i < j, in a dictionary."""

    def __init__(self) -> None:
        self.n = 0
        self.counts: Counter[tuple[int, int]] = Counter()

    def see_together(self, features: np.ndarray) -> None:
        self.counts.update(combinations(sorted(set(features.tolist()) - {UNPAIRED}), 2))

    def keep(self, kept: np.ndarray) -> None:
        new = {old: i for i, old in enumerate(kept.tolist())}
        self.n = len(kept)
        self.counts = Counter({(new[i], new[j]): c for (i, j), c in self.counts.items() if i in new and j in new})

    def count(self, i: int, j: int) -> int:
        return self.counts[min(i, j), max(i, j)]


def assert_equal(graph: CovisibilityGraph, oracle: DictGraph) -> None:
    assert graph.n == oracle.n
    edges, counts = graph.edges()
    assert list(zip(map(tuple, edges.tolist()), counts.tolist())) == sorted(oracle.counts.items())


def random_pair(rng: np.random.Generator, steps: int) -> tuple[CovisibilityGraph, DictGraph]:
    """Both graphs after the same random adding, seeing and keeping, compared at every step."""
    graph, oracle = CovisibilityGraph(), DictGraph()
    for _ in range(steps):
        count = int(rng.integers(0, 5))
        graph.add(count)
        oracle.n += count
        seen = rng.integers(UNPAIRED, oracle.n, rng.integers(0, 12))
        graph.see_together(seen)
        oracle.see_together(seen)
        if rng.random() < 0.2:
            kept = np.flatnonzero(rng.random(oracle.n) < 0.95)
            graph.keep(kept)
            oracle.keep(kept)
        assert_equal(graph, oracle)
    return graph, oracle


@pytest.mark.parametrize("seed", range(5))
def test_equals_a_dictionary_of_counts(seed: int) -> None:
    rng = np.random.default_rng(seed)
    graph, oracle = random_pair(rng, 120)
    assert graph.n > 70 and graph.edges()[1].max() > 1  # grown in both directions
    for i in range(graph.n):
        assert graph.counts[i, : graph.n].tolist() == [oracle.count(i, j) for j in range(graph.n)]
        np.testing.assert_array_equal(graph.neighbours(i), [j for j in range(graph.n) if oracle.count(i, j)])


@pytest.mark.parametrize("seed", range(5))
def test_localities_equal_the_definition(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    graph, oracle = random_pair(rng, 40)
    for size in (0, 1, 6):
        chosen = rng.integers(0, graph.n, size)
        neighbours = {j for j in range(graph.n) for f in chosen if oracle.count(j, f)}
        expected = np.isin(np.arange(graph.n), [*chosen, *neighbours])
        np.testing.assert_array_equal(mark_local(graph.counts, graph.n, np.append(chosen, UNPAIRED)), expected)
        pairs = [[bool(i == j or oracle.count(i, j)) for j in chosen] for i in chosen]
        np.testing.assert_array_equal(among(graph.counts, chosen), np.array(pairs, dtype=bool).reshape(size, size))


def test_what_makes_no_sense_is_refused_and_changes_nothing() -> None:
    graph, oracle = random_pair(np.random.default_rng(3), 20)
    for features in ([0, graph.n], [0, -2]):
        with pytest.raises(ValueError, match="features"):
            graph.see_together(np.array(features))
    for kept in ([1, 0], [0, 0], [-1, 2], [0, graph.n]):
        with pytest.raises(ValueError, match="kept"):
            graph.keep(np.array(kept))
    for i in (graph.n, -1):
        with pytest.raises(IndexError):
            graph.neighbours(i)
    for pairs in ([[0, graph.n]], [[1, 1]]):
        with pytest.raises(ValueError, match="pairs"):
            graph.link(np.array(pairs))
    assert_equal(graph, oracle)


def test_a_link_is_counted_once_and_only_where_there_is_none() -> None:
    graph, oracle = random_pair(np.random.default_rng(0), 60)
    pairs = np.argwhere(np.triu(np.ones((graph.n, graph.n)), 1))
    for _ in range(2):
        graph.link(pairs)
    for i, j in pairs.tolist():
        oracle.counts[i, j] = max(oracle.count(i, j), 1)
    assert_equal(graph, oracle)


def test_one_graph_after_another_has_the_edges_of_both() -> None:
    rng = np.random.default_rng(1)
    (one, expected), (other, behind) = random_pair(rng, 8), random_pair(rng, 40)
    assert 5 < one.n < other.n
    expected.n += other.n
    expected.counts |= {(i + one.n, j + one.n): c for (i, j), c in behind.counts.items()}
    assert_equal(one.followed_by(other), expected)


def test_fused_nodes_take_over_each_others_edges() -> None:
    graph, oracle = random_pair(np.random.default_rng(2), 15)
    became = {old: old for old in range(graph.n)} | {3: 0, 17: 5}
    left, fused = sorted(set(became.values())), DictGraph()
    for (i, j), c in oracle.counts.items():
        i, j = sorted((left.index(became[i]), left.index(became[j])))
        if i != j:
            fused.counts[i, j] += c
    fused.n = graph.n - 2
    assert_equal(graph.fused(np.array([0, 5]), np.array([3, 17])), fused)
    assert_equal(graph, oracle)
