"""Policies of the tree as associators like any other."""

import pickle

import numpy as np

from slam_gym.association.policy import from_policy, greedy
from slam_gym.types import UNPAIRED
from tests.association.tracking.test_walk import CONFIDENCE, problems
from tests.oracles import association as oracles


def test_greedy_is_sequential_compatibility_nearest_neighbour():
    associate = from_policy(greedy)
    for scan, prediction in problems(60):
        expected = oracles.greedy(scan, prediction, CONFIDENCE)
        features = [UNPAIRED if row == UNPAIRED else prediction.features[row] for row in expected]
        np.testing.assert_array_equal(associate(scan, prediction).features, features)


def test_refusing_everything_pairs_nothing():
    refuse = from_policy(lambda observation, mask: len(mask) - 1)
    for scan, prediction in problems(5):
        answer = refuse(scan, prediction)
        assert (answer.features == UNPAIRED).all()
        assert (answer.joint_distance, answer.dof) == (0.0, 0)


def test_a_policy_associator_pickles():
    associate = pickle.loads(pickle.dumps(from_policy(greedy, candidates=2)))
    scan, prediction = next(problems(1))
    expected = from_policy(greedy, candidates=2)(scan, prediction).features
    np.testing.assert_array_equal(associate(scan, prediction).features, expected)
