"""Walks of the tree by a learner: the mask by brute force, hypotheses, observations, and policies as associators."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from slam_gym.association import jcbb, nearest_neighbour, singles
from slam_gym.association.tracking.observation import CANDIDATE_FIELDS, PATH_FIELDS, lengths, nothing
from slam_gym.association.tracking.policy import from_policy, greedy
from slam_gym.association.tracking.walk import COMPATIBILITIES, ORDERS, Walk
from slam_gym.association.tree import branches, extend, root
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
    assert walk.hypothesis().joint_distance == pytest.approx(oracles.distance(scan, prediction, pairs))


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


def test_walks_agree_with_the_nodes_of_the_tree():
    rng = np.random.default_rng(0)
    for scan, prediction in problems(20):
        for walk, pairs in walked(scan, prediction, rng, candidates=9):
            node = root(walk.tree)
            decided = dict(pairs)
            for level in range(walk.level):
                node = extend(walk.tree, node, decided.get(int(walk.candidates.measurements[level]), UNPAIRED))
            offer = branches(walk.tree, node)
            np.testing.assert_array_equal(offer.rows[offer.legal], walk.rows)
            np.testing.assert_allclose(offer.joint[offer.legal], walk.joint_distances)


def test_greedy_is_sequential_compatibility_nearest_neighbour():
    associate = from_policy(greedy)
    for scan, prediction in problems(60):
        expected = oracles.greedy(scan, prediction, CONFIDENCE)
        features = [UNPAIRED if row == UNPAIRED else prediction.features[row] for row in expected]
        np.testing.assert_array_equal(associate(scan, prediction).features, features)


def played(walk, hypothesis):
    """The walk by which a hypothesis decides; None where it leaves the tree."""
    while not walk.done:
        feature = hypothesis.features[walk.measurement]
        row = UNPAIRED if feature == UNPAIRED else int(np.flatnonzero(walk.tree.prediction.features == feature)[0])
        action = walk.action_of(row)
        if action is None:
            return None
        walk.take(action)
    return walk.hypothesis()


@pytest.mark.parametrize(
    ("associate", "compatibility"),
    [(nearest_neighbour, "individual"), (singles, "individual"), (jcbb, "individual"), (jcbb, "joint")],
)
def test_classical_hypotheses_are_walks(associate, compatibility):
    for scan, prediction in problems(40):
        direct = associate(scan, prediction)
        through = played(Walk(scan, prediction, candidates=9, compatibility=compatibility), direct)
        np.testing.assert_array_equal(through.features, direct.features)
        assert through.joint_distance == pytest.approx(direct.joint_distance)
        assert through.dof == direct.dof


def test_refusing_everything_pairs_nothing():
    refuse = from_policy(lambda observation, mask: len(mask) - 1)
    for scan, prediction in problems(5):
        answer = refuse(scan, prediction)
        assert (answer.features == UNPAIRED).all()
        assert (answer.joint_distance, answer.dof) == (0.0, 0)


@pytest.mark.parametrize("locality", [False, True])
def test_observations_are_finite_scaled_fresh_and_as_long_as_said(locality):
    rng = np.random.default_rng(1)
    for scan, prediction in problems(30, locality=locality):
        k = len(prediction)
        prediction = replace(prediction, sizes=rng.uniform(0.1, 1.0, k), size_variances=np.full(k, 0.01))
        sizes = np.where(rng.random(len(scan)) < 0.5, np.nan, 0.3)
        scan = replace(scan, sizes=sizes, size_variances=np.full(len(scan), 0.01))
        for walk, _ in walked(scan, replace(prediction, ages=np.arange(k)), rng, candidates=4):
            seen, again = walk.observation(), walk.observation()
            assert {name: len(vector) for name, vector in seen.items()} == lengths(4)
            for name, vector in seen.items():
                assert vector.dtype == np.float32
                assert np.abs(vector).max() <= 1.0
                assert vector is not again[name]
                np.testing.assert_array_equal(vector, again[name])
        assert all(not vector.any() for vector in walk.observation().values())


def test_candidates_show_what_they_say():
    rng, checked = np.random.default_rng(2), 0
    for scan, prediction in problems(40, locality=True):
        prediction = replace(prediction, ages=rng.integers(0, 300, len(prediction)))
        compatible = oracles.compatible(scan, prediction, CONFIDENCE)
        related = prediction.local(np.arange(len(prediction)))
        for walk, pairs in walked(scan, prediction, rng, candidates=9):
            table = walk.observation()["candidates"].reshape(9, -1)
            column = dict(zip(CANDIDATE_FIELDS, table.T.astype(float)))
            path = dict(zip(PATH_FIELDS, walk.observation()["path"].astype(float)))
            k, later = len(walk.rows), walk.candidates.measurements[walk.level + 1 :].tolist()
            left = [i for i in later if compatible[i]]
            assert column["legal"].tolist() == [1.0] * k + [0.0] * (9 - k)
            np.testing.assert_allclose(_unsquash(path["left"], 10.0), len(left), atol=1e-4)
            np.testing.assert_allclose(_unsquash(path["pairings"], 10.0), len(pairs), atol=1e-4)
            assert path["support"] * max(len(left), 1) == pytest.approx(
                sum(_follows(scan, prediction, compatible, pairs, i) for i in left), abs=1e-4
            )
            for c, row in enumerate(walk.rows.tolist()):
                longer = [*pairs, (walk.measurement, row)]
                gate = oracles.gate(2 * len(longer), CONFIDENCE)
                distance = oracles.distance(scan, prediction, longer)
                assert _unsquash(column["joint"][c], gate) == pytest.approx(distance, rel=1e-4)
                assert _unsquash(column["age"][c], 50.0) == pytest.approx(prediction.ages[row], rel=1e-3)
                assert column["near"][c] == prediction.near[row]
                assert column["size"][c] == -1.0
                covisible = np.mean([related[row, used] for _, used in pairs]) if pairs else 0.0
                assert column["covisible"][c] == pytest.approx(covisible)
                rivals = sum(any(j == row for _, j in compatible[i]) for i in later)
                assert _unsquash(column["rivals"][c], 3.0) == pytest.approx(rivals, abs=1e-4)
                support = sum(_follows(scan, prediction, compatible, longer, i) for i in left)
                assert column["support"][c] * max(len(left), 1) == pytest.approx(support, abs=1e-4)
                checked += 1
    assert checked > 200


def _unsquash(value, scale):
    return scale * value / (1.0 - abs(value))


def _follows(scan, prediction, compatible, pairs, i):
    """Whether measurement i could be paired right after these pairs."""
    gate = oracles.gate(2 * len(pairs) + 2, CONFIDENCE)
    free = [j for _, j in compatible[i] if all(j != used for _, used in pairs)]
    return any(oracles.distance(scan, prediction, [*pairs, (i, j)]) < gate for j in free)


@pytest.mark.parametrize(("m", "n"), [(0, 5), (4, 0), (0, 0), (1, 1)])
def test_small_problems(m, n):
    scan, prediction = next(problems(1, m=m, n=n))
    assert len(from_policy(greedy)(scan, prediction).features) == m


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
        ({"candidates": 0}, "candidates: 0"),
        ({"order": "by_luck"}, "as_scanned"),
        ({"compatibility": "none"}, "joint, individual"),
    ],
)
def test_bad_arguments_are_refused_by_name(options, message):
    with pytest.raises(ValueError, match=message):
        Walk(*next(problems(1)), **options)
    with pytest.raises(ValueError, match=message):
        from_policy(greedy, **options)


def test_bad_numbers_are_refused_by_name():
    scan, prediction = next(problems(1))
    points = scan.points.copy()
    points[2, 1] = np.nan
    with pytest.raises(ValueError, match=r"scan.points\[2\]"):
        from_policy(greedy)(replace(scan, points=points), prediction)


def test_a_policy_associator_pickles():
    associate = pickle.loads(pickle.dumps(from_policy(greedy, candidates=2)))
    scan, prediction = next(problems(1))
    expected = from_policy(greedy, candidates=2)(scan, prediction).features
    np.testing.assert_array_equal(associate(scan, prediction).features, expected)


def test_nothing_is_an_observation_of_zeros():
    assert {name: vector.tolist() for name, vector in nothing(2).items()} == {
        name: [0.0] * length for name, length in lengths(2).items()
    }
