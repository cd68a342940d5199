"""Every associator against brute force on small problems, ambiguous on purpose; and how associators are named."""

import dataclasses
import inspect
import pickle

import numpy as np
import pytest

from slam_gym.association import (
    ASSOCIATORS,
    jcbb,
    map_hypothesis,
    nearest_neighbour,
    resolve_associator,
    singles,
    true_association,
)
from slam_gym.types import UNPAIRED
from tests.oracles import association as oracles

CONFIDENCES = (0.9, 0.95, 0.99)
BLIND = [associator for name, associator in ASSOCIATORS.items() if name != "true_association"]


def small_problem(seed, **options):
    """A problem that brute force can still enumerate, and a confidence to solve it at."""
    rng = np.random.default_rng(seed)
    spread = float(rng.choice([1.0, 1.5, 2.0, 3.0]))
    m, n, confidence = int(rng.integers(0, 7)), int(rng.integers(0, 9)), CONFIDENCES[seed % 3]
    return *oracles.problem(rng, m, n, spread=spread, confidence=confidence, **options), confidence


def as_features(prediction, rows):
    return [UNPAIRED if row == UNPAIRED else int(prediction.features[row]) for row in rows]


def check(answer, scan, prediction, rows):
    """`answer` pairs these rows, and its distance is theirs."""
    assert answer.features.tolist() == as_features(prediction, rows)
    pairs = [(i, row) for i, row in enumerate(rows) if row != UNPAIRED]
    assert answer.joint_distance == pytest.approx(oracles.distance(scan, prediction, pairs), rel=1e-8, abs=1e-10)
    assert answer.dof == 2 * len(pairs)


@pytest.mark.parametrize("seed", range(200))
def test_nearest_neighbour(seed):
    scan, prediction, confidence = small_problem(seed)
    answer = nearest_neighbour(scan, prediction)
    check(answer, scan, prediction, oracles.nearest(scan, prediction, confidence))


@pytest.mark.parametrize("seed", range(200))
def test_singles(seed):
    scan, prediction, confidence = small_problem(seed)
    answer = singles(scan, prediction)
    check(answer, scan, prediction, oracles.singles(scan, prediction, confidence))


@pytest.mark.parametrize("seed", range(300))
def test_jcbb(seed):
    scan, prediction, confidence = small_problem(seed)
    rows, distance = oracles.jcbb(scan, prediction, confidence)
    answer = jcbb(scan, prediction)
    check(answer, scan, prediction, rows)
    assert answer.joint_distance == pytest.approx(distance, rel=1e-8, abs=1e-10)
    assert not answer.effort.limit_hit


@pytest.mark.parametrize("seed", range(300))
def test_jcbb_with_locality(seed):
    scan, prediction, confidence = small_problem(1000 + seed, locality=True)
    check(
        jcbb(scan, prediction),
        scan,
        prediction,
        oracles.jcbb(scan, prediction, confidence)[0],
    )
    check(
        jcbb(scan, prediction.without_locality()),
        scan,
        prediction,
        oracles.jcbb(scan, prediction, confidence, locality=False)[0],
    )


def test_the_problems_above_are_hard_enough():
    """Most answers differ between associators, ties of pairings are broken, and locality changes the answer."""
    neighbours = ties = localities = paired = 0
    for seed in range(300):
        scan, prediction, confidence = small_problem(1000 + seed, locality=True)
        best = jcbb(scan, prediction.without_locality())
        paired += best.dof // 2
        neighbours += not np.array_equal(best.features, nearest_neighbour(scan, prediction).features)
        localities += not np.array_equal(best.features, jcbb(scan, prediction).features)
        rows = oracles.greedy(scan, prediction, confidence)
        as_many = sum(row != UNPAIRED for row in rows) == best.dof // 2
        ties += as_many and as_features(prediction, rows) != best.features.tolist()
    assert neighbours > 100 and localities > 50 and ties > 25 and paired > 400, (neighbours, localities, ties, paired)


@pytest.mark.parametrize("seed", range(40))
def test_jcbb_on_scans_of_full_size_is_legal_and_no_worse_than_a_greedy_path(seed):
    rng = np.random.default_rng(seed)
    scan, prediction = oracles.problem(rng, 14, 25, spread=3.0)
    answer = jcbb(scan, prediction)
    row_of = {int(feature): row for row, feature in enumerate(prediction.features)}
    pairs = [(i, row_of[int(f)]) for i, f in enumerate(answer.features) if f != UNPAIRED]
    assert len({row for _, row in pairs}) == len(pairs)
    for k in range(1, len(pairs) + 1):
        assert oracles.distance(scan, prediction, pairs[:k]) < oracles.gate(2 * k, 0.99)
    greedy = oracles.greedy(scan, prediction, 0.99)
    assert len(pairs) >= sum(row != UNPAIRED for row in greedy)


@pytest.mark.parametrize("seed", range(20))
def test_a_locality_that_holds_everything_changes_nothing(seed):
    scan, prediction, _ = small_problem(seed, locality=True)
    everything = dataclasses.replace(
        prediction, near=np.ones(len(prediction), np.bool_), local=lambda rows: np.ones((len(rows),) * 2, bool)
    )
    answer = jcbb(scan, everything)
    assert answer.features.tolist() == jcbb(scan, prediction.without_locality()).features.tolist()


def test_the_node_limit_is_reported_and_leaves_the_best_answer_so_far():
    scan, prediction = oracles.problem(np.random.default_rng(2), 12, 14, spread=1.0)
    free = jcbb(scan, prediction)
    assert not free.effort.limit_hit and free.effort.nodes > 50
    pairings = []
    for limit in (1, 2, 5, 20, free.effort.nodes - 1, free.effort.nodes):
        answer = jcbb(scan, prediction, node_limit=limit)
        assert answer.effort.nodes == limit
        assert answer.effort.limit_hit == (limit < free.effort.nodes)
        pairings.append((answer.features != UNPAIRED).sum())
    assert pairings[0] == 1 and sorted(pairings) == pairings
    assert answer.features.tolist() == free.features.tolist()


@pytest.mark.parametrize("seed", range(10))
def test_the_bound_counts_features_that_are_left_not_only_levels(seed):
    """Ten measurements of the same three features: a bound by levels would visit more than a thousand hypotheses."""
    scan, prediction = oracles.problem(np.random.default_rng(seed), 10, 3, spread=0.2, noise=0.3)
    answer = jcbb(scan, prediction)
    assert answer.dof == 6
    assert answer.effort.nodes < 500


@pytest.mark.parametrize("confidence", [0.0, 1.0, 1.5, np.nan])
def test_a_confidence_that_is_none_is_refused(confidence):
    scan, prediction = oracles.problem(np.random.default_rng(0), 3, 3, confidence=confidence)
    with pytest.raises(ValueError, match="confidence"):
        jcbb(scan, prediction)


def test_a_meaningless_node_limit_is_refused():
    with pytest.raises(ValueError, match="node_limit"):
        jcbb(*oracles.problem(np.random.default_rng(0), 3, 3), node_limit=0)


@pytest.mark.parametrize("associator", BLIND)
@pytest.mark.parametrize(("m", "n"), [(0, 0), (0, 4), (4, 0)])
def test_nothing_to_associate(associator, m, n):
    answer = associator(*oracles.problem(np.random.default_rng(0), m, n))
    assert answer.features.tolist() == [UNPAIRED] * m
    assert (answer.joint_distance, answer.dof) == (0.0, 0)


@pytest.mark.parametrize("associator", BLIND)
@pytest.mark.parametrize("seed", range(20))
def test_what_holds_of_every_associator(associator, seed):
    """Pairings are individually compatible, the distance is theirs, and the arguments are left as they were."""
    scan, prediction = oracles.problem(np.random.default_rng(seed), 8, 12, spread=2.0, locality=seed % 2 == 0)
    before = pickle.dumps((scan, prediction.positions, prediction.covariances, prediction.features))
    answer = associator(scan, prediction)
    assert pickle.dumps((scan, prediction.positions, prediction.covariances, prediction.features)) == before
    assert answer.features.dtype == np.int64 and answer.features.shape == (8,)
    row_of = {int(feature): row for row, feature in enumerate(prediction.features)} | {UNPAIRED: UNPAIRED}
    rows = [row_of[int(feature)] for feature in answer.features]
    check(answer, scan, prediction, rows)
    gate = 0.999 if associator is map_hypothesis else 0.99
    for row, found in zip(rows, oracles.compatible(scan, prediction, gate)):
        assert row == UNPAIRED or row in [j for _, j in found]
    again = associator(scan, prediction)
    assert again.features.tolist() == answer.features.tolist() and again.effort == answer.effort


@pytest.mark.parametrize("seed", range(20))
def test_true_association_pairs_by_identity(seed):
    rng = np.random.default_rng(seed)
    scan, prediction = oracles.problem(rng, 6, 8)
    identities = rng.permutation(100)[: int(prediction.features.max()) + 1]
    sources = np.array([UNPAIRED, 1000, -2, *identities[prediction.features[[5, 0]]], UNPAIRED])
    answer = true_association(scan, prediction, sources=sources, identities=identities)
    check(answer, scan, prediction, [UNPAIRED, UNPAIRED, UNPAIRED, 5, 0, UNPAIRED])


def test_true_association_takes_the_first_of_duplicates_and_never_pairs_spurious_with_spurious():
    scan, prediction = oracles.problem(np.random.default_rng(0), 3, 4)
    identities = np.full(int(prediction.features.max()) + 1, UNPAIRED)
    identities[prediction.features[[1, 3]]] = 7
    answer = true_association(scan, prediction, sources=np.array([UNPAIRED, 7, 8]), identities=identities)
    check(answer, scan, prediction, [UNPAIRED, 1, UNPAIRED])
    with pytest.raises(ValueError, match="sources"):
        true_association(scan, prediction, sources=np.array([1]), identities=identities)


def test_associators_are_found_by_name_by_module_or_as_themselves():
    assert resolve_associator("jcbb") is jcbb
    assert resolve_associator("slam_gym.association.tracking.nearest_neighbour:singles") is singles
    assert resolve_associator(nearest_neighbour) is nearest_neighbour
    for associator in ASSOCIATORS.values():
        assert pickle.loads(pickle.dumps(associator)) is associator


@pytest.mark.parametrize(
    "name", ["icp", "", "no.such.module:function", "slam_gym.association:nothing", "slam_gym.association:__all__", ":x"]
)
def test_an_unknown_associator_lists_the_known_ones(name):
    with pytest.raises(ValueError, match=r"known: .*jcbb, .*nearest_neighbour, .*singles, true_association"):
        resolve_associator(name)


def test_only_true_association_can_be_given_the_truth():
    for name, associator in ASSOCIATORS.items():
        assert ("sources" in inspect.signature(associator).parameters) == (name == "true_association")
