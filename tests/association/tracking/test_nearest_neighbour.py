"""The two associators that look at one pairing at a time, by their definitions."""

import pytest

from slam_gym.association import nearest_neighbour, singles
from tests.oracles import association as oracles


@pytest.mark.parametrize("seed", range(200))
def test_nearest_neighbour(seed):
    scan, prediction, confidence = oracles.small_problem(seed)
    answer = nearest_neighbour(scan, prediction)
    oracles.check(answer, scan, prediction, oracles.nearest(scan, prediction, confidence))


@pytest.mark.parametrize("seed", range(200))
def test_singles(seed):
    scan, prediction, confidence = oracles.small_problem(seed)
    answer = singles(scan, prediction)
    oracles.check(answer, scan, prediction, oracles.singles(scan, prediction, confidence))
