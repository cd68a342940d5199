"""Candidates conditioned on a path one by one: against the formula of an EKF update."""

import math

import numpy as np
import pytest

from slam_gym.association.compatibility import individual
from slam_gym.association.tracking.path import append, distances_after, distances_with, follow, path_of, support_of
from slam_gym.association.tree import interpretation_tree
from tests.oracles import association as oracles


def plant(seed):
    scan, prediction = oracles.problem(np.random.default_rng(seed), 5, 7, spread=1.5)
    tree = interpretation_tree(scan, prediction, individual(scan, prediction))
    pairs = [(int(i), int(tree.rows[s])) for i, s in zip(tree.pairings.measured, tree.pairings.slots)]
    return scan, prediction, tree, pairs


@pytest.mark.parametrize("seed", range(30))
def test_distances_after_a_path_and_with_one_more_pairing_are_those_of_an_update(seed):
    scan, prediction, tree, pairs = plant(seed)
    rng, pairings, made = np.random.default_rng(seed), tree.pairings, []
    path, distances = path_of(pairings, 4), np.empty(len(pairs))
    for c in rng.permutation(len(pairs)).tolist():
        if len(made) < 3 and all(pairs[c][0] != pairs[d][0] and pairs[c][1] != pairs[d][1] for d in made):
            append(path, len(made), c, follow(pairings, path, len(made), c))
            made.append(c)
    distances_after(pairings, path, len(made), distances)
    for c, pair in enumerate(pairs):
        if c not in made and all(pair[1] != pairs[d][1] for d in made):
            expected = oracles.conditioned(scan, prediction, [pairs[d] for d in made], pair)
            assert distances[c] == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("seed", range(30))
def test_support_counts_who_still_has_a_candidate_after_one_pairing(seed):
    scan, prediction, tree, pairs = plant(seed)
    gate, distances, path = oracles.gate(2, 0.99), np.empty(len(pairs)), path_of(tree.pairings, 2)
    for anchor, (i, j) in enumerate(pairs):
        distances_with(tree.pairings, path, anchor, distances)
        others = set()
        for c, (k, l) in enumerate(pairs):
            if c == anchor:
                assert distances[c] == pytest.approx(oracles.conditioned(scan, prediction, [], (i, j)), rel=1e-8)
            elif k == i or l == j:
                assert distances[c] == math.inf
            else:
                expected = oracles.conditioned(scan, prediction, [(i, j)], (k, l))
                assert distances[c] == pytest.approx(expected, rel=1e-8)
                others |= {k} if expected < gate else set()
        assert support_of(tree.pairings, path, anchor, gate) == len(others)
