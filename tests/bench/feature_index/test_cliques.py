"""Cliques of consistent pairings, beside the index."""

import itertools
import math

import numpy as np
import pytest
from scipy.special import chdtri

from slam_gym.bench.feature_index.cliques import (
    PEERS,
    agreement,
    beside,
    by_cliques,
    consistency_edges,
    installed,
    pairs_by_length,
)
from slam_gym.bench.feature_index.problems import SIGMA, QueryKind, point_map, query


@pytest.fixture(scope="module")
def asked():
    rng = np.random.default_rng(0)
    truth, landmarks = point_map(25, rng)
    return landmarks, [query(truth, QueryKind(6, 0.0, False), rng) for _ in range(4)]


def test_edges_join_pairings_that_agree_in_distance(asked):
    landmarks, queries = asked
    n, gate = len(landmarks), math.sqrt(chdtri(1, 0.01) * 4.0 * SIGMA**2)
    F, z = landmarks.positions, queries[0].scan.points
    expected = {
        frozenset((i * n + j, k * n + l))
        for i, k in itertools.combinations(range(len(z)), 2)
        for j, l in itertools.permutations(range(n), 2)
        if abs(math.dist(z[i], z[k]) - math.dist(F[j], F[l])) <= gate
    }
    edges = consistency_edges(queries[0].scan, pairs_by_length(landmarks), n)
    assert {frozenset(edge) for edge in edges.tolist()} == expected and len(edges) == len(expected)


@pytest.mark.parametrize("name", PEERS)
def test_peers_find_the_largest_clique(name):
    pytest.importorskip(name)
    edges = np.array([*itertools.combinations((1, 3, 4, 7), 2), (0, 1), (0, 2), (1, 2), (5, 6)])
    found = PEERS[name](edges, 8)
    assert sorted(found.answer) == [1, 3, 4, 7] and found.microseconds >= 0.0


@pytest.mark.parametrize("name", PEERS)
def test_scans_without_clutter_are_placed_by_their_clique(name, asked):
    pytest.importorskip(name)
    landmarks, queries = asked
    records = by_cliques(PEERS[name], queries, landmarks, pairs_by_length(landmarks), 60.0)
    assert len(records) == 4 and sum(record["right"] for record in records) >= 3
    assert len(by_cliques(PEERS[name], queries, landmarks, pairs_by_length(landmarks), -1.0)) == 0


def test_a_peer_is_compared_on_the_scans_that_it_had_the_time_for():
    records = [{"right": True, "ms": 4.0, "graph ms": 1.0}, {"right": False, "ms": 6.0, "graph ms": 3.0}]
    of_index = [{"index": k < 1, "ms": 2.0} for k in range(4)]
    row = beside("peer", records, of_index)
    assert (row["peer"], row["peer: scans"], row["peer: index on those"]) == (0.5, 2, 0.5)
    assert (row["peer: ratio"], row["graph ms"]) == (2.5, 2.0)


def test_every_kind_of_scan_has_a_row():
    rows = agreement((100,), 1, installed()[:1], 0.0, np.random.default_rng(0))
    assert len(rows) == 12 and all(0.0 <= row["index"] <= 1.0 for row in rows)
