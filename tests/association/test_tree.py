"""The tree: its branches by definition, at every node of paths to leaves."""

import numpy as np
import pytest

from slam_gym.association.compatibility import individual
from slam_gym.association.tree import branches, decided, extend, interpretation_tree, root
from slam_gym.types import UNPAIRED
from tests.oracles import association as oracles
from tests.oracles.statistics import for_seeds


def plant(seed, m=5, n=7):
    scan, prediction = oracles.problem(np.random.default_rng(seed), m, n, spread=1.5)
    return interpretation_tree(scan, prediction, individual(scan, prediction))


def random_leaf(tree, rng):
    """Every node on the way to a leaf that prefers pairings."""
    nodes = [root(tree)]
    while nodes[-1].level < tree.levels:
        legal = branches(tree, nodes[-1])
        rows = legal.rows[legal.legal]
        nodes.append(extend(tree, nodes[-1], int(rng.choice(rows)) if len(rows) and rng.random() < 0.8 else UNPAIRED))
    return nodes


def pairs_of(tree, node):
    """(measurement, row), in the order of the scan."""
    return [(i, int(row)) for i, row in enumerate(decided(tree, node)) if row != UNPAIRED]


@for_seeds(30)
def test_branches_are_the_compatible_pairings_and_those_jointly_compatible_are_legal(seed):
    tree = plant(seed)
    for node in random_leaf(tree, np.random.default_rng(seed))[:-1]:
        offer = branches(tree, node)
        pairs = pairs_of(tree, node)
        expected = oracles.compatible(tree.scan, tree.prediction, 0.99)[node.level]
        assert offer.rows.tolist() == [row for _, row in expected]
        assert offer.individual == pytest.approx([d2 for d2, _ in expected])
        for row, joint, legal in zip(offer.rows, offer.joint, offer.legal):
            taken = int(row) in [j for _, j in pairs]
            if taken:
                assert joint == np.inf and not legal
                continue
            longer = [*pairs, (node.level, int(row))]
            assert joint == pytest.approx(oracles.distance(tree.scan, tree.prediction, longer))
            assert legal == (joint < oracles.gate(2 * len(longer), 0.99))


def test_illegal_steps_are_refused():
    tree = plant(1)
    with pytest.raises(ValueError, match="may not be paired"):
        extend(tree, root(tree), 99)
    leaf = random_leaf(tree, np.random.default_rng(0))[-1]
    with pytest.raises(ValueError, match="leaf"):
        branches(tree, leaf)
    with pytest.raises(ValueError, match="leaf"):
        extend(tree, leaf, UNPAIRED)
