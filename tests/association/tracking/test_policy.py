"""Policies of the tree as associators like any other."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from slam_gym.association.tracking.policy import from_policy, greedy
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


@pytest.mark.parametrize(("m", "n"), [(0, 5), (4, 0), (0, 0), (1, 1)])
def test_small_problems(m, n):
    scan, prediction = next(problems(1, m=m, n=n))
    assert len(from_policy(greedy)(scan, prediction).features) == m


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
