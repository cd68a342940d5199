"""Policies of the tree as relocators and associators like any other."""

import pickle

import numpy as np
import pytest

from slam_gym.association import gcbb
from slam_gym.association.policy import from_policy, greedy, relocator_from_policy
from slam_gym.association.relocation.walk import RelocationWalk, WalkSpec
from slam_gym.types import UNPAIRED
from tests.association.tracking.test_walk import CONFIDENCE, problems
from tests.oracles import association
from tests.oracles import relocation as oracles
from tests.oracles import relocation_walks as walks


def test_policies_are_relocators_that_pickle_and_repeat_themselves():
    for policy in (greedy, walks.by_chance):
        relocate = relocator_from_policy(policy, order="nearest_first")
        for seed in range(3):
            scan, landmarks, _, localities, _ = walks.easy(seed)
            answers = [find(scan, landmarks, localities["distance"]) for find in (relocate, relocate)]
            answers.append(pickle.loads(pickle.dumps(relocate))(scan, landmarks, localities["distance"]))
            for answer in answers[1:]:
                np.testing.assert_array_equal(answer.features, answers[0].features)
                assert answer.effort == answers[0].effort


def test_greedy_is_one_try_that_never_pairs_more_than_gcbb():
    once, right = relocator_from_policy(greedy), 0
    for seed in range(50, 90):
        scan, landmarks, *_ = walks.easy(seed)
        expected, found = gcbb(scan, landmarks), once(scan, landmarks)
        assert found.effort.tries == 1 and found.pairings <= expected.pairings
        right += expected.accepted and found.accepted and np.allclose(found.pose, expected.pose, atol=0.2)
    assert right >= 5


def test_bad_settings_and_actions_are_refused_by_name():
    scan, landmarks, _, localities, _ = walks.easy(0)
    for bad, name in (
        (dict(candidates=0), "candidates"),
        (dict(candidates=2.5), "candidates"),
        (dict(node_limit=0), "node_limit"),
        (dict(order="any"), "order='any'; known: as_scanned"),
        (dict(confidence=1.0), "confidence"),
        (dict(measurements=0), "measurements"),
    ):
        with pytest.raises(ValueError, match=name):
            relocator_from_policy(greedy, **bad)
    with pytest.raises(ValueError, match="action 99 is not legal"):
        relocator_from_policy(lambda observation, mask: 99)(scan, landmarks)
    walk = RelocationWalk(WalkSpec(), scan, landmarks)
    for action in (-1, walk.spec.restart, walk.spec.actions):
        with pytest.raises(ValueError, match="not legal"):
            walk.take(action)
    with pytest.raises(ValueError, match="Locality"):
        RelocationWalk(
            WalkSpec(), scan, landmarks, oracles.localities(np.random.default_rng(0), walks.plant(0)[1])["distance"]
        )
    scan.points[2, 0] = np.nan
    with pytest.raises(ValueError, match="measurement 2"):
        RelocationWalk(WalkSpec(), scan, landmarks, localities["distance"])


# --- with a prior -----------------------------------------------------------------------------------------------------


def test_greedy_is_sequential_compatibility_nearest_neighbour():
    associate = from_policy(greedy)
    for scan, prediction in problems(60):
        expected = association.greedy(scan, prediction, CONFIDENCE)
        features = [UNPAIRED if row == UNPAIRED else prediction.features[row] for row in expected]
        np.testing.assert_array_equal(associate(scan, prediction).features, features)
