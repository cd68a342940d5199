"""Searches without a prior: against the enumeration of every hypothesis, inside and outside the map, and bad input."""

import numpy as np
import pytest
import relocation_oracles as oracles
from scipy.stats import chi2

from slam_gym.association import gcbb, random_sampling
from slam_gym.geometry import wrap_angle

LOCALITIES = ["everything", "distance", "covisibility"]
KEEPS = ["dense", "blocks", "none"]


def plant(seed, *, largest=5):
    rng = np.random.default_rng(seed)
    m, n = int(rng.integers(3, largest + 1)), int(rng.integers(3, 9))
    scan, landmarks, P = oracles.problem(rng, min(m, n), n, keep=KEEPS[seed % 3])
    return scan, landmarks, P, oracles.localities(rng, landmarks)


def check_against(found, best, scan, landmarks, P):
    """`found` is one of the best hypotheses, located as the oracle does, and ties are the others elsewhere."""
    if not best:
        assert found.pairings == 0 and np.isnan(found.pose).all() and not found.ambiguous
        return
    assert found.pairings == len(best[0])
    if found.pairings == 2:  # with one degree of freedom and close points the optimum need not be the only one
        return
    distinct = {tuple(oracles.decisions(pairs, len(scan))): pairs for pairs in best}
    fits = {key: oracles.quick_fit(scan, landmarks, P, pairs) for key, pairs in distinct.items()}
    assert tuple(found.features) in distinct
    pose, covariance, distance = fits[tuple(found.features)]
    least = min(distance for _, _, distance in fits.values())
    assert found.joint_distance == pytest.approx(distance, rel=1e-4, abs=1e-6)
    assert found.joint_distance == pytest.approx(least, rel=1e-4, abs=1e-6)
    assert found.dof == 2 * len(best[0]) - 3
    np.testing.assert_allclose(found.pose[:2], pose[:2], atol=1e-4)
    elsewhere = 0
    for other, spread, _ in fits.values():
        delta = other - pose
        delta[2] = wrap_angle(delta[2])
        elsewhere += delta @ np.linalg.solve(covariance + spread, delta) >= chi2.ppf(0.99, 3)
    assert found.ties == elsewhere and found.ambiguous == (elsewhere > 0)


@pytest.mark.parametrize("locality", LOCALITIES)
@pytest.mark.parametrize("seed", range(50))
def test_gcbb_finds_the_best_of_all_hypotheses(seed, locality):
    scan, landmarks, P, localities = plant(seed)
    found = gcbb(scan, landmarks, localities[locality])
    best = oracles.gcbb(scan, landmarks, P, localities[locality], 0.99)
    if len(best) < 200:
        check_against(found, best, scan, landmarks, P)
    strict = gcbb(scan, landmarks, localities[locality], rivals=False)
    assert strict.pairings == found.pairings
    assert strict.effort.nodes <= found.effort.nodes and strict.ties == 0


@pytest.mark.parametrize("locality", LOCALITIES)
@pytest.mark.parametrize("seed", range(12))
def test_random_sampling_with_every_sample_finds_the_best_that_a_sample_leads_to(seed, locality):
    scan, landmarks, P, localities = plant(seed + 500, largest=4)
    found = random_sampling(scan, landmarks, localities[locality], p_fail=1e-12, p_good=0.5)
    check_against(found, oracles.random_sampling(scan, landmarks, P, localities[locality], 0.99), scan, landmarks, P)
