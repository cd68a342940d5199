"""The acceptance rule: its expectation against counts of chance hypotheses, and its laws."""

from dataclasses import replace

import numpy as np
import pytest

from slam_gym.association import gcbb
from slam_gym.association.relocation.acceptance import (
    crowding_of,
    expected_by_chance,
    extent,
    min_pairings,
    with_margin,
)
from slam_gym.types import UNKNOWN_KIND
from tests.oracles import relocation as oracles


def world(seed, n, m, *, density=1 / 16, sigma=0.05, clusters=False):
    """A map at random, in heaps if `clusters`, and a scan that has nothing to do with it."""
    rng = np.random.default_rng(seed)
    side = np.sqrt(n / density)
    places = rng.uniform(0.0, side, (n, 2))
    if clusters:
        places = places[rng.integers(0, n // 10, n)] + rng.normal(0.0, 2.0, (n, 2))
    landmarks = replace(
        oracles.landmarks_of(np.empty((0, 2)), np.empty((0, 0))),
        positions=places,
        covariances=np.tile(sigma**2 * np.eye(2), (n, 1, 1)),
        sizes=np.full(n, np.nan),
        size_variances=np.full(n, np.nan),
        kinds=np.full(n, UNKNOWN_KIND),
    )
    scan = oracles.scan_of(rng.uniform(-5.0, 5.0, (m, 2)), np.tile(sigma**2 * np.eye(2), (m, 1, 1)))
    return scan, landmarks


@pytest.mark.parametrize("clusters", [False, True])
def test_chance_brings_as_many_hypotheses_as_expected(clusters):
    """Scans of three and four measurements, all of them paired: every tie of GCBB is one more hypothesis.

    The binary gates, which the rule leaves out, refuse some more: it errs on the safe side, by less than one pairing.
    """
    for m, runs, n, density in ((3, 30, 80, 1 / 16), (4, 15, 300, 1 / 4)):
        counted, expected = 0.0, 0.0
        for seed in range(runs):
            scan, landmarks = world(seed, n, m, density=density, clusters=clusters)
            found = gcbb(scan, landmarks, confidence=0.99)
            counted += found.ties + 1 if found.pairings == m else 0
            expected += expected_by_chance(scan, landmarks)[m]
        assert counted < 1.3 * expected + 3.0 * np.sqrt(expected)
        assert counted > expected / (12.0 if clusters else 4.0)


@pytest.mark.parametrize("clusters", [False, True])
def test_scans_from_outside_the_map_are_seldom_accepted(clusters):
    """`probability` .02, and ambiguity besides: of 60 scans not more than 4."""
    accepted = 0
    for seed in range(60):
        scan, landmarks = world(seed, 150, 8, clusters=clusters)
        accepted += gcbb(scan, landmarks).accepted
    assert accepted <= 4


def test_the_rule_grows_with_map_scan_and_noise_and_shrinks_with_the_probability():
    scan, landmarks = world(0, 1000, 16)
    usual = min_pairings(scan, landmarks)
    assert 6 <= usual <= 8  # one of them is the margin
    assert min_pairings(*world(0, 20_000, 16)) > usual
    assert min_pairings(*world(0, 1000, 31)) > usual
    assert min_pairings(*world(0, 1000, 16, sigma=0.3)) > usual
    assert min_pairings(*world(0, 1000, 16, density=1.0)) > usual
    assert min_pairings(scan, landmarks, probability=1e-6) > usual >= min_pairings(scan, landmarks, probability=0.5)


def test_one_more_is_asked_for_where_most_of_the_scan_is_left_over():
    assert [with_margin(k, 10) for k in (4, 5, 6, 7, 8, 11)] == [5, 6, 7, 7, 8, 11]
    assert all(k <= with_margin(k, m) <= k + 1 for k in range(3, 12) for m in range(k - 1, 30))


def test_sizes_and_common_drift_are_taken_into_account():
    scan, landmarks = world(1, 300, 10)
    sizes, some = np.linspace(0.1, 0.9, 300), np.full(300, 1e-4)
    sized = replace(landmarks, sizes=sizes, size_variances=some)
    seen = replace(scan, sizes=np.linspace(0.2, 0.8, 10), size_variances=np.full(10, 1e-4))
    assert min_pairings(seen, sized) < min_pairings(scan, landmarks)
    marginals = landmarks.covariances + 4.0 * np.eye(2)
    drifted = np.kron(np.eye(300), 0.05**2 * np.eye(2)) + 4.0 * np.kron(np.ones((300, 300)), np.eye(2))
    known = replace(landmarks, covariances=marginals, covariance=drifted)
    np.testing.assert_allclose(expected_by_chance(scan, known), expected_by_chance(scan, landmarks), rtol=1e-9)
    assert min_pairings(scan, replace(landmarks, covariances=marginals)) > min_pairings(scan, known)


def test_crowding_given_is_crowding_found():
    scan, landmarks = world(2, 200, 8)
    crowding = crowding_of(landmarks, extent(scan))
    assert crowding.landmarks.sum() == 200 and crowding.variance == pytest.approx(0.0025)
    np.testing.assert_array_equal(
        expected_by_chance(scan, landmarks, crowding=crowding), expected_by_chance(scan, landmarks)
    )


@pytest.mark.parametrize("m", [0, 1, 2, 3])
def test_never_less_than_three_and_never_more_than_all_and_one(m):
    scan, landmarks = world(3, 5, m)
    assert 3 <= min_pairings(scan, landmarks) <= max(m + 1, 3)
    nothing = oracles.landmarks_of(np.empty((0, 2)), np.empty((0, 0)))
    assert min_pairings(scan, nothing) == 3


def test_a_probability_that_is_none_is_refused():
    scan, landmarks = world(4, 10, 4)
    with pytest.raises(ValueError, match="probability"):
        min_pairings(scan, landmarks, probability=0.0)
