"""The two searches of locality, against every path of either."""

import dataclasses

import numpy as np
import pytest

from slam_gym.association import jcbb
from tests.oracles import association as oracles


@pytest.mark.parametrize("seed", range(300))
def test_jcbb_with_locality(seed):
    scan, prediction, confidence = oracles.small_problem(1000 + seed, locality=True)
    oracles.check(
        jcbb(scan, prediction),
        scan,
        prediction,
        oracles.jcbb(scan, prediction, confidence)[0],
    )
    oracles.check(
        jcbb(scan, oracles.without_locality(prediction)),
        scan,
        prediction,
        oracles.jcbb(scan, prediction, confidence, locality=False)[0],
    )


@pytest.mark.parametrize("seed", range(20))
def test_a_locality_that_holds_everything_changes_nothing(seed):
    scan, prediction, _ = oracles.small_problem(seed, locality=True)
    everything = dataclasses.replace(
        prediction, near=np.ones(len(prediction), np.bool_), local=lambda rows: np.ones((len(rows),) * 2, bool)
    )
    answer = jcbb(scan, everything)
    assert answer.features.tolist() == jcbb(scan, oracles.without_locality(prediction)).features.tolist()
