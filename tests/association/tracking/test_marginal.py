"""Marginals against the sum over every hypothesis there is; whether they come true; and what is decided by them."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from scipy.special import gammaln, logsumexp

from slam_gym.association import marginal
from slam_gym.association.prediction import Prediction
from slam_gym.association.tracking.marginal import DETECTIONS, NOTHING_SEEN, weigh
from slam_gym.navigation.visibility import ViewsFrom
from slam_gym.slam.slam import Slam
from slam_gym.types import UNPAIRED, Experience, Odometry, Scan
from tests.oracles import association as oracles
from tests.oracles import densities
from tests.oracles.densities import WIDE, small_problem
from tests.oracles.statistics import for_seeds


@for_seeds(40)
def test_decisions_follow_the_cost_of_a_wrong_pairing(seed):
    scan, prediction = oracles.problem(np.random.default_rng(seed), 8, 10, spread=2.0)
    found, row_of = weigh(scan, prediction)[1], {int(f): j for j, f in enumerate(prediction.features)}
    p, paired = found.pairings, []
    assert (p.sum(axis=0) <= 1.0 + 1e-9).all() and (p.sum(axis=1) <= 1.0 + 1e-9).all()
    for cost in (1.0, 3.0, 10.0, 1000.0):
        answer = marginal(scan, prediction, cost=cost)
        for i, feature in enumerate(answer.features):
            best = p[i].max()
            worth = best - cost * (1.0 - best) > 0.0
            assert worth == (feature != UNPAIRED)
            if worth:
                assert p[i, row_of[int(feature)]] == best == answer.posterior.marginals[i]
            assert answer.new[i] == (p[i].sum() < 1.0 / (cost + 1.0))
            if not worth:
                assert answer.posterior.marginals[i] == pytest.approx(1.0 - p[i].sum(), abs=1e-9)
        features = answer.features[answer.features != UNPAIRED].tolist()
        assert len(features) == len(set(features))
        paired.append(set(enumerate(answer.features.tolist())) - {(i, UNPAIRED) for i in range(8)})
    assert all(dearer <= cheaper for cheaper, dearer in itertools.pairwise(paired))


def area_shown(scan):
    """[m²] of the box around the measurements, and no less than a sector as far as the farthest, two radians wide."""
    if not len(scan):
        return 0.0
    box, farthest = np.prod(np.ptp(scan.points, axis=0)), np.hypot(*scan.points.T).max()
    return max(float(box), 0.5 * 2.0 * farthest**2, 1.0)


def experienced(seed, **options):
    """A small problem for a robot that has seen something; every hypothesis of it, and their log densities: λ is
    integrated out by its Γ distribution, P_D over its values."""
    rng, (scan, prediction) = np.random.default_rng(seed), small_problem(seed, **options)
    known = Experience(float(rng.uniform(0, 20)), float(rng.uniform(0, 200)), rng.normal(0.0, 2.0, len(DETECTIONS)))
    every = densities.every_hypothesis(scan, prediction)
    a, b = 1.0 + known.unpaired, 50.0 + known.area + area_shown(scan)
    scores = []
    for rows in every:
        u = rows.count(UNPAIRED)
        by_value = [
            weight + densities.log_density(scan, prediction, rows, densities.Rates(value, 1.0))
            for weight, value in zip(known.detections, DETECTIONS)
        ]
        scores.append(logsumexp(by_value) + gammaln(a + u) - (a + u) * math.log(b))
    return scan, dataclasses.replace(prediction, experience=known), every, np.array(scores)


@for_seeds(20)
def test_the_posterior_tells_of_all_decisions_together(seed):
    scan, prediction, every, scores = experienced(seed)
    answer = marginal(scan, prediction, cost=5.0, **WIDE)
    row_of = {int(f): j for j, f in enumerate(prediction.features)} | {UNPAIRED: UNPAIRED}
    decided = every.index([row_of[int(f)] for f in answer.features])
    assert answer.posterior.log_density == pytest.approx(scores[decided])
    assert answer.posterior.probability == pytest.approx(np.exp(scores[decided] - logsumexp(scores)))
    others = np.delete(scores, decided)
    second = np.exp(others.max() - logsumexp(scores)) if len(others) else 0.0
    assert answer.posterior.runner_up_probability == pytest.approx(second)
    before, after = prediction.experience, answer.experience  # the older it is, the less it counts
    clutter = (before.unpaired + answer.posterior.unpaired.sum()) / (before.area + area_shown(scan))
    assert after.unpaired / after.area == pytest.approx(clutter)


def test_experience_goes_with_the_run_and_is_nobody_elses():
    """The next prediction brings what the last hypothesis has learned; another run begins with nothing."""
    scan = Scan.from_points([[1.0, 0.5], [2.0, -0.5], [1.5, 1.0]], sigma=0.05)
    odometry = Odometry.from_motion([0.1, 0, 0], 0.01)
    slam, fresh = Slam(), Slam()
    first = slam.step(odometry, scan, "marginal")
    assert first.prediction.experience is None and first.hypothesis.experience.unpaired > 0.0
    second = slam.step(odometry, scan, "marginal")
    assert second.prediction.experience is first.hypothesis.experience
    slam.step(odometry, scan, "jcbb")
    assert slam.step(odometry, scan, "marginal").prediction.experience is second.hypothesis.experience
    assert fresh.step(odometry, scan, "marginal").prediction.experience is None
    strange = dataclasses.replace(slam.predict(odometry, scan), experience=Experience(0.0, 0.0, np.zeros(3)))
    with pytest.raises(ValueError, match=r"experience\.detections: shape"):
        marginal(scan, strange)


def test_of_two_corners_of_a_pillar_the_one_that_faces_the_robot_is_paired():
    sight, scan = ViewsFrom(2.0 * math.pi, 6.0).arrays, Scan.from_points([[2.0, 0.0]], sigma=0.1)
    prediction = Prediction.from_gaussian([[2.0, -0.1], [2.0, 0.1]], 0.05 * np.eye(4))
    for seen, facing in ((0, [1.0, 0.05]), (1, [0.05, 1.0]), (UNPAIRED, [1.0, 1.0])):
        expected = prediction.expected._replace(sight=sight, facing=np.array(facing))
        told = dataclasses.replace(prediction, expected=expected)
        assert marginal(scan, told, cost=3.0).features.tolist() == [seen]
        assert told.visibility() == pytest.approx([1.0, 1.0])  # what the sensor could see, whatever it faces


def test_a_wrong_pairing_with_a_provisional_feature_may_cost_less():
    prediction = Prediction.from_gaussian([[0.0, 0.0], [1.0, 0.0]], 0.05 * np.eye(4))
    scan = Scan.from_points([[0.4, 0.0]], sigma=0.05)
    p = weigh(scan, prediction)[1].pairings[0]
    assert 0.6 < p[0] < 0.9  # worth it at a cost of 1, not at 10
    for provisional, price, expected in ((True, 1.0, 0), (True, 10.0, UNPAIRED), (False, 1.0, UNPAIRED)):
        told = oracles.expecting(
            prediction.positions, 0.05 * np.eye(4), sightings=np.array([1 if provisional else 5, 5]), confirmations=2
        )
        assert marginal(scan, told, provisional_cost=price).features.tolist() == [expected]
        assert marginal(scan, told).features.tolist() == [UNPAIRED]


def summed(m, n, every, log_densities):
    """(m, n) marginals of every pairing."""
    weights = np.exp(log_densities - logsumexp(log_densities))
    out = np.zeros((m, n))
    for rows, weight in zip(every, weights):
        for i, j in enumerate(rows):
            if j != UNPAIRED:
                out[i, j] += weight
    return out


@for_seeds(80)
def test_marginals_are_sums_over_every_hypothesis(seed):
    scan, prediction, every, scores = experienced(seed, locality=seed % 2 == 0)  # of which nothing is left out
    expected = summed(len(scan), len(prediction), every, scores)
    found = weigh(scan, prediction, **WIDE)[1]
    assert found.pairings == pytest.approx(expected, abs=1e-9)
    assert found.unpaired == pytest.approx(1.0 - expected.sum(axis=1), abs=1e-9)
    assert weigh(scan, prediction)[1].pairings == pytest.approx(expected, abs=0.002)


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
    return Scan.from_points(points[order], sigma=0.1), prediction.with_visibility(np.ones(n)), sources[order]


def test_marginals_are_calibrated_where_the_model_holds():
    rng, predicted, right = np.random.default_rng(3), [], []
    known = Experience(1e3, 1e4, np.where(DETECTIONS == 0.85, 0.0, -1e9))
    for _ in range(500):
        scan, prediction, sources = drawn_from_the_model(rng, 6, 0.85, 0.1)
        found = weigh(scan, dataclasses.replace(prediction, experience=known))[1]
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
        known = marginal(scan, dataclasses.replace(prediction, experience=known)).experience
    assert known.unpaired / known.area == pytest.approx(0.3, rel=0.35)
    assert DETECTIONS[np.argmax(known.detections)] == 0.7
