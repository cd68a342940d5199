"""Marginals against the sum over every hypothesis there is; and whether they come true."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.special import gammaln, logsumexp

from slam_gym.association.tracking.marginals import DETECTIONS, NOTHING_SEEN, marginals
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.types import UNPAIRED, Experience, Odometry, Prediction, Scan
from tests.oracles import association as oracles
from tests.oracles import densities
from tests.oracles.densities import MODEL, RATES, WIDE, small_problem


def summed(m, n, every, log_densities):
    """(m, n) marginals of every pairing."""
    weights = np.exp(np.array(log_densities) - logsumexp(log_densities))
    out = np.zeros((m, n))
    for rows, weight in zip(every, weights):
        for i, j in enumerate(rows):
            if j != UNPAIRED:
                out[i, j] += weight
    return out


@pytest.mark.parametrize("seed", range(120))
def test_marginals_are_sums_over_every_hypothesis(seed):
    scan, prediction = small_problem(seed, locality=seed % 2 == 0)  # of which nothing is left out
    every = densities.every_hypothesis(scan, prediction)
    expected = summed(
        len(scan), len(prediction), every, [densities.log_density(scan, prediction, rows, RATES) for rows in every]
    )
    found = marginals(scan, prediction, **MODEL, **WIDE)
    assert found.pairings == pytest.approx(expected, abs=1e-9)
    assert found.unpaired == pytest.approx(1.0 - expected.sum(axis=1), abs=1e-9)
    assert len(found.weights) == len(every)
    near = marginals(scan, prediction, **MODEL)
    assert near.pairings == pytest.approx(expected, abs=0.002)


@pytest.mark.parametrize("seed", range(40))
def test_learned_odds_are_added_to_every_hypothesis_that_makes_their_pairing(seed):
    scan, prediction = small_problem(2000 + seed, locality=seed % 2 == 0)
    odds = np.random.default_rng(seed).normal(0.0, 3.0, (len(scan), len(prediction)))
    every, log_densities = densities.every_hypothesis(scan, prediction), []
    for rows in every:
        own = sum(odds[i, j] for i, j in enumerate(rows) if j != UNPAIRED)
        log_densities.append(densities.log_density(scan, prediction, rows, RATES) + own)
    expected = summed(len(scan), len(prediction), every, log_densities)

    def learned(tree, visibility):
        assert visibility is None or len(visibility) == len(prediction)
        return odds[tree.pairings.measured, tree.rows[tree.pairings.slots]]

    found = marginals(scan, prediction, **MODEL, **WIDE, learned=learned)
    assert found.pairings == pytest.approx(expected, abs=1e-9)
    near = marginals(scan, prediction, **MODEL, learned=learned)
    assert near.pairings == pytest.approx(expected, abs=0.002)  # the search follows the odds as well


def area_shown(scan):
    """[m²] of the box around the measurements, and no less than a sector as far as the farthest, two radians wide."""
    if not len(scan):
        return 0.0
    box, farthest = np.prod(np.ptp(scan.points, axis=0)), np.hypot(*scan.points.T).max()
    return max(float(box), 0.5 * 2.0 * farthest**2, 1.0)


def test_a_scan_of_one_measurement_shows_more_than_a_square_metre():
    """Where a robot looks √13 m far and sees one thing, λ is one in 13 m²."""
    known, prediction = None, Prediction.from_gaussian([[9.0, 9.0]], 0.01 * np.eye(2))
    for _ in range(100):
        scan = Scan.from_points([[3.0, 2.0]], sigma=0.1)
        known = marginals(scan, dataclasses.replace(prediction, experience=known)).experience
    assert known.area / known.unpaired == pytest.approx(13.0)


@pytest.mark.parametrize("seed", range(60))
def test_what_is_not_known_is_integrated_out(seed):
    """λ by its Γ distribution, P_D over its values, both as the run has shown them so far."""
    scan, prediction = small_problem(1000 + seed)
    rng = np.random.default_rng(seed)
    known = Experience(float(rng.uniform(0, 20)), float(rng.uniform(0, 200)), rng.normal(0.0, 2.0, len(DETECTIONS)))
    every = densities.every_hypothesis(scan, prediction)
    a, b = 1.0 + known.unpaired, 50.0 + known.area + area_shown(scan)
    log_densities = []
    for rows in every:
        u = rows.count(UNPAIRED)
        by_value = [
            weight + densities.log_density(scan, prediction, rows, densities.Rates(value, 0.05, 1.0))
            for weight, value in zip(known.detections, DETECTIONS)
        ]
        log_densities.append(logsumexp(by_value) + gammaln(a + u) - (a + u) * math.log(b))
    expected = summed(len(scan), len(prediction), every, log_densities)
    found = marginals(scan, dataclasses.replace(prediction, experience=known), **WIDE)
    assert found.pairings == pytest.approx(expected, abs=1e-9)


def drawn_from_the_model(rng, n, detection, density):
    """A scan as the model has it: a map of n correlated features, detected with P_D, and clutter in a box."""
    _, prediction = oracles.problem(rng, 0, n, spread=3.0)
    S = np.linalg.cholesky(prediction.joint(np.arange(n)))
    at = prediction.positions + (S @ rng.standard_normal(2 * n)).reshape(n, 2)
    seen = np.flatnonzero(rng.random(n) < detection)
    clutter = rng.uniform(-4.0, 4.0, (rng.poisson(density * 64.0), 2))
    points = np.concatenate([at[seen] + 0.1 * rng.standard_normal((len(seen), 2)), clutter])
    sources = np.concatenate([seen, np.full(len(clutter), UNPAIRED)])
    order = rng.permutation(len(points))
    view = dataclasses.replace(prediction, view=lambda p, c: np.ones(len(p)), view_moves=False)
    return Scan.from_points(points[order], sigma=0.1), view, sources[order]


def test_marginals_are_calibrated_where_the_model_holds():
    rng, predicted, right = np.random.default_rng(3), [], []
    for _ in range(500):
        scan, prediction, sources = drawn_from_the_model(rng, 6, 0.85, 0.1)
        found = marginals(scan, prediction, detection=0.85, density=0.1)
        predicted.append(found.pairings[found.pairings > 0.0])
        right.append((sources[:, None] == np.arange(6))[found.pairings > 0.0])
    p, hit = np.concatenate(predicted), np.concatenate(right)
    for low, high in ((0.02, 0.2), (0.2, 0.5), (0.5, 0.8), (0.8, 0.95), (0.95, 0.995)):
        own = (p > low) & (p <= high)
        deviation = (hit[own].sum() - p[own].sum()) / math.sqrt((p[own] * (1.0 - p[own])).sum())
        assert own.sum() > 50 and abs(deviation) < 4.0, (low, high, p[own].mean(), hit[own].mean())


def test_rates_are_learned_from_the_scans_of_a_run():
    rng, known = np.random.default_rng(5), NOTHING_SEEN
    for _ in range(80):
        scan, prediction, _ = drawn_from_the_model(rng, 8, 0.7, 0.3)
        known = marginals(scan, dataclasses.replace(prediction, experience=known)).experience
    assert known.unpaired / known.area == pytest.approx(0.3, rel=0.35)
    assert DETECTIONS[np.argmax(known.detections)] == 0.7


@pytest.mark.parametrize("seed", range(4))
def test_a_heading_in_which_nothing_is_compatible_does_not_rule_out_all_others(seed):
    """To turn away from all features costs the search nothing, to pair them against the odds does."""
    rng, map_ = np.random.default_rng(seed), StochasticMap()
    distances, angles = rng.uniform(4.0, 6.0, 14), rng.uniform(-0.15, 0.15, 14)
    places = np.column_stack([distances * np.cos(angles), distances * np.sin(angles)])
    map_.add(Scan.from_points(places, sigma=0.1), np.arange(14))
    map_.predict(Odometry.from_motion(np.zeros(3), [0.05, 0.02, 0.3]))
    scan = Scan.from_points(places + rng.normal(0.0, 0.1, places.shape), sigma=0.1)
    found = marginals(scan, map_.prediction(20.0), learned=lambda tree, _: np.full(len(tree.pairings.slots), -2.0))
    assert found.pairings.sum() > 7.0
