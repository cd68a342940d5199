"""The most probable hypothesis against the density of every hypothesis there is."""

import math

import numpy as np
import pytest

from slam_gym import Prediction, Scan
from slam_gym.association import map_hypothesis
from slam_gym.types import UNPAIRED
from tests.oracles import association as oracles
from tests.oracles import densities
from tests.oracles.densities import WIDE
from tests.oracles.statistics import for_seeds

RATES = densities.Rates(0.8, 0.07)
MODEL = {"detection": RATES.detection, "density": RATES.density}


def hypotheses(scan, prediction, allowed, given, related):
    """Every hypothesis that keeps `given`, most probable first: [(log density, rows)]."""
    every = densities.every_hypothesis(scan, prediction, allowed=allowed, given=given, related=related)
    return sorted(((densities.log_density(scan, prediction, rows, RATES), rows) for rows in every), reverse=True)


def shares_of(ranking):
    """The probability (h,) of each hypothesis, and their rows (h, m)."""
    shares = np.exp(np.array([density for density, _ in ranking]) - ranking[0][0])
    return shares / shares.sum(), np.array([rows for _, rows in ranking], int).reshape(len(ranking), -1)


def check(answer, prediction, ranking, earlier=None):
    """What is hardly in view from the predicted pose is not looked up again: hence the slack. `earlier` is the ranking
    of a first search, whose pairings the second one keeps."""
    shares, every = shares_of(ranking)
    rows, probability, marginals = every[0], shares[0], shares @ (every == every[0])
    second, runner_up = (every[1], shares[1]) if len(shares) > 1 else (np.full_like(rows, UNPAIRED), 0.0)
    if earlier is not None:
        first_shares, first = shares_of(earlier)
        marginals = np.where(first[0] != UNPAIRED, first_shares @ (first == first[0]), marginals)
        probability, runner_up = first_shares[0] * probability, first_shares[0] * runner_up
        if len(first) > 1 and first_shares[1] > runner_up:
            second, runner_up = first[1], first_shares[1]
    features = np.append(prediction.features, UNPAIRED)  # row UNPAIRED is the last
    assert answer.features.tolist() == features[rows].tolist()
    assert answer.posterior.log_density == pytest.approx(ranking[0][0], abs=5e-3)
    assert answer.posterior.probability == pytest.approx(probability, abs=2e-3)
    assert answer.posterior.marginals == pytest.approx(marginals, abs=2e-3)
    assert answer.posterior.runner_up_probability == pytest.approx(runner_up, abs=2e-3)
    assert answer.posterior.runner_up.tolist() == features[second].tolist()


@for_seeds(120)
def test_a_wide_beam_finds_the_most_probable_of_all_hypotheses_and_its_share(seed):
    scan, prediction = densities.bare_problem(seed)
    prediction = densities.dressed(prediction, seed)
    everything = hypotheses(scan, prediction, np.ones(len(prediction), bool), [UNPAIRED] * len(scan), None)
    answer = map_hypothesis(scan, prediction, **MODEL, **WIDE)
    check(answer, prediction, everything)
    assert not answer.effort.limit_hit


@for_seeds(60)
def test_with_locality_what_is_near_is_decided_first(seed):
    # localities without strays: each pairing is local to all that are local to the first
    scan, prediction = densities.bare_problem(500 + seed, locality=True)
    group = np.random.default_rng(seed).integers(0, 3, len(prediction))
    related = group[:, None] == group
    prediction, near = densities.dressed(oracles.related_by(prediction, related), seed), prediction.near
    ranking, earlier = hypotheses(scan, prediction, near, [UNPAIRED] * len(scan), None), None
    lists, first = oracles.compatible(scan, prediction, 0.999), ranking[0][1]
    if any(not near[j] for i, found in enumerate(lists) if first[i] == UNPAIRED for _, j in found):
        ranking, earlier = hypotheses(scan, prediction, ~near, first, related), ranking
    check(map_hypothesis(scan, prediction, **MODEL, **WIDE), prediction, ranking, earlier)


@pytest.mark.parametrize("v", [[0.5, 0.5], [0.5, 0.5, 1.5], [0.5, math.nan, 0.5]])
def test_a_visibility_that_is_no_probability_is_refused(v):
    _, prediction = oracles.problem(np.random.default_rng(0), 3, 3)
    with pytest.raises(ValueError, match="visibility"):
        prediction.with_visibility(v)


@for_seeds(30)
def test_a_beam_of_the_default_width_loses_nothing_on_larger_problems(seed):
    scan, prediction = oracles.problem(np.random.default_rng(seed), 9, 12, spread=2.5)
    answer = map_hypothesis(scan, prediction)
    wide = map_hypothesis(scan, prediction, width=4000, margin=1e9)
    assert answer.features.tolist() == wide.features.tolist()
    assert answer.posterior.probability == pytest.approx(wide.posterior.probability, abs=0.05)


def test_of_equal_hypotheses_none_takes_the_place_of_a_better_one():
    prediction = Prediction.from_gaussian([[1.125, 0.0], [0.875, 0.0], [1.0, 0.1875]], 0.0025 * np.eye(6))
    prediction = prediction.with_visibility(np.array([0.06, 0.06, 1.0]))
    scan = Scan.from_points([[1.0, 0.0]], sigma=0.05)
    assert [map_hypothesis(scan, prediction, width=width).features.tolist() for width in (1, 2, 3)] == 3 * [[2]]


@for_seeds(10)
def test_a_narrow_beam_says_so(seed):
    scan, prediction = oracles.problem(np.random.default_rng(seed), 9, 12, spread=2.0)
    narrow = map_hypothesis(scan, prediction, width=1)
    assert narrow.effort.limit_hit
    assert narrow.posterior.probability == 1.0 and narrow.posterior.runner_up_probability == 0.0
    wide = map_hypothesis(scan, prediction)
    assert wide.posterior.log_density >= narrow.posterior.log_density
    assert wide.effort.nodes > narrow.effort.nodes
