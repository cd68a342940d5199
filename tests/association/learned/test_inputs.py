"""What the network is told of a pairing. The figures are pinned: whoever changes an input has to train anew."""

import dataclasses
import math

import numpy as np
import pytest

from slam_gym.association.compatibility import individual
from slam_gym.association.learned.inputs import INPUTS, VERSION, inputs_of
from slam_gym.association.tree import interpretation_tree
from slam_gym.types import Experience, Prediction, Scan
from tests.oracles import association as oracles


def tree_of(scan: Scan, prediction: Prediction):
    return interpretation_tree(scan, prediction, individual(scan, prediction, 0.999))


def told(seed: int = 0) -> tuple[Scan, Prediction]:
    """A problem in which everything that may be known is known."""
    rng = np.random.default_rng(seed)
    scan, prediction = oracles.problem(rng, 8, 10, spread=2.0)
    scan = dataclasses.replace(
        scan, sizes=rng.uniform(0.2, 1.0, 8), size_variances=np.full(8, 0.01), kinds=rng.integers(-1, 2, 8)
    )
    return scan, dataclasses.replace(
        prediction, sizes=rng.uniform(0.2, 1.0, 10), size_variances=np.full(10, 0.002),
        kinds=rng.integers(-1, 2, 10), ages=rng.integers(0, 90, 10), sightings=rng.integers(1, 30, 10),
        heading_variance=0.01, experience=Experience(12.0, 300.0, np.zeros(5)),
    )  # fmt: skip


PINNED = [
    -2.1416961, 1, 0.42105263, 0.57894737, 4.0579822, -2.0157616, -5.5216289, -2.8595876, -1.6677439,
    1.0168944, 0.73928388, 0.99821603, -0.23880637, -0.39956615, 0.47368421, 3.2194654, 2.8114377, 1,
    2.1972246, 0, 0.40546511, 1, 0.1, -2.074389, -3.2929838, 1,
]  # fmt: skip
"""Means over the pairings of `told()`, by version 1."""


def test_inputs_are_as_they_were_when_the_weights_were_trained():
    scan, prediction = told()
    found = inputs_of(tree_of(scan, prediction), np.linspace(0.0, 1.0, 10))
    assert VERSION == 1 and found.shape[1] == len(INPUTS)
    np.testing.assert_allclose(found.mean(axis=0), PINNED, rtol=1e-6, atol=1e-9)


def test_sizes_and_kinds_speak_only_where_both_are_known():
    prediction = Prediction.from_gaussian(
        [[1.0, 0.0], [1.1, 0.0]], 0.05 * np.eye(4), sizes=[0.5, math.nan], size_sigma=0.03, kinds=[1, -2]
    )
    scan = Scan.from_points([[1.0, 0.1]], sigma=0.05, sizes=[0.6], size_sigma=0.04, kinds=[0])
    first, second = inputs_of(tree_of(scan, prediction), None)[:, :4]
    variance = 0.03**2 + 0.04**2
    assert first == pytest.approx([-0.5 * (0.01 / variance + math.log(2 * math.pi * variance)), 1.0, 0.0, 1.0])
    assert second == pytest.approx([0.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("seed", range(10))
def test_rivals_share_one_whole(seed):
    scan, prediction = told(seed)
    tree = tree_of(scan, prediction)
    found, pairings = inputs_of(tree, None), tree.pairings
    for column, group in ((7, pairings.measured), (8, pairings.slots)):
        parts = np.bincount(group, np.exp(found[:, column]))
        np.testing.assert_allclose(parts[np.bincount(group) > 0], 1.0)
    np.testing.assert_allclose(np.exp(found[:, 9]), np.bincount(pairings.measured)[pairings.measured])


def test_the_order_of_features_says_nothing():
    scan, prediction = told()
    order = np.random.default_rng(1).permutation(10)
    first, turned = tree_of(scan, prediction), tree_of(scan, prediction.rows(order))
    by_pairing = dict(zip(zip(first.pairings.measured, first.rows[first.pairings.slots]), inputs_of(first, None)))
    for i, s, row in zip(turned.pairings.measured, turned.pairings.slots, inputs_of(turned, None)):
        np.testing.assert_allclose(row, by_pairing[i, order[turned.rows[s]]])
