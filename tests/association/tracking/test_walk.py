"""Walks of the tree by a learner: the mask by brute force, hypotheses, arguments."""

import numpy as np
import pytest

from slam_gym.association.policy import from_policy, greedy
from slam_gym.association.tracking.walk import (
    COMPATIBILITIES,
    FEWEST_PAIRED,
    NEW_CONFIDENCE,
    ORDERS,
    SHARE_PAIRED,
    Walk,
)
from slam_gym.types import UNPAIRED
from tests.oracles import association as oracles

CONFIDENCE = 0.99


def problems(count, m=6, n=9, **options):
    rng = np.random.default_rng(17)
    for _ in range(count):
        yield oracles.problem(rng, m, n, spread=1.5, **options)


def order_by_hand(scan, prediction, order):
    if order == "as_scanned":
        return list(range(len(scan)))
    if order == "nearest_first":
        return sorted(range(len(scan)), key=lambda i: np.hypot(*scan.points[i]))
    counts = [len(found) for found in oracles.compatible(scan, prediction, CONFIDENCE)]
    return sorted(range(len(scan)), key=lambda i: counts[i] or np.inf)


def walked(scan, prediction, rng, **options):
    """A random walk: (measurement, mask, rows, joint distances, hidden) of each choice, beside the pairs before it."""
    walk, pairs = Walk(scan, prediction, **options), []
    while not walk.done:
        i, action = walk.measurement, int(rng.choice(np.flatnonzero(walk.mask)))
        yield walk, list(pairs)
        if action < walk.K:
            pairs.append((i, int(walk.rows[action])))
        walk.take(action)
    assert walk.decided.tolist() == [dict(pairs).get(i, UNPAIRED) for i in range(len(scan))]
    found = walk.hypothesis()
    assert found.joint_distance == pytest.approx(oracles.distance(scan, prediction, pairs))
    assert found.dof == 2 * len(pairs)


def legal(scan, prediction, compatible, pairs, i, compatibility):
    """Rows that may be paired with measurement i after these pairs, nearest first."""
    rows = []
    for _, j in compatible[i]:
        longer = [*pairs, (i, j)]
        fits = oracles.distance(scan, prediction, longer) < oracles.gate(2 * len(longer), CONFIDENCE)
        if compatibility == "individual" or (fits and all(j != used for _, used in pairs)):
            rows.append(j)
    return rows


@pytest.mark.parametrize("compatibility", COMPATIBILITIES)
@pytest.mark.parametrize("order", ORDERS)
def test_the_mask_is_the_compatibility_test_of_the_path(order, compatibility):
    rng, choices, hid = np.random.default_rng(3), 0, 0
    for scan, prediction in problems(40):
        compatible = oracles.compatible(scan, prediction, CONFIDENCE)
        left = order_by_hand(scan, prediction, order)
        for walk, pairs in walked(scan, prediction, rng, candidates=2, order=order, compatibility=compatibility):
            while left[0] != walk.measurement:  # what was played without asking had no legal branch but `*`
                assert not legal(scan, prediction, compatible, pairs, left[0], compatibility)
                left.pop(0)
            right = legal(scan, prediction, compatible, pairs, left.pop(0), compatibility)
            assert walk.rows.tolist() == right[:2]
            assert walk.mask.tolist() == [k < len(right) for k in range(2)] + [True]
            assert walk.hidden == max(0, len(right) - 2)
            for row, distance in zip(right, walk.joint_distances):
                assert distance == pytest.approx(oracles.distance(scan, prediction, [*pairs, (walk.measurement, row)]))
            choices, hid = choices + 1, hid + (walk.hidden > 0)
        last = [pair for pair in enumerate(walk.decided.tolist()) if pair[1] != UNPAIRED]
        assert all(not legal(scan, prediction, compatible, last, i, compatibility) for i in left)
    assert choices > 100
    assert hid > 5


def test_an_illegal_action_and_one_at_a_leaf_are_refused():
    walk = Walk(*next(problems(1)), candidates=9)
    illegal = int(np.flatnonzero(~walk.mask)[0])
    for action in (illegal, -1, 10):
        with pytest.raises(ValueError, match="not legal"):
            walk.take(action)
    while not walk.done:
        walk.take(walk.K)
    assert not walk.mask.any()
    with pytest.raises(ValueError, match="not legal"):
        walk.take(walk.K)
    with pytest.raises(ValueError, match="done"):
        _ = walk.measurement


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"candidates": 0}, "candidates: expected a whole number"),
        ({"candidates": 2.5}, "candidates: expected a whole number"),
        ({"order": "by_luck"}, "as_scanned"),
        ({"compatibility": "none"}, "joint, individual"),
    ],
)
def test_bad_arguments_are_refused_by_name(options, message):
    with pytest.raises(ValueError, match=message):
        Walk(*next(problems(1)), **options)
    with pytest.raises(ValueError, match=message):
        from_policy(greedy, **options)


def test_new_is_what_fits_nothing_given_all_pairings():
    rng, gate, seen = np.random.default_rng(5), oracles.gate(2, NEW_CONFIDENCE), {True: 0, False: 0}
    for _ in range(60):
        scan, prediction = oracles.problem(rng, 10, 12, spread=4.0, spurious=0.2)
        walk, pairs = Walk(scan, prediction), []
        while not walk.done:
            action = walk.K if rng.random() < 0.1 else greedy(walk.observation(), walk.mask)
            if action < walk.K:
                pairs.append((walk.measurement, int(walk.rows[action])))
            walk.take(action)
        new, paired = walk.hypothesis().new, dict(pairs)
        if len(pairs) < max(FEWEST_PAIRED, SHARE_PAIRED * len(scan)):
            assert new is None
            continue
        before = oracles.distance(scan, prediction, pairs)
        for i in range(len(scan)):
            alone = [oracles.distance(scan, prediction, [(i, j)]) for j in range(len(prediction))]
            given = [oracles.distance(scan, prediction, [*pairs, (i, j)]) - before for j in range(len(prediction))]
            fits = any(a < gate and b < gate for a, b in zip(alone, given))
            assert new[i] == (i not in paired and not fits)
            seen[bool(new[i])] += 1
    assert min(seen.values()) > 10
    assert Walk(scan, prediction, compatibility="individual").hypothesis().new is None
