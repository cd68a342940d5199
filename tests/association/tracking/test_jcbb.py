"""JCBB against every path of the tree, on small problems that are ambiguous on purpose."""

import numpy as np
import pytest

from slam_gym.association import jcbb
from slam_gym.types import UNPAIRED
from tests.oracles import association as oracles
from tests.oracles.statistics import for_seeds


@pytest.mark.parametrize("locality", [False, True])
@for_seeds(120)
def test_jcbb_is_the_best_of_all_paths(seed, locality):
    scan, prediction, confidence = oracles.small_problem(seed + 1000 * locality, locality=locality)
    rows, distance = oracles.jcbb(scan, prediction, confidence)
    answer = jcbb(scan, prediction)
    oracles.check(answer, scan, prediction, rows)
    assert answer.joint_distance == pytest.approx(distance, rel=1e-8, abs=1e-10)
    assert not answer.effort.limit_hit


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


@for_seeds(10)
def test_the_bound_counts_features_that_are_left_not_only_levels(seed):
    """Ten measurements of the same three features: a bound by levels would visit more than a thousand hypotheses."""
    scan, prediction = oracles.problem(np.random.default_rng(seed), 10, 3, spread=0.2, noise=0.3)
    answer = jcbb(scan, prediction)
    assert answer.dof == 6
    assert answer.effort.nodes < 500


def test_joint_tests_are_limited_where_a_node_has_thousands_of_candidates():
    """A lost robot: all may be paired with all. A hundred thousand nodes would be some thirty million tests."""
    scan, prediction = oracles.problem(np.random.default_rng(2), 20, 300, noise=1.0)
    answer = jcbb(scan, prediction)
    assert answer.effort.limit_hit and answer.effort.nodes < 20_000
    assert 1_000_000 <= answer.effort.joint_tests <= 1_000_000 + 20 * 300
    assert (answer.features != UNPAIRED).sum() == 20, "it is the best so far"
