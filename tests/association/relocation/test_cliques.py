"""The largest cliques against those of networkx, on graphs of all densities, and the limits."""

import networkx as nx
import numpy as np
import pytest

from slam_gym.association.relocation.cliques import largest_cliques


def random_graph(rng):
    v = int(rng.integers(2, 80))
    a, b = np.triu_indices(v, 1)
    kept = rng.random(len(a)) < rng.uniform(0.02, 0.6)
    return np.column_stack([a[kept], b[kept]]), v


@pytest.mark.parametrize("seed", range(60))
def test_all_largest_cliques_are_found_and_no_other(seed):
    edges, v = random_graph(np.random.default_rng(seed))
    graph = nx.Graph(edges.tolist())
    maximal = [tuple(sorted(clique)) for clique in nx.find_cliques(graph)] if len(edges) else []
    most = max(map(len, maximal), default=0)
    found = largest_cliques(edges, v, v, 10_000, 10**7)
    assert found.complete
    assert sorted(tuple(sorted(clique)) for clique in found.members.tolist()) == sorted(
        clique for clique in maximal if len(clique) == most
    )


def test_no_more_than_asked_for_are_given_and_it_is_said():
    a, b = np.triu_indices(12, 1)
    kept = a % 6 != b % 6  # six pairs that are not joined: 2⁶ largest cliques
    edges = np.column_stack([a[kept], b[kept]])
    found = largest_cliques(edges, 12, 12, 64, 10**6)
    assert found.complete and found.members.shape == (64, 6)
    assert len({tuple(sorted(clique)) for clique in found.members.tolist()}) == 64
    few = largest_cliques(edges, 12, 12, 10, 10**6)
    assert not few.complete and few.members.shape == (10, 6)


def test_the_largest_are_found_though_there_are_too_many_smaller_ones():
    a, b = np.triu_indices(30, 1)
    kept = (a % 10 != b % 10) | (a % 10 == 0)  # 3⁹ cliques of 3 + 9, if the three of class 0 are joined
    few = largest_cliques(np.column_stack([a[kept], b[kept]]), 30, 30, 5, 10**6)
    assert not few.complete and few.members.shape == (5, 12)


def test_the_search_ends_after_its_branches():
    a, b = np.triu_indices(40, 1)
    kept = np.random.default_rng(0).random(len(a)) < 0.8
    edges = np.column_stack([a[kept], b[kept]])
    assert largest_cliques(edges, 40, 40, 1000, 10**7).complete
    assert not largest_cliques(edges, 40, 40, 1000, 50).complete
