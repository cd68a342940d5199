"""Cliques of consistent pairings against all sets of them, and the limits."""

import networkx as nx
import numpy as np

from slam_gym.association import max_clique
from slam_gym.association.relocation import cliques
from tests.oracles import relocation as oracles
from tests.oracles.statistics import for_seeds


@for_seeds(12)
def test_max_clique_finds_the_largest_set_of_mutually_consistent_pairings(seed):
    scan, landmarks, P, localities = oracles.small_problem(seed)
    for locality in localities.values():
        found = max_clique(scan, landmarks, locality)
        related = oracles.relation(locality, len(landmarks))
        best = [b for b in oracles.mutual(scan, landmarks, P, related, 0.99) if len(b) > 1]
        most = max(map(len, best), default=0)
        largest = [b for b in best if len(b) == most and oracles.holds(scan, landmarks, P, b, 0.99)]
        if largest:
            # mirror images are among these cliques, and may have a second optimum: ties are not compared
            oracles.check_against(found, largest, scan, landmarks, P, ties=False)
        else:
            assert found.pairings < max(most, 1)


def test_all_largest_cliques_are_found_and_no_other():
    rng = np.random.default_rng(0)
    for _ in range(60):
        a, b = np.triu_indices(int(rng.integers(2, 60)), 1)
        kept = rng.random(len(a)) < rng.uniform(0.02, 0.6)
        edges = np.column_stack([a[kept], b[kept]])
        maximal = [tuple(sorted(clique)) for clique in nx.find_cliques(nx.Graph(edges.tolist()))]
        most = max(map(len, maximal), default=0)
        found, complete = cliques.largest_cliques(edges)
        assert complete
        assert sorted(tuple(sorted(c)) for c in found.tolist()) == sorted(c for c in maximal if len(c) == most)


def test_too_many_largest_cliques_are_said_to_be():
    a, b = np.triu_indices(18, 1)
    kept = a % 9 != b % 9  # nine pairs that are not joined: 2⁹ largest cliques
    found, complete = cliques.largest_cliques(np.column_stack([a[kept], b[kept]]))
    assert not complete and found.shape == (256, 9)


def test_a_graph_of_exponentially_many_cliques_is_left_at_the_limit():
    a, b = np.triu_indices(90, 1)
    kept = a // 3 != b // 3  # thirty triples that are not joined: 3³⁰ maximal cliques (Moon and Moser, 1965)
    found, complete = cliques.largest_cliques(np.column_stack([a[kept], b[kept]]))
    assert not complete and found.shape == (256, 30)
