"""Walks of the tree without a prior: searches played through them, orders, restarts, limits."""

from dataclasses import replace

import numpy as np
import pytest

from slam_gym.association import gcbb
from slam_gym.association.relocation.walk import RelocationWalk, WalkSpec
from slam_gym.types import UNPAIRED
from tests.oracles import relocation_walks as walks
from tests.oracles.relocation_walks import ALL, LOCALITIES


def everything(walk):
    """Plays every path of the tree, try by try, and returns the answer."""
    todo = [[]]
    while todo:
        actions = todo.pop()
        for action in actions:
            walk.take(action)
        while not walk.at_leaf:
            legal = np.flatnonzero(walk.mask[:-1]).tolist()
            todo += [[*actions, other] for other in legal[1:]]
            actions = [*actions, legal[0]]
            walk.take(legal[0])
        if walk.mask[walk.spec.restart] and todo:
            walk.take(walk.spec.restart)
    return walk.answer()


@pytest.mark.parametrize("locality", LOCALITIES)
@pytest.mark.parametrize("seed", range(25))
def test_every_path_played_comes_to_what_gcbb_finds(seed, locality):
    scan, landmarks, _, localities, _ = walks.plant(seed + 400)
    found = everything(RelocationWalk(ALL, scan, landmarks, localities[locality]))
    expected = gcbb(scan, landmarks, localities[locality])
    for name in ("pairings", "ties", "min_pairings", "accepted", "ambiguous", "dof"):
        assert getattr(found, name) == getattr(expected, name), name
    assert found.joint_distance == pytest.approx(expected.joint_distance, abs=1e-9)


def test_k_hides_candidates_and_says_so():
    scan, landmarks, *_ = walks.plant(3, n=12)
    wide = RelocationWalk(ALL, scan, landmarks)
    narrow = RelocationWalk(replace(ALL, candidates=2), scan, landmarks)
    legal = len(wide.offer.features)
    assert legal > 2 and wide.hidden == 0 and narrow.hidden == legal - 2
    assert narrow.mask.tolist() == [True, True, True, False]
    assert wide.action_of(int(wide.offer.features[2])) == 2 and narrow.action_of(int(wide.offer.features[2])) is None
    assert narrow.action_of(UNPAIRED) == 2


def test_levels_are_in_the_order_asked_for():
    scan, landmarks, *_ = walks.easy(5)
    orders = {}
    for order in ("as_scanned", "nearest_first", "fewest_candidates"):
        walk = RelocationWalk(WalkSpec(order=order), scan, landmarks)
        orders[order] = walk.order.tolist()
        assert sorted(orders[order]) == list(range(len(scan)))
    assert orders["as_scanned"] == list(range(len(scan)))
    assert np.all(np.diff(np.hypot(*scan.points[orders["nearest_first"]].T)) >= 0.0)
    assert np.all(np.diff(walk.problem.allowed.sum(axis=1)[orders["fewest_candidates"]]) >= 0)


def test_a_restart_keeps_the_best_and_counts_as_a_node():
    scan, landmarks, *_ = walks.easy(1)
    walk = RelocationWalk(WalkSpec(order="as_scanned"), scan, landmarks)
    assert not walk.mask[walk.spec.restart]  # nothing to take back yet
    while not walk.at_leaf:
        walk.take(0 if walk.mask[0] else walk.spec.star)
    best, nodes = walk.best, walk.nodes
    assert best.pairings >= 3 and nodes == 1 + len(scan)
    walk.take(walk.spec.restart)
    assert (walk.tries, walk.level, walk.best.pairings) == (2, 0, best.pairings) and walk.nodes == nodes + 1
    while not walk.at_leaf:
        walk.take(walk.spec.star)
    assert walk.node.hypothesis.tolist() == [UNPAIRED] * len(scan) and not walk.compatible
    walk.take(walk.spec.star)
    assert walk.done and not walk.mask.any()
    np.testing.assert_array_equal(walk.answer().features, best.features)
    with pytest.raises(ValueError, match="not legal"):
        walk.take(walk.spec.star)


def test_what_was_paired_before_a_restart_is_judged():
    scan, landmarks, *_ = walks.easy(1)
    walk = RelocationWalk(WalkSpec(order="as_scanned"), scan, landmarks)
    while walk.node.pairings < 3:
        walk.take(0)
    features = walk.node.path.features.copy()
    walk.take(walk.spec.restart)
    assert walk.best.pairings == 3 and sorted(walk.best.features[walk.best.features != UNPAIRED]) == sorted(features)


@pytest.mark.parametrize("limit", range(1, 14))
def test_the_node_limit_is_never_exceeded_and_ends_the_walk(limit):
    scan, landmarks, *_ = walks.easy(1)
    walk = RelocationWalk(WalkSpec(node_limit=limit, order="as_scanned"), scan, landmarks)
    while not walk.done:
        choices = np.flatnonzero(walk.mask)
        walk.take(int(choices[-1] if walk.at_leaf else choices[0]))
    assert walk.nodes == limit and walk.answer().effort.limit_hit
    assert walk.best.pairings <= limit - 1
