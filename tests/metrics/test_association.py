"""Association metrics against hand-counted scenes, a plain re-count of random runs, and the laws between the counts."""

from collections import Counter, defaultdict
from dataclasses import astuple, replace

import numpy as np
import pytest

from slam_gym.association.prediction import Prediction, SlamStep
from slam_gym.metrics.association import Decision, Identities, Tally
from slam_gym.types import NO_ID, SPURIOUS, UNLABELLED, UNPAIRED, Effort, Hypothesis, Truth
from tests.oracles.statistics import for_seeds

SOMETHING = Prediction.from_gaussian([[1.0, 0.0]], np.eye(2))
NOTHING = Prediction.from_gaussian([], np.empty((0, 0)))  # of an empty map


def step(ids, created=None, removed=(), prediction=SOMETHING):
    ids = np.array(ids, np.int64)
    created = np.zeros(len(ids), bool) if created is None else np.array(created, bool)
    hypothesis = Hypothesis(np.full(len(ids), UNPAIRED), 0.0, 0, Effort())
    return SlamStep(prediction, hypothesis, ids, created, np.array(removed, np.int64))


def truth(*sources):
    return Truth(np.zeros(3), np.array(sources, np.int64))


def update(identities, taken, labels):
    """The tally of a step that is judged."""
    before = astuple(identities.total)
    identities.judge(taken, labels)
    return Tally(*(now - then for now, then in zip(astuple(identities.total), before)))


def mapped(*sources):
    """A run that has mapped features 0, 1, 2 … with these sources, one scan each."""
    identities = Identities()
    for feature, source in enumerate(sources):
        update(identities, step([feature], [True]), truth(source))
    return identities


def test_features_that_nobody_saw_created_are_not_judged():
    identities = mapped(7)
    update(identities, step([5000, 0], removed=[6000]), truth(3, 7))
    assert identities.decisions.tolist() == [Decision.UNJUDGED, Decision.RIGHT]
    assert identities.source_of(np.array([0, 9000])).tolist() == [7, UNLABELLED]


def test_every_verdict_of_one_scan():
    identities = mapped(7, 8, 9, 7, SPURIOUS)  # feature 3 duplicates feature 0, feature 4 is spurious
    scan = [
        (0, False, 7, Decision.RIGHT),
        (3, False, 7, Decision.WRONG),  # the duplicate, not the oldest
        (1, False, 9, Decision.WRONG),  # another feature, its own being in the map
        (2, False, 5, Decision.WRONG),  # another feature, its own not being in the map
        (4, False, 8, Decision.WRONG),  # a feature that is nothing
        (2, False, SPURIOUS, Decision.SPURIOUS),
        (4, False, SPURIOUS, Decision.SPURIOUS),  # spurious to spurious is no match
        (NO_ID, False, SPURIOUS, Decision.DISCARDED),
        (NO_ID, False, 8, Decision.DISCARDED),
        (NO_ID, False, 4, Decision.DISCARDED),
        (5, True, 8, Decision.WRONG),  # starts a duplicate
        (6, True, 3, Decision.NEW),
        (7, True, SPURIOUS, Decision.SPURIOUS),
        (NO_ID, False, UNLABELLED, Decision.UNJUDGED),
    ]
    ids, created, sources, decisions = zip(*scan)
    tally = update(identities, step(ids, created), truth(*sources))
    assert identities.decisions.tolist() == list(decisions)
    wrong = {"fp_wrong": 3, "fp_spurious": 2, "fp_duplicate": 1, "new_wrong": 2}
    right = {"tp": 1, "fn": 2, "tn": 4, "in_map": 6, "new_right": 1, "not_in_map": 3}
    assert tally == Tally(scans=1, scans_exact=0, **right, **wrong)
    assert tally.precision == 1 / 7 and tally.recall == 1 / 6
    assert identities.source_of(np.array([6, 5, 3, 7])).tolist() == [3, 8, 7, SPURIOUS]


def test_the_first_scan_of_another_map_is_judged_against_the_empty_map():
    identities = mapped(7, 8)
    begun = update(identities, step([2, 3], [True, True], removed=[0, 1], prediction=NOTHING), truth(7, 8))
    assert (begun.new_right, begun.new_wrong, begun.in_map) == (2, 0, 0)
    assert update(identities, step([2, 3]), truth(7, 8)).tp == 2


def random_run(rng, steps=250, features=12):
    """Steps of a careless associator: it pairs, invents, refuses and forgets at random."""
    alive, source_of = [], {}
    for _ in range(steps):
        m = int(rng.integers(0, 8))
        sources = np.where(rng.random(m) < 0.2, SPURIOUS, rng.integers(0, features, m))
        ids, created = np.full(m, NO_ID), rng.random(m) < 0.2
        for i in range(m):
            right = [feature for feature in alive if source_of[feature] == sources[i]]
            if created[i]:
                ids[i] = len(source_of)
                source_of[len(source_of)] = sources[i]
            elif right and rng.random() < 0.5:
                ids[i] = right[0 if rng.random() < 0.6 else -1]
            elif alive and rng.random() < 0.7:
                ids[i] = rng.choice(alive)
        alive += ids[created].tolist()
        removed = [rng.choice(alive)] if alive and rng.random() < 0.3 else []
        alive = [feature for feature in alive if feature not in removed]
        yield step(ids, created, removed), truth(*sources)


@for_seeds(20)
def test_counts_agree_with_a_plain_recount(seed):
    identities, source_of, alive, total = Identities(), {}, [], Tally()
    for taken, labels in random_run(np.random.default_rng(seed)):
        tally = update(identities, taken, labels)
        total = total + tally
        expected = dict.fromkeys(("tp", "fp", "fn", "tn", "in_map", "not_in_map", "new_right"), 0)
        for feature, new, source in zip(taken.ids.tolist(), taken.created.tolist(), labels.sources.tolist()):
            same = [known for known in alive if source != SPURIOUS and source_of[known] == source]
            expected["in_map"] += bool(same)
            expected["not_in_map"] += source != SPURIOUS and not same
            expected["new_right"] += new and source != SPURIOUS and not same
            if feature != NO_ID and not new:
                expected["tp" if same and min(same) == feature else "fp"] += 1
            else:
                expected["fn" if same else "tn"] += 1
        assert {name: getattr(tally, name) for name in expected} == expected
        for feature, source in zip(taken.ids[taken.created].tolist(), labels.sources[taken.created].tolist()):
            source_of[feature] = source
            alive.append(feature)
        alive = [feature for feature in alive if feature not in taken.removed]
        assert identities.source_of(np.array([*source_of], np.int64)).tolist() == [*source_of.values()]  # or removed
    assert total == identities.total and min(total.tp, total.fp_duplicate, total.fn) > 3
    assert total.f1 == pytest.approx(2 / (1 / total.precision + 1 / total.recall))


@for_seeds(20)
def test_the_map_is_judged_by_most_measurements_of_a_feature(seed):
    identities, votes = Identities(), defaultdict(Counter)
    for taken, labels in random_run(np.random.default_rng(seed)):
        identities.judge(taken, labels)
        for feature, source in zip(taken.ids.tolist(), labels.sources.tolist()):
            votes[feature][source] += 1
    del votes[NO_ID]
    most = {feature: counts.most_common(1)[0] for feature, counts in votes.items()}
    clear = [feature for feature, (_, count) in most.items() if 2 * count > votes[feature].total()]
    assert identities.majority_of(np.array(clear)).tolist() == [most[feature][0] for feature in clear]


def test_a_feature_may_be_created_by_one_source_and_measured_from_another():
    identities = mapped(7, UNLABELLED, UNLABELLED)
    for source in (8, UNLABELLED, 8):
        update(identities, step([0, 1]), truth(source, UNLABELLED))
    for source in (9, 9):  # the only measurements of feature 1 with a label
        update(identities, step([1]), truth(source))
    ids = np.array([0, 1, 2])
    assert identities.source_of(ids).tolist() == [7, UNLABELLED, UNLABELLED]
    assert identities.majority_of(ids).tolist() == [8, 9, UNLABELLED]


def test_features_that_are_back_are_judged_as_if_they_had_never_left():
    identities = mapped(7, 8)
    update(identities, step([], removed=[0, 1]), truth())
    begun_anew = update(identities, step([2], [True]), truth(7))
    assert begun_anew.new_right == 1  # in the other map it is no duplicate
    joined = replace(step([2], removed=[2]), returned=np.array([0, 1]))
    update(identities, joined, truth(7))
    again = update(identities, step([0, 1]), truth(7, 8))
    assert again.tp == 2 and again.fp == 0


def test_another_map_may_begin_and_be_joined_in_one_step():
    """Features 0 and 1 are left behind, 2 and 3 come back, and 3 is fused with 2, as is the new feature 4."""
    identities = mapped(7, 8)
    identities.judge(step([], removed=[0, 1]), truth())
    identities.judge(step([2, 3], [True, True], prediction=NOTHING), truth(5, 5))
    identities.judge(step([], removed=[2, 3]), truth())
    identities.judge(replace(step([], removed=[]), returned=np.array([0, 1])), truth())
    begun = step([4], [True], removed=[0, 1, 4, 3], prediction=NOTHING)
    assert update(identities, replace(begun, returned=np.array([2, 3])), truth(5)).new_right == 1
    assert update(identities, step([2, NO_ID]), truth(5, 7)).tp == 1  # and 7 is not in the map
    assert identities.total.fn == 0
