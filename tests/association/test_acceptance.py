"""The acceptance rule: its expectation against counts of chance hypotheses, and its laws."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from slam_gym.association import gcbb, jcbb
from slam_gym.association.acceptance import (
    are_accidental,
    crowding_of,
    extent,
    log_expected,
    log_expected_old,
    log_expected_pairings,
    log_expected_pairs,
    min_pairings,
)
from slam_gym.association.prediction import Prediction, predict
from slam_gym.mapping.measurement import keep_unambiguous
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.types import UNPAIRED, Landmarks, Odometry, Scan


def world(seed, n, m, *, density=1 / 16, sigma=0.05, clusters=False):
    """A map at random, in heaps if `clusters`, and a scan that has nothing to do with it."""
    rng = np.random.default_rng(seed)
    side = np.sqrt(n / density)
    places = rng.uniform(0.0, side, (n, 2))
    if clusters:
        places = places[rng.integers(0, n // 10, n)] + rng.normal(0.0, 2.0, (n, 2))
    return Scan.from_points(rng.uniform(-5.0, 5.0, (m, 2)), sigma=sigma), Landmarks.from_points(places, sigma=sigma)


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
            expected += np.exp(log_expected(scan, landmarks)[m])
        assert counted < 1.3 * expected + 3.0 * np.sqrt(expected)
        assert counted > expected / (12.0 if clusters else 4.0)


def test_the_rule_grows_with_map_scan_and_noise_and_shrinks_with_the_probability():
    scan, landmarks = world(0, 1000, 16)
    usual = min_pairings(scan, landmarks)
    assert 6 <= usual <= 8  # one of them is the margin
    assert min_pairings(*world(0, 20_000, 16)) > usual
    assert min_pairings(*world(0, 1000, 31)) > usual
    assert min_pairings(*world(0, 1000, 16, sigma=0.3)) > usual
    assert min_pairings(*world(0, 1000, 16, density=1.0)) > usual
    assert min_pairings(scan, landmarks, probability=1e-6) > usual >= min_pairings(scan, landmarks, probability=0.5)


def test_the_expectation_is_the_formula_of_the_module_term_by_term():
    scan, landmarks = world(5, 60, 7, clusters=True)
    width, m, apart = extent(scan), 7, np.abs(landmarks.positions[:, None] - landmarks.positions[None])
    crowding = crowding_of(landmarks, width)
    others = np.repeat(np.arange(len(crowding.histogram)), crowding.histogram)
    near = (apart.max(axis=2) < width / 3.0).sum(axis=1) - 1, (apart.max(axis=2) < 2.0 * width / 3.0).sum(axis=1) - 1
    assert near[0].sum() <= others.sum() <= near[1].sum()  # of the 3 × 3 cells around each
    a = np.sqrt(np.linalg.det(scan.covariances + crowding.variance * np.eye(2)))
    spread = ((scan.points - scan.points.mean(axis=0)) ** 2).sum() / (m - 1)
    for k in range(2, m + 1):
        starts = max(
            sum(math.perm(int(c), k - 1) for c in others) / width ** (2 * k - 2),
            60 * (others.mean() / width**2) ** (k - 1),
        )
        subsets = sum(math.prod(some) for some in itertools.combinations(a, k))
        ball = math.pi ** (k - 1.5) / math.gamma(k - 0.5) * chi2.ppf(0.99, 2 * k - 3) ** (k - 1.5)
        pose = k * math.sqrt((k - 1) * spread) / a.mean() ** 1.5
        expected = math.log(2.0 * math.pi * starts * subsets * pose * ball)
        assert log_expected(scan, landmarks)[k] == pytest.approx(expected, rel=1e-9)


def test_one_uncertain_feature_does_not_forbid_all_answers():
    scan, landmarks = world(0, 300, 10)
    covariances = landmarks.covariances.copy()
    covariances[0] *= 60.0**2
    uncertain = Landmarks.from_points(landmarks.positions, covariances)
    assert min_pairings(scan, uncertain) == min_pairings(scan, landmarks)


def test_scans_of_hundreds_of_measurements_do_not_overflow():
    for m in (250, 600):
        scan, landmarks = world(6, 3000, m)
        numbers = log_expected(scan, landmarks)
        assert np.isfinite(numbers[2:]).all() and 3 < min_pairings(scan, landmarks) < m


def test_sizes_and_common_drift_are_taken_into_account():
    scan, landmarks = world(1, 300, 10)
    least = int(np.flatnonzero(log_expected(scan, landmarks) >= math.log(0.02))[-1]) + 1
    assert 3 <= least < 7 and min_pairings(scan, landmarks) == least + 1  # as that is less than 70 % of the scan
    sizes, some = np.linspace(0.1, 0.9, 300), np.full(300, 1e-4)
    sized = replace(landmarks, sizes=sizes, size_variances=some)
    seen = replace(scan, sizes=np.linspace(0.2, 0.8, 10), size_variances=np.full(10, 1e-4))
    assert min_pairings(seen, sized) < min_pairings(scan, landmarks)
    marginals = landmarks.covariances + 4.0 * np.eye(2)
    drifted = np.kron(np.eye(300), 0.05**2 * np.eye(2)) + 4.0 * np.kron(np.ones((300, 300)), np.eye(2))
    known = replace(landmarks, covariances=marginals, covariance=drifted)
    np.testing.assert_allclose(log_expected(scan, known), log_expected(scan, landmarks), rtol=1e-9)
    assert min_pairings(scan, replace(landmarks, covariances=marginals)) > min_pairings(scan, known)


@pytest.mark.parametrize("m", [0, 1, 2, 3])
def test_never_less_than_three_and_never_more_than_all_and_one(m):
    scan, landmarks = world(3, 5, m)
    assert 3 <= min_pairings(scan, landmarks) <= max(m + 1, 3)
    assert min_pairings(scan, Landmarks.from_points([], sigma=0.1)) == 3


def test_a_probability_that_is_none_is_refused():
    scan, landmarks = world(4, 10, 4)
    with pytest.raises(ValueError, match="probability"):
        min_pairings(scan, landmarks, probability=0.0)


def old_and_near(rng: np.random.Generator, n: int = 14) -> tuple[StochasticMap, Prediction]:
    """A map of n features that were measured from poses less and less certain, and what it predicts of them."""
    m, half = StochasticMap(MapSpec(confirmations=1)), n // 2
    for count in (half, n - half):
        points = rng.uniform(-6.0, 6.0, (count, 2))
        points[1] = points[0] + [0.8, 0.1]  # as a door has two jambs
        m.add(Scan.from_points(points, sigma=0.03), np.arange(count))
        m.predict(Odometry(np.array([1.0, 0.0, 0.1]), np.diag([0.2, 0.2, 0.02]) ** 2 * rng.uniform(0.0, 3.0)))
    p = predict(m, 30.0)
    p.expected.near[:] = rng.random(n) < 0.4
    return m, p


def test_an_old_feature_is_offered_unless_others_are_to_be_expected_in_its_gate() -> None:
    per_area, most, left = 10.0, 0.5, []
    for seed in range(40):
        m, p = old_and_near(np.random.default_rng(seed))
        p.expected.near[:] &= seed % 4 > 0  # now and then none
        features, near, at = p.features.copy(), p.near.copy(), p.positions.copy()
        expected = np.zeros(len(features))
        if near.any():
            amid = features[near][np.hypot(*(at[near] - at[near].mean(axis=0)).T).argmin()]
            for row in np.flatnonzero(~near):
                P = m.covariance_of(np.array([amid, features[row]]))
                relative = P[:2, :2] + P[2:, 2:] - P[:2, 2:] - P[2:, :2]
                expected[row] = per_area * np.sqrt(max(np.linalg.det(relative), 0.0))
        kept = near | (expected <= most)
        rows = np.stack(p.expected[:4]), np.stack(p.expected[4:7]), *p.expected[7:11]
        count = keep_unambiguous(rows, len(p), m.arrays[1], per_area, most)
        np.testing.assert_array_equal(rows[0][0, :count], features[kept])
        np.testing.assert_array_equal(rows[3][:count], at[kept])
        left.append(len(features) - count)
    assert 0 in left and max(left) > 4


def test_pairings_with_old_features_stand_if_chance_hardly_brings_them_all() -> None:
    """All or none; the expected number is the formula of the module, pairing by pairing conditioned on those before."""
    stood = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        m, p = old_and_near(rng)
        features, near = p.features, p.near
        rows = rng.permutation(len(p))[: rng.integers(1, 8)]
        decisions, sigma = np.append(features[rows], [UNPAIRED, UNPAIRED]), rng.uniform(0.01, 0.4)
        scan = Scan.from_points(rng.uniform(-6.0, 6.0, (len(decisions), 2)), sigma=sigma)
        old = np.append(~near[rows], [False, False])
        rejected = are_accidental(scan, p, decisions, 0.05)
        if not old.any():
            assert not rejected.any()
            continue
        order, k = np.argsort(~near[rows], kind="stable"), int(old.sum())
        S = p.joint(rows[order]) + sigma**2 * np.eye(2 * len(rows))
        diagonal = np.diag(np.linalg.cholesky(S))[2 * (len(rows) - k) :]
        gates = [chi2.ppf(p.confidence, 2 * count) for count in (1, k)]
        expected = math.comb(k + 2, k) * math.pi**k / math.factorial(k) * gates[1] ** k * diagonal.prod()
        apart = np.hypot(*(m.positions[:, None] - m.positions[None]).T)
        poisson = math.log(2.0) / np.median((apart + 100.0 * np.eye(m.n)).min(axis=0)) ** 2
        for row in rows[order][len(rows) - k :]:
            block, between = p.covariances[row] + sigma**2 * np.eye(2), p.positions[:, None] - p.positions[None]
            area = math.sqrt(np.linalg.det(block))
            everywhere = (apart <= math.sqrt(gates[0] * area)).sum() / m.n - 1.0
            near_by = np.einsum("abi,ij,abj->ab", between, np.linalg.inv(block), between) < gates[0]
            others = max(everywhere, near_by.sum() / len(p) - 1.0, min(1.0 / m.n, poisson * gates[0] * area))
            expected *= others / (math.pi * gates[0] * area)
        assert np.exp(log_expected_old(scan, p, decisions, old)) == pytest.approx(expected)
        np.testing.assert_array_equal(rejected, old & (expected > 0.05))
        stood.append(expected <= 0.05)
    assert 10 < sum(stood) < 50


@pytest.mark.parametrize(("k", "uncertain"), [(1, 0.2), (2, 0.8)])
def test_chance_brings_as_many_pairings_with_old_features_as_expected(k: int, uncertain: float) -> None:
    """Two measurements of nothing in the map, from a pose that is poorly known: how often k of them are paired."""
    counted, expected, uniform = 0, 0.0, 0.0
    for seed in range(400):
        rng = np.random.default_rng(seed)
        m = StochasticMap(MapSpec(confirmations=1))
        m.add(Scan.from_points(rng.uniform(-20.0, 20.0, (200, 2)), sigma=0.05), np.arange(200))
        m.predict(Odometry(np.zeros(3), np.diag([uncertain, uncertain, 0.01]) ** 2))
        p = predict(m, 100.0)
        p.expected.near[:] = False
        scan = Scan.from_points(rng.uniform(-10.0, 10.0, (2, 2)), sigma=0.05)
        counted += int((jcbb(scan, p).features != UNPAIRED).sum() >= k)
        old = np.arange(2) < k
        rows = rng.choice(np.flatnonzero(np.abs(p.positions).max(axis=1) < 10.0), 2, replace=False)
        paired = np.where(old, p.features[rows], UNPAIRED)
        expected += np.exp(log_expected_old(scan, p, paired, old))
        uniform += np.exp(log_expected_pairings(scan, p, paired))
    assert counted >= 20 and counted / 1.5 < expected < 1.5 * counted, f"{counted}, not {expected}"
    assert counted / 2.0 < uniform < 1.5 * counted, f"{counted}, not {uniform}"


def test_sets_of_pairs_are_expected_by_the_formula_and_no_more_often_by_chance() -> None:
    """Of points at random, with independent errors of the pairs: the number of pairs that fit as well, for k = 1."""
    counted, expected = 0, 0.0
    for seed in range(300):
        rng = np.random.default_rng(seed)
        positions, newer, sigma = rng.uniform(-10.0, 10.0, (60, 2)), rng.uniform(-8.0, 8.0, (3, 2)), 0.4
        S, nu, gates = sigma**2 * np.eye(4), rng.uniform(-2.0, 2.0, 4), chi2.ppf(0.99, [2, 4])
        apart = np.hypot(*(positions[:, None] - positions[None]).T)
        counted_others = (apart <= sigma * math.sqrt(gates[0])).sum() / 60 - 1.0
        nearest = np.median((apart + 100.0 * np.eye(60)).min(axis=0))
        others = max(counted_others, min(1.0 / 60, math.log(2.0) * gates[0] * (sigma / nearest) ** 2))
        density, squares = others / (math.pi * gates[0] * sigma**2), nu**2 / sigma**2
        value = math.comb(3, 2) * (math.pi * min(gates[1], squares.sum()) * sigma**2 * density) ** 2 / 2.0
        assert np.exp(log_expected_pairs(nu, S, 3, positions, 0.99)) == pytest.approx(value)
        squared = ((newer[:, None] - positions[None]) ** 2).sum(axis=2) / sigma**2
        counted += int((squared < min(gates[0], squares[:2].sum())).sum())
        expected += np.exp(log_expected_pairs(nu[:2], S[:2, :2], 3, positions, 0.99))
    assert counted > 100 and counted / 1.3 < expected < 1.3 * counted, f"{counted}, not {expected}"
    assert log_expected_pairs(np.ones(4), np.zeros((4, 4)), 3, positions, 0.99) == math.inf
