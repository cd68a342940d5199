"""Which triples of a scan are looked up: what they promise to cover, by brute force over all subsets."""

import itertools
import math

import numpy as np
import pytest

from slam_gym.association.triangles.index import FeatureIndex
from slam_gym.association.triangles.search import _triples, covers
from tests.association.triangles.small_maps import field, is_near, landmarks_at, look_at, scan_at, store_of, view


def test_any_four_of_a_loose_group_hold_a_triple_looked_up() -> None:
    for size in range(4, 13):
        triples = [set(t) for t in itertools.combinations(range(size), 3) if covers(0, size, *sorted(t, reverse=True))]
        assert all(any(t <= set(four) for t in triples) for four in itertools.combinations(range(size), 4))
        assert len(triples) <= math.comb(size, 3) / 1.9


def test_triples_wider_than_the_index_are_searched_too() -> None:
    rng = np.random.default_rng(16)
    truth = field(rng, 150)
    index = FeatureIndex(landmarks_at(truth), reach=3.0, noise=0.07)
    right = 0
    for _ in range(25):
        scan, pose, _ = view(rng, truth, 8, 1)
        answer = index.relocate(scan)
        right += answer.accepted and is_near(answer, pose)
    assert right >= 23


@pytest.mark.parametrize("loose", [False, True])
@pytest.mark.parametrize("groups", [1, 2, 3, 4])
def test_any_measurements_one_more_than_two_for_each_group_hold_a_triple_looked_up(groups: int, loose: bool) -> None:
    rng, m = np.random.default_rng(37), 12
    store = store_of(FeatureIndex(landmarks_at(field(rng, 30))))
    look, done = look_at(scan_at(rng.uniform(-5.0, 5.0, (m, 2)))), np.zeros(math.comb(m, 3), np.bool_)
    triples = {frozenset(t.tolist()) for t in _triples(look, store, groups, loose, done)[0]}
    for some in itertools.combinations(range(m), 2 * groups + 1 + loose):
        assert any(frozenset(t) in triples for t in itertools.combinations(some, 3))
    assert len(triples) < math.comb(m, 3) or (groups == 1 and not loose)


def test_no_more_triples_are_looked_up_than_there_are() -> None:
    rng = np.random.default_rng(38)
    truth = field(rng, 200)
    index = FeatureIndex(landmarks_at(truth))
    for m in (3, 6, 9):
        scan = view(rng, field(rng, 60), m, 0)[0]
        answer = index.relocate(scan, min_pairings=min(m, 4), exhaustive=True)
        assert 1 <= answer.effort.tries <= math.comb(m, 3)
