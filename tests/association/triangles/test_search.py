"""Which triples of a scan are looked up: what they promise to cover, by brute force over all subsets."""

import itertools
import math

import numpy as np
import pytest

from slam_gym.association.triangles.index import FeatureIndex
from slam_gym.association.triangles.search import _groups, _instead_of, _near_groups, _triples, covers
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
    triples = {frozenset(t.tolist()) for t in _triples(look, store, *_groups(look.points, groups), loose, done)[0]}
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


def test_so_do_they_where_others_stand_for_triples_too_wide() -> None:
    rng, m, groups, replaced = np.random.default_rng(46), 14, 3, 0
    for reach, loose, grouped in itertools.product((4.0, 5.0, 6.0), (False, True), (False, True, False)):
        store = store_of(FeatureIndex(landmarks_at(field(rng, 30)), reach=reach, noise=0.07))
        look, done = look_at(scan_at(2.0 * rng.standard_normal((m, 2)))), np.zeros(math.comb(m, 3), np.bool_)
        order, starts = _near_groups(look, store, groups) if grouped else _groups(look.points, groups)
        assert sorted(order) == list(range(m)) and starts[0] == 0 and starts[-1] == m
        triples, indexed = _triples(look, store, order, starts, loose, done)
        looked_up = [set(t) for t in triples[:indexed].tolist()]
        for triple in triples[indexed:]:
            others = _instead_of(look, store, triple, order, starts, loose).tolist()
            for one in others:
                assert len({*one[:3]} & {*triple.tolist()}) == 2 and {*triple.tolist()} <= {*one}
            looked_up += [set(one) for one in others] or [set(triple.tolist())]
            replaced += len(others) > 0
        for some in itertools.combinations(range(m), 2 * groups + 1 + loose):
            assert any(t <= set(some) for t in looked_up)
    assert replaced > 3


def test_groups_hold_fewer_triples_too_wide_once_measurements_have_moved() -> None:
    rng, before, after = np.random.default_rng(47), 0, 0
    store = store_of(FeatureIndex(landmarks_at(field(rng, 30)), reach=5.0, noise=0.07))
    for _ in range(20):
        look, none = look_at(scan_at(rng.uniform(-4.0, 4.0, (15, 2)))), np.zeros(math.comb(15, 3), np.bool_)
        for grouped in (_groups(look.points, 3), _near_groups(look, store, 3)):
            triples, indexed = _triples(look, store, *grouped, False, none)
            before, after = after, len(triples) - indexed
        assert after <= before
