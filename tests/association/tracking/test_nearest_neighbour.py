"""The associators that weigh each pairing alone, and the one that is told the truth, by their definitions."""

import functools
import itertools
import math

import numpy as np
import pytest

from slam_gym.association import global_nearest_neighbour, nearest_neighbour, singles, true_association
from slam_gym.types import UNPAIRED
from tests.oracles import association as oracles
from tests.oracles.statistics import for_seeds


@pytest.mark.parametrize(("associate", "defined"), [(nearest_neighbour, oracles.nearest), (singles, oracles.singles)])
@for_seeds(200)
def test_nearest_neighbour_and_singles_are_their_definitions(seed, associate, defined):
    scan, prediction, confidence = oracles.small_problem(seed)
    oracles.check(associate(scan, prediction), scan, prediction, defined(scan, prediction, confidence))


def cheapest(scan, prediction, confidence, allowed, given, _):
    """Every way to pair what is compatible, by its price."""
    lists = oracles.compatible(scan, prediction, confidence)
    undecided = [i for i in range(len(scan)) if given[i] == UNPAIRED]
    options, price = [], {}
    for i in undecided:
        found = [(d2, j) for d2, j in lists[i] if allowed[j] and j not in given]
        sizes = [np.log(np.linalg.det(prediction.covariances[j] + scan.covariances[i])) for _, j in found]
        price |= {(i, j): d2 + size for (d2, j), size in zip(found, sizes)}
        price[i, UNPAIRED] = oracles.gate(2, confidence) + max(sizes, default=0.0)
        options.append([UNPAIRED, *(j for _, j in found)])
    best, best_price = given, math.inf
    for choice in itertools.product(*options):
        paired = [j for j in choice if j != UNPAIRED]
        total = sum(price[i, j] for i, j in zip(undecided, choice))
        if len(set(paired)) == len(paired) and total < best_price:
            rows = list(given)
            for i, j in zip(undecided, choice):
                rows[i] = j
            best, best_price = rows, total
    return best


@for_seeds(100)
def test_global_nearest_neighbour_is_the_cheapest_of_all_assignments(seed):
    scan, prediction, confidence = oracles.smaller_problem(seed, locality=seed % 2 == 0)
    rows = oracles.near_first(prediction, len(scan), functools.partial(cheapest, scan, prediction, confidence))
    oracles.check(global_nearest_neighbour(scan, prediction), scan, prediction, rows)


@for_seeds(20)
def test_true_association_pairs_by_identity(seed):
    rng = np.random.default_rng(seed)
    scan, prediction = oracles.problem(rng, 6, 8)
    identities = rng.permutation(100)[: int(prediction.features.max()) + 1]
    sources = np.array([UNPAIRED, 1000, -2, *identities[prediction.features[[5, 0]]], UNPAIRED])
    answer = true_association(scan, prediction, sources=sources, identities=identities)
    oracles.check(answer, scan, prediction, [UNPAIRED, UNPAIRED, UNPAIRED, 5, 0, UNPAIRED])


def test_true_association_takes_the_first_of_duplicates_and_never_pairs_spurious_with_spurious():
    scan, prediction = oracles.problem(np.random.default_rng(0), 3, 4)
    identities = np.full(int(prediction.features.max()) + 1, UNPAIRED)
    identities[prediction.features[[1, 3]]] = 7
    answer = true_association(scan, prediction, sources=np.array([UNPAIRED, 7, 8]), identities=identities)
    oracles.check(answer, scan, prediction, [UNPAIRED, 1, UNPAIRED])
    with pytest.raises(ValueError, match="sources"):
        true_association(scan, prediction, sources=np.array([1]), identities=identities)
