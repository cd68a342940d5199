"""Cliques of consistent pairings against all sets of them, and the spectral relaxation."""

import numpy as np
import pytest

from slam_gym.association import RELOCATORS, max_clique
from slam_gym.association.relocation.consistency_graph import _Graph, _leading_cluster
from tests.oracles import relocation as oracles


@pytest.mark.parametrize("seed", range(12))
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


def test_spectral_finds_the_robot_often_and_believes_nothing_outside():
    right = 0
    for seed in range(25):
        pose, scan, landmarks = oracles.inside(seed, m=8, true=8)
        found = RELOCATORS["spectral"](scan, landmarks, None)
        right += found.accepted and np.hypot(*(found.pose - pose)[:2]) < 0.3
        assert not RELOCATORS["spectral"](oracles.inside(seed + 100)[1], landmarks, None).accepted
    assert right >= 15


def test_edges_whose_weights_vanish_lead_to_no_hypothesis():
    features, edges = np.arange(4), np.array([[0, 1], [0, 2], [1, 3]])
    for weight in (0.0, 1e-200):
        assert _leading_cluster(_Graph(features, features, edges, np.full(3, weight))).size == 0
    found = _leading_cluster(_Graph(features, features, edges, np.array([1.0, 1e-200, 0.0])))
    assert sorted(found[0].tolist()) == [0, 1]
