"""What is left open: which places a robot may be at, how probable each is, and what is decided in it."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.special import logsumexp

from slam_gym.association import deferred, marginal
from slam_gym.types import UNPAIRED, Prediction, Scan
from tests.oracles import densities
from tests.oracles.densities import MODEL, RATES, WIDE, small_problem


def seen_from(scan, prediction, rows):
    """(k, 2) where a hypothesis puts the features, by the linear update."""
    pairs = [(i, j) for i, j in enumerate(rows) if j != UNPAIRED]
    at = prediction.positions.copy()
    if pairs:
        k = len(prediction)
        nu, S = densities._stacked(scan, prediction, pairs)
        entries = np.array([2 * j + a for _, j in pairs for a in range(2)])
        at += (prediction.joint(np.arange(k))[:, entries] @ np.linalg.solve(S, nu)).reshape(k, 2)
    return at


def places(scan, prediction, every, weights, within):
    """Number of the place of each hypothesis: that of the most probable one near by, or a new one."""
    at, firsts, number = [seen_from(scan, prediction, rows) for rows in every], [], {}
    for b in np.argsort(-weights, kind="stable").tolist():
        near = [g for g, f in enumerate(firsts) if np.median(np.hypot(*(at[b] - at[f]).T)) < within]
        number[b] = near[0] if near else len(firsts)
        if not near:
            firsts.append(b)
    return np.array([number[b] for b in range(len(every))])


@pytest.mark.parametrize("seed", range(60))
def test_alternatives_are_sums_over_every_hypothesis_of_a_place(seed):
    scan, prediction = small_problem(seed)
    every = densities.every_hypothesis(scan, prediction)
    log_densities = np.array([densities.log_density(scan, prediction, rows, RATES) for rows in every])
    answer = deferred(scan, prediction, factor=1e9, apart=3.0, **MODEL, **WIDE)
    assert answer.features.tolist() == marginal(scan, prediction, **MODEL, **WIDE).features.tolist()
    if not len(scan) or not len(prediction):
        assert len(answer.alternatives) == 1
        return
    sigma = math.sqrt(np.median(0.5 * np.trace(scan.covariances, axis1=1, axis2=2)))
    number = places(scan, prediction, every, np.exp(log_densities - log_densities.max()), 3.0 * sigma)
    if len(answer.alternatives) == 1:  # what is predicted so well can be at one place only
        number[:] = 0
    sums = sorted((logsumexp(log_densities[number == g]) for g in range(number.max() + 1)), reverse=True)
    found, kept = [way.posterior for way in answer.alternatives], np.array(sums[:8])
    kept = kept[kept > kept[0] - math.log(1e9)]
    assert [p.log_density for p in found] == pytest.approx(kept, abs=1e-6)
    assert [p.probability for p in found] == pytest.approx(np.exp(kept - logsumexp(sums)), abs=1e-6)
    totals = np.array([logsumexp(log_densities[number == g]) for g in range(number.max() + 1)])
    for way in answer.alternatives:
        g = int(np.abs(totals - way.posterior.log_density).argmin())
        own = np.array(every)[number == g]
        weights = np.exp(log_densities[number == g] - way.posterior.log_density)
        for i, feature in enumerate(way.features.tolist()):
            pairings = [weights[own[:, i] == j].sum() for j in range(len(prediction))]
            sure = [int(prediction.features[j]) for j, p in enumerate(pairings) if p > 10.0 / 11.0]
            assert sure == ([] if feature == UNPAIRED else [feature])
            assert way.new[i] == (weights[own[:, i] == UNPAIRED].sum() > 10.0 / 11.0)


def two_features(shift=0.5):
    """A robot that may be half a metre to either side sees one of two features, half a metre apart."""
    mean = np.array([[4.0, 0.0], [4.0, 0.5], [1.0, 3.0]])
    covariance = np.tile(0.09 * np.eye(2), (3, 3)) + 1e-4 * np.eye(6)
    return Scan.from_points([[4.0, shift]], sigma=0.03), Prediction.from_gaussian(mean, covariance)


def test_what_does_not_tell_where_the_robot_is_is_left_open():
    answer = deferred(*two_features(0.25))
    assert answer.features.tolist() == [UNPAIRED] and not answer.new.any()
    ways = answer.alternatives
    assert sorted(way.features.item() for way in ways[:2]) == [0, 1]
    assert ways[0].posterior.probability == pytest.approx(ways[1].posterior.probability)
    assert sum(way.posterior.probability for way in ways) == pytest.approx(1.0, abs=0.1)


def test_what_is_plain_or_within_a_few_deviations_is_not():
    scan, prediction = two_features(-0.5)
    for answer in (deferred(scan, prediction, factor=1.0), deferred(*two_features(0.25), apart=50.0)):
        assert len(answer.alternatives) == 1
        assert answer.alternatives[0].features.tolist() == answer.features.tolist()


@pytest.mark.filterwarnings("error")
def test_a_scan_of_nothing_leaves_nothing_open_however_poor_the_heading():
    _, prediction = two_features()
    poor = dataclasses.replace(prediction, heading_variance=0.1)
    assert len(deferred(Scan.from_points(np.empty((0, 2)), sigma=0.03), poor).alternatives) == 1


@pytest.mark.parametrize(
    ("options", "message"), [({"factor": 0.9}, "factor"), ({"factor": math.nan}, "factor"), ({"apart": 0.0}, "apart")]
)
def test_settings_that_make_no_sense_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        deferred(*two_features(), **options)
