"""Policies of the tree without a prior as relocators like any other."""

import pickle

import numpy as np
import pytest

from slam_gym.association import gcbb
from slam_gym.association.relocation.policy import SampledRelocation, greedy_relocation, relocator_from_policy
from slam_gym.association.relocation.walk import RelocationWalk, WalkSpec
from tests.oracles import relocation as oracles
from tests.oracles import relocation_walks as walks


def test_policies_are_relocators_that_pickle_and_repeat_themselves():
    for policy in (greedy_relocation, SampledRelocation(seed=3)):
        relocate = relocator_from_policy(policy, order="random", seed=4)
        for seed in range(3):
            scan, landmarks, _, localities, _ = walks.easy(seed)
            answers = [find(scan, landmarks, localities["distance"]) for find in (relocate, relocate)]
            answers.append(pickle.loads(pickle.dumps(relocate))(scan, landmarks, localities["distance"]))
            for answer in answers[1:]:
                np.testing.assert_array_equal(answer.features, answers[0].features)
                assert answer.effort == answers[0].effort


def test_sampling_finds_what_gcbb_finds_with_less_effort_and_greedy_never_more():
    greedy = relocator_from_policy(greedy_relocation)
    sample = relocator_from_policy(SampledRelocation(50), candidates=25, order="random", node_limit=1000)
    found, nodes, plain = [], [], 0
    for seed in range(50, 90):
        scan, landmarks, *_ = walks.easy(seed)
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
    scan, landmarks, _, localities, _ = walks.easy(0)
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
            WalkSpec(), scan, landmarks, oracles.localities(np.random.default_rng(0), walks.plant(0)[1])["distance"]
        )
    scan.points[2, 0] = np.nan
    with pytest.raises(ValueError, match="measurement 2"):
        RelocationWalk(WalkSpec(), scan, landmarks, localities["distance"])
