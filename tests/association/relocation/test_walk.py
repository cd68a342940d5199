"""The tree without a prior as learners walk it: legality and look-ahead by brute force, searches played through it."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from slam_gym.association import gcbb
from slam_gym.association.relocation.observation import observe_walk, walk_shapes
from slam_gym.association.relocation.policy import SampledRelocation, greedy_relocation, relocator_from_policy
from slam_gym.association.relocation.walk import RelocationWalk, WalkSpec
from slam_gym.types import NONE, UNKNOWN
from tests.oracles import relocation as oracles

LOCALITIES = ["everything", "distance", "covisibility"]
KEEPS = ["dense", "blocks", "none"]
ALL = WalkSpec(candidates=100, order="as_scanned", node_limit=10**6)


def plant(seed, m=4, n=7, **changes):
    rng = np.random.default_rng(seed)
    scan, landmarks, P = oracles.problem(rng, m, n, keep=KEEPS[seed % 3], **changes)
    return scan, landmarks, P, oracles.localities(rng, landmarks), rng


def easy(seed, m=8, n=25):
    """A scan that is plain to relocate: a wide map with small errors."""
    return plant(seed, m, n, spread=8.0, sigma=0.02)


def pairs_of(walk):
    return [(int(i), int(j)) for i, j in zip(walk.node.path.measurements, walk.node.path.features)]


def walk_randomly(walk, rng):
    """Yields at every decision, then takes a legal branch at random, until a leaf."""
    while walk.leaf is None:
        yield
        walk.take(int(rng.choice(np.flatnonzero(walk.mask[:-1]))))


# -- legal branches ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("locality", LOCALITIES)
@pytest.mark.parametrize("seed", range(40))
def test_on_offer_is_what_agrees_with_the_path_and_passed_by_is_what_nothing_agrees_with(seed, locality):
    scan, landmarks, P, localities, rng = plant(seed)
    related, n = oracles.relation(localities[locality], len(landmarks)), len(landmarks)
    walk = RelocationWalk(ALL, scan, landmarks, localities[locality])

    def legal(path, i):
        return {j for j in range(n) if oracles.legal(scan, landmarks, P, related, path, (i, j), 0.99)}

    for _ in walk_randomly(walk, rng):
        assert set(walk.offer.features.tolist()) == legal(pairs_of(walk), walk.measurement)
        assert walk.mask[: len(walk.offer.features)].all() and not walk.mask[len(walk.offer.features) : -2].any()
    path = []
    for i, (j, (shown, action)) in enumerate(zip(walk.path, walk.offered, strict=True)):
        assert shown == len(legal(path, i))
        assert (action == ALL.star) == (j == NONE)
        path += [(i, j)] if j != NONE else []


@pytest.mark.parametrize("locality", LOCALITIES)
@pytest.mark.parametrize("seed", range(20))
def test_support_counts_the_measurements_that_keep_a_legal_partner_and_ranks_the_offer(seed, locality):
    scan, landmarks, P, localities, rng = plant(seed + 100)
    related, n = oracles.relation(localities[locality], len(landmarks)), len(landmarks)
    walk = RelocationWalk(ALL, scan, landmarks, localities[locality])
    for _ in walk_randomly(walk, rng):
        path, i = pairs_of(walk), walk.measurement
        later = range(i + 1, len(scan))

        def keeps(k, j, path=path, i=i):
            extended = [*path, (i, j)]
            return any(
                oracles.legal(scan, landmarks, P, related, path, (k, l), 0.99)
                and oracles.legal(scan, landmarks, P, related, extended, (k, l), 0.99)
                for l in range(n)
            )

        expected = [sum(keeps(k, j) for k in later) for j in walk.offer.features.tolist()]
        assert walk.offer.support.tolist() == expected
        order = sorted(range(len(expected)), key=lambda c: (-expected[c], walk.offer.mean[c]))
        assert order == list(range(len(expected)))
        local = [np.mean([related is None or related[j, l] for _, l in path] or [1.0]) for j in walk.offer.features]
        np.testing.assert_allclose(walk.offer.local, local)


@pytest.mark.parametrize("seed", range(20))
def test_distances_of_a_candidate_are_those_of_the_binary_constraint(seed):
    scan, landmarks, P, _, rng = plant(seed + 200)
    walk = RelocationWalk(ALL, scan, landmarks)
    for _ in walk_randomly(walk, rng):
        for j, mean, worst in zip(walk.offer.features.tolist(), walk.offer.mean, walk.offer.worst):
            squares = []
            for k, l in pairs_of(walk):
                along = scan.points[k] - scan.points[walk.measurement]
                between = landmarks.positions[l] - landmarks.positions[j]
                u, v = along / np.linalg.norm(along), between / np.linalg.norm(between)
                D = np.zeros((2, len(P)))
                D[:, 2 * l : 2 * l + 2] += np.eye(2)
                D[:, 2 * j : 2 * j + 2] -= np.eye(2)
                of_scan = scan.covariances[k] + scan.covariances[walk.measurement]
                variance = u @ of_scan @ u + v @ D @ P @ D.T @ v
                squares.append((np.linalg.norm(along) - np.linalg.norm(between)) ** 2 / variance)
            np.testing.assert_allclose([mean, worst], [np.mean(squares or [0]), max(squares, default=0)], rtol=1e-6)


@pytest.mark.parametrize("seed", range(10))
def test_no_hypothesis_below_a_node_exceeds_its_bound(seed):
    scan, landmarks, P, localities, rng = plant(seed + 300)
    locality = localities["covisibility"]
    best = max((len(pairs) for pairs in oracles.gcbb(scan, landmarks, P, locality, 0.99)), default=0)
    walk = RelocationWalk(ALL, scan, landmarks, locality)
    assert walk.node.bound >= best
    bounds = [(walk.node.bound, len(walk.offer.features)) for _ in walk_randomly(walk, rng)]
    assert all(b >= walk.node.pairings for b, _ in bounds)
    assert [b for b, _ in bounds] == sorted((b for b, _ in bounds), reverse=True)


# -- searches played through the walk ------------------------------------------------------------------------------


def everything(walk):
    """Plays every path of the tree, try by try, and returns the answer."""
    todo = [[]]
    while todo:
        actions = todo.pop()
        for action in actions:
            walk.take(action)
        while walk.leaf is None:
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
    scan, landmarks, _, localities, _ = plant(seed + 400)
    found = everything(RelocationWalk(ALL, scan, landmarks, localities[locality]))
    expected = gcbb(scan, landmarks, localities[locality])
    assert (found.pairings, found.ties, found.min_pairings) == (
        expected.pairings,
        expected.ties,
        expected.min_pairings,
    )
    assert found.joint_distance == pytest.approx(expected.joint_distance, abs=1e-9)
    assert (found.accepted, found.ambiguous, found.dof) == (expected.accepted, expected.ambiguous, expected.dof)


@pytest.mark.parametrize("locality", LOCALITIES)
@pytest.mark.parametrize("seed", range(20))
def test_the_answer_of_gcbb_is_a_path_that_can_be_played_and_comes_to_the_same(seed, locality):
    scan, landmarks, _, localities, _ = easy(seed)
    expected = gcbb(scan, landmarks, localities[locality])
    walk = RelocationWalk(ALL, scan, landmarks, localities[locality])
    while walk.leaf is None:
        walk.take(walk.action_of(int(expected.features[walk.measurement])))
    found = walk.answer()
    np.testing.assert_array_equal(found.features, expected.features)
    np.testing.assert_allclose(found.pose, expected.pose, atol=1e-12)
    np.testing.assert_allclose(found.covariance, expected.covariance, atol=1e-12)
    assert found.joint_distance == pytest.approx(expected.joint_distance)
    assert found.effort.nodes == 1 + len(scan) and found.effort.tries == 1


# -- choices -------------------------------------------------------------------------------------------------------


def test_k_hides_candidates_and_says_so():
    scan, landmarks, *_ = plant(3, n=12)
    wide = RelocationWalk(ALL, scan, landmarks)
    narrow = RelocationWalk(replace(ALL, candidates=2), scan, landmarks)
    legal = len(wide.offer.features)
    assert legal > 2 and wide.hidden == 0 and narrow.hidden == legal - 2
    assert narrow.mask.tolist() == [True, True, True, False]
    assert wide.action_of(int(wide.offer.features[2])) == 2 and narrow.action_of(int(wide.offer.features[2])) is None
    assert narrow.action_of(NONE) == 2


def test_levels_are_in_the_order_asked_for():
    scan, landmarks, *_ = easy(5)
    orders = {}
    for order in ("as_scanned", "nearest_first", "fewest_candidates", "random"):
        walk = RelocationWalk(WalkSpec(order=order), scan, landmarks, rng=np.random.default_rng(1))
        orders[order] = walk.order.tolist()
        assert sorted(orders[order]) == list(range(len(scan)))
    assert orders["as_scanned"] == list(range(len(scan)))
    assert np.all(np.diff(np.hypot(*scan.points[orders["nearest_first"]].T)) >= 0.0)
    assert np.all(np.diff(walk.tree.problem.allowed.sum(axis=1)[orders["fewest_candidates"]]) >= 0)
    first = walk.order.tolist()
    walk.take(0)
    walk.take(walk.spec.restart)
    assert walk.order.tolist() != first  # dealt anew
    again = RelocationWalk(WalkSpec(order="random"), scan, landmarks, rng=np.random.default_rng(1))
    assert again.order.tolist() == first


def test_a_restart_keeps_the_best_and_counts_as_a_node():
    scan, landmarks, *_ = easy(1)
    walk = RelocationWalk(WalkSpec(order="as_scanned"), scan, landmarks)
    assert not walk.mask[walk.spec.restart]  # nothing to take back yet
    while walk.leaf is None:
        walk.take(0 if walk.mask[0] else walk.spec.star)
    best, nodes = walk.best, walk.nodes
    assert best.pairings >= 3 and nodes == 1 + len(scan)
    walk.take(walk.spec.restart)
    assert (walk.tries, walk.level, walk.best.pairings) == (2, 0, best.pairings) and walk.nodes == nodes + 1
    while walk.leaf is None:
        walk.take(walk.spec.star)
    assert walk.leaf.features.tolist() == [NONE] * len(scan) and not walk.leaf.compatible
    walk.take(walk.spec.star)
    assert walk.done and not walk.mask.any()
    np.testing.assert_array_equal(walk.answer().features, best.features)
    with pytest.raises(ValueError, match="not legal"):
        walk.take(walk.spec.star)


def test_what_was_paired_before_a_restart_is_judged():
    scan, landmarks, *_ = easy(1)
    walk = RelocationWalk(WalkSpec(order="as_scanned"), scan, landmarks)
    while walk.node.pairings < 3:
        walk.take(0)
    features = walk.node.path.features.copy()
    walk.take(walk.spec.restart)
    assert walk.best.pairings == 3 and sorted(walk.best.features[walk.best.features != NONE]) == sorted(features)


@pytest.mark.parametrize("limit", range(1, 14))
def test_the_node_limit_is_never_exceeded_and_ends_the_walk(limit):
    scan, landmarks, *_ = easy(1)
    walk = RelocationWalk(WalkSpec(node_limit=limit, order="as_scanned"), scan, landmarks)
    while not walk.done:
        choices = np.flatnonzero(walk.mask)
        walk.take(int(choices[-1] if walk.leaf else choices[0]))
    assert walk.nodes == limit and walk.answer().effort.limit_hit
    assert walk.best.pairings <= limit - 1


def test_sizes_off_looks_at_no_sizes():
    scan, landmarks, *_ = easy(2)
    other = replace(scan, sizes=scan.sizes + 5.0)
    walks = [RelocationWalk(WalkSpec(sizes=False), s, landmarks) for s in (scan, other)]
    assert walks[0].tree.problem.allowed.all()
    assert not RelocationWalk(WalkSpec(), other, landmarks).tree.problem.allowed.all()
    for a, b in zip(*(observe_walk(walk, 20).values() for walk in walks)):
        np.testing.assert_array_equal(a, b)


# -- observations --------------------------------------------------------------------------------------------------


def degenerate():
    scan, landmarks, *_ = easy(4)
    nothing = oracles.landmarks_of(np.empty((0, 2)), np.empty((0, 0)))
    unknown = np.full(len(scan), np.nan)

    def some(k):
        return oracles.scan_of(scan.points[:k], scan.covariances[:k])

    line = oracles.scan_of(np.stack([np.arange(5.0), np.zeros(5)], axis=1), np.tile(1e-4 * np.eye(2), (5, 1, 1)))
    return {
        "as it is": (scan, landmarks),
        "no sizes": (replace(scan, sizes=unknown, size_variances=unknown), landmarks),
        "kinds": (replace(scan, kinds=np.arange(len(scan)) % 3), replace(landmarks, kinds=np.arange(25) % 3)),
        "kinds unknown": (replace(scan, kinds=np.full(len(scan), UNKNOWN)), landmarks),
        "no measurements": (some(0), landmarks),
        "one": (some(1), landmarks),
        "two": (some(2), landmarks),
        "empty map": (scan, nothing),
        "nothing at all": (some(0), nothing),
        "more measurements than features": (scan, oracles.landmarks_of(landmarks.positions[:3], 1e-4 * np.eye(6))),
        "on a line": (line, oracles.landmarks_of(np.stack([np.arange(9.0), np.zeros(9)], 1), 1e-4 * np.eye(18))),
        "all in one place": (oracles.scan_of(np.ones((4, 2)), np.tile(np.eye(2), (4, 1, 1))), landmarks),
        "no noise": (oracles.scan_of(scan.points, np.zeros((len(scan), 2, 2))), landmarks),
    }


@pytest.mark.parametrize("order", ["fewest_candidates", "random"])
@pytest.mark.parametrize("case", degenerate())
def test_observations_are_finite_and_in_range_whatever_scan_and_map(case, order):
    scan, landmarks = degenerate()[case]
    rng = np.random.default_rng(0)
    walk, shapes = RelocationWalk(WalkSpec(5, order, 60), scan, landmarks, rng=rng), walk_shapes(5, 6)
    while True:
        observation = observe_walk(walk, 6)
        assert {name: part.shape for name, part in observation.items()} == {k: (a * b,) for k, (a, b) in shapes.items()}
        for name, part in observation.items():
            assert part.dtype == np.float32 and np.isfinite(part).all() and (np.abs(part) <= 1.0).all(), name
        if walk.done:
            break
        walk.take(int(rng.choice(np.flatnonzero(walk.mask))))
    answer = walk.answer()
    assert answer.features.shape == (len(scan),) and answer.effort.nodes <= 60
    assert np.isfinite(answer.pose).all() == (answer.pairings >= 2)


def test_nothing_observed_depends_on_where_the_map_lies():
    scan, landmarks, P, localities, _ = easy(6)
    C = oracles.rotation(2.0)
    T = np.kron(np.eye(len(landmarks)), C)
    kept = "dense" if len(landmarks.covariance) else "blocks" if len(landmarks.blocks) else "none"
    moved = oracles.landmarks_of(
        landmarks.positions @ C.T + [300.0, -70.0],
        T @ P @ T.T,
        keep=kept,
        sizes=landmarks.sizes,
        size_variances=landmarks.size_variances,
    )
    walks = [RelocationWalk(WalkSpec(order="as_scanned"), scan, m, localities["distance"]) for m in (landmarks, moved)]
    while walks[0].leaf is None:
        for name, part in observe_walk(walks[0], 9).items():
            np.testing.assert_allclose(part, observe_walk(walks[1], 9)[name], atol=1e-5, err_msg=name)
        for walk in walks:
            walk.take(0 if walk.mask[0] else walk.spec.star)
    np.testing.assert_array_equal(walks[0].path, walks[1].path)


# -- policies ------------------------------------------------------------------------------------------------------


def test_policies_are_relocators_that_pickle_and_repeat_themselves():
    for policy in (greedy_relocation, SampledRelocation(seed=3)):
        relocate = relocator_from_policy(policy, order="random", seed=4)
        for seed in range(3):
            scan, landmarks, _, localities, _ = easy(seed)
            answers = [find(scan, landmarks, localities["distance"]) for find in (relocate, relocate)]
            answers.append(pickle.loads(pickle.dumps(relocate))(scan, landmarks, localities["distance"]))
            for answer in answers[1:]:
                np.testing.assert_array_equal(answer.features, answers[0].features)
                assert answer.effort == answers[0].effort


def test_sampling_finds_what_gcbb_finds_with_less_effort_and_greedy_never_more():
    greedy = relocator_from_policy(greedy_relocation)
    sample = relocator_from_policy(SampledRelocation(50), candidates=25, order="random", node_limit=1000)
    found, nodes, plain = [], [], 0
    for seed in range(50, 80):
        scan, landmarks, *_ = easy(seed)
        expected = gcbb(scan, landmarks)
        one = greedy(scan, landmarks)
        assert one.effort.tries == 1 and one.pairings <= expected.pairings
        if expected.accepted:
            sampled = sample(scan, landmarks)
            found.append(sampled.accepted and np.allclose(sampled.pose, expected.pose, atol=0.2))
            nodes.append((sampled.effort.nodes, expected.effort.nodes))
            plain += one.accepted and np.allclose(one.pose, expected.pose, atol=0.2)
    assert len(found) >= 15
    assert np.mean(found) >= 0.85 and plain < sum(found)
    assert np.median(nodes, axis=0)[0] < 0.5 * np.median(nodes, axis=0)[1]


def test_bad_settings_and_actions_are_refused_by_name():
    scan, landmarks, _, localities, _ = easy(0)
    for bad, name in (
        (dict(candidates=0), "candidates"),
        (dict(candidates=2.5), "candidates"),
        (dict(node_limit=0), "node_limit"),
        (dict(order="any"), "order='any'; known: fewest_candidates"),
        (dict(confidence=1.0), "confidence"),
        (dict(measurements=0), "measurements"),
    ):
        with pytest.raises(ValueError, match=name):
            relocator_from_policy(greedy_relocation, **bad)
    for bad in (dict(tries=0), dict(temperature=0.0)):
        with pytest.raises(ValueError, match="tries, temperature"):
            SampledRelocation(**bad)
    with pytest.raises(ValueError, match="action 99 is not legal"):
        relocator_from_policy(lambda observation, mask: 99)(scan, landmarks)
    walk = RelocationWalk(WalkSpec(), scan, landmarks)
    for action in (-1, walk.spec.restart, walk.spec.actions):
        with pytest.raises(ValueError, match="not legal"):
            walk.take(action)
    with pytest.raises(ValueError, match="Locality"):
        RelocationWalk(
            WalkSpec(), scan, landmarks, oracles.localities(np.random.default_rng(0), plant(0)[1])["distance"]
        )
    scan.points[2, 0] = np.nan
    with pytest.raises(ValueError, match="measurement 2"):
        RelocationWalk(WalkSpec(), scan, landmarks, localities["distance"])
