"""GCBB against every hypothesis there is."""

from dataclasses import replace

import numpy as np
import pytest

from slam_gym.association import gcbb
from tests.oracles import relocation as oracles
from tests.oracles.statistics import for_seeds

LOCALITIES = ["everything", "distance", "covisibility"]


@pytest.mark.parametrize("locality", LOCALITIES)
@for_seeds(50)
def test_gcbb_finds_the_best_of_all_hypotheses(seed, locality):
    scan, landmarks, P, localities = oracles.small_problem(seed)
    found = gcbb(scan, landmarks, localities[locality])
    best = oracles.gcbb(scan, landmarks, P, localities[locality], 0.99)
    if len(best) < 200:
        oracles.check_against(found, best, scan, landmarks, P)
    strict = gcbb(scan, landmarks, localities[locality], rivals=False)
    assert strict.pairings == found.pairings
    assert strict.effort.nodes <= found.effort.nodes and strict.ties == 0


@pytest.mark.parametrize("locality", LOCALITIES)
@for_seeds(20)
def test_outwards_is_the_same_search_with_the_measurements_sorted_from_their_centre(seed, locality):
    scan, landmarks, _, localities = oracles.small_problem(seed)
    order = np.argsort(np.hypot(*(scan.points - scan.points.mean(axis=0)).T))
    names = ("points", "covariances", "sizes", "size_variances")
    sorted_scan = replace(scan, **{name: getattr(scan, name)[order] for name in names})
    found = gcbb(scan, landmarks, localities[locality], outwards=True)
    expected = gcbb(sorted_scan, landmarks, localities[locality])
    np.testing.assert_array_equal(found.features[order], expected.features)
    assert found.effort.nodes == expected.effort.nodes and found.ties == expected.ties
