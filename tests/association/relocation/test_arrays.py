"""Bad numbers are refused by name, whatever the search."""

from dataclasses import replace

import numpy as np
import pytest

from slam_gym.association import RELOCATORS
from slam_gym.types import Locality
from tests.oracles import relocation as oracles

NAMES = ["gcbb", "indexed", "max_clique", "random_sampling"]


@pytest.mark.parametrize("name", NAMES)
def test_bad_numbers_are_refused_by_name(name):
    _, scan, landmarks = oracles.inside(0, n=20)
    search, points, P = RELOCATORS[name], scan.points.copy(), landmarks.covariances.copy()
    points[3, 0], P[5] = np.nan, [[1.0, 2.0], [2.0, 1.0]]
    with pytest.raises(ValueError, match="measurement 3"):
        search(replace(scan, points=points), landmarks, None)
    with pytest.raises(ValueError, match=r"covariances\[5\]"):
        search(scan, replace(landmarks, covariances=P), None)
    with pytest.raises(ValueError, match=r"Locality.starts"):
        search(scan, landmarks, Locality(np.zeros(3, np.int64), np.empty(0, np.int64)))
    with pytest.raises(ValueError, match=r"Locality.members"):
        search(scan, landmarks, Locality(np.arange(21), np.full(20, 20)))
