"""The associator that is told the truth."""

import numpy as np
import pytest

from slam_gym.association import true_association
from slam_gym.types import UNPAIRED
from tests.oracles import association as oracles
from tests.oracles.statistics import for_seeds


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
