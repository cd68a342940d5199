"""What is advised is what the associators decide."""

import dataclasses

import numpy as np
import pytest

from slam_gym.association import ADVISERS, ASSOCIATORS, advice, from_policy, marginal
from slam_gym.types import UNPAIRED
from tests.oracles import association as oracles


def problem(seed):
    """Eight measurements before ten features, sizes and all; some of the features are provisional."""
    rng = np.random.default_rng(seed)
    scan, prediction = oracles.problem(rng, 8, 10, spread=2.0)
    few, many = ({"sizes": rng.uniform(0.2, 1.0, k), "size_variances": np.full(k, 0.01)} for k in (8, 10))
    many |= {"provisional": rng.random(10) < 0.4, "sightings": rng.integers(1, 9, 10)}
    return dataclasses.replace(scan, **few), dataclasses.replace(prediction, **many)


def as_advised(observation, mask):
    advised = np.append(observation["marginals"][:-1], 0.0)
    return int(np.argmax(np.where(mask, advised, -np.inf)))


@pytest.mark.parametrize("name", ["learned", "marginal"])
def test_who_follows_it_through_the_tree_decides_as_the_associator(name):
    follow = from_policy(as_advised, candidates=10, compatibility="individual", marginals=ADVISERS[name])
    pairings = refused = new = 0
    for seed in range(40):
        scan, prediction = problem(seed)
        expected, found = ASSOCIATORS[name](scan, prediction), follow(scan, prediction)
        np.testing.assert_array_equal(found.features, expected.features)
        np.testing.assert_array_equal(found.new, expected.new)
        assert found.experience.unpaired == pytest.approx(expected.experience.unpaired, abs=1e-9)
        pairings, new = pairings + expected.pairings, new + int(expected.new.sum())
        refused += int(((expected.features == UNPAIRED) & ~expected.new).sum())
    assert min(pairings, refused, new) > 10, (pairings, refused, new)


def test_what_is_dearer_is_advised_less():
    scan, prediction = problem(3)
    cheap, dear = advice(scan, prediction, cost=2.0), advice(scan, prediction, cost=20.0)
    np.testing.assert_allclose(cheap.pairings - dear.pairings, np.log(10.0))
    np.testing.assert_allclose(cheap.new - dear.new, np.log(10.0))
    some = advice(scan, prediction, cost=20.0, provisional_cost=2.0)
    np.testing.assert_allclose(some.pairings, np.where(prediction.provisional, cheap.pairings, dear.pairings))
    rows = np.where(dear.pairings.max(axis=1) > 0.0, dear.pairings.argmax(axis=1), UNPAIRED)
    decided = marginal(scan, prediction, cost=20.0).features
    np.testing.assert_array_equal(decided, np.where(rows == UNPAIRED, UNPAIRED, prediction.features[rows]))
