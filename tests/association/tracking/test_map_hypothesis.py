"""The most probable hypothesis against the density of every hypothesis there is."""

import dataclasses
import math

import numpy as np
import pytest

from slam_gym.association import jcbb, map_hypothesis
from slam_gym.types import UNPAIRED, Prediction, Scan
from tests.oracles import association as oracles
from tests.oracles import densities

WIDE = {"width": 3000, "margin": 1e9}
DETECTION, CLUTTER, NEW, UNSEEN = 0.8, 0.02, 0.05, 0.1
MODEL = {"detection": DETECTION, "clutter_density": CLUTTER, "new_density": NEW, "unseen": UNSEEN}


def small_problem(seed, **options):
    rng = np.random.default_rng(seed)
    m, n = int(rng.integers(0, 5)), int(rng.integers(0, 6))
    return oracles.problem(rng, m, n, spread=float(rng.choice([1.0, 1.5, 2.0])), **options)


def log_density(scan, prediction, rows):
    rates = densities.Rates(DETECTION, UNSEEN, CLUTTER + NEW)
    return densities.log_density(scan, prediction, rows, rates)


def hypotheses(scan, prediction, allowed, given, related):
    """Every hypothesis that keeps `given`, most probable first: [(log density, rows)]."""
    every = densities.every_hypothesis(scan, prediction, allowed=allowed, given=given, related=related)
    return sorted(((log_density(scan, prediction, rows), rows) for rows in every), reverse=True)


def dressed(prediction, seed):
    """With one view or another, or none."""
    return dataclasses.replace(prediction, view=densities.VIEWS[seed % len(densities.VIEWS)])


def check(answer, prediction, ranking):
    best, rows = ranking[0]
    features = [UNPAIRED if j == UNPAIRED else int(prediction.features[j]) for j in rows]
    assert answer.features.tolist() == features
    assert answer.posterior.log_density == pytest.approx(best, rel=1e-8, abs=1e-8)
    shares = np.exp(np.array([density for density, _ in ranking]) - best)
    shares /= shares.sum()
    assert answer.posterior.probability == pytest.approx(shares[0])
    alike = np.array([[j == rows[i] for i, j in enumerate(other)] for _, other in ranking]).reshape(len(ranking), -1)
    assert answer.posterior.marginals == pytest.approx(shares @ alike)
    second = (
        [UNPAIRED if j == UNPAIRED else int(prediction.features[j]) for j in ranking[1][1]]
        if len(ranking) > 1
        else None
    )
    assert answer.posterior.runner_up_probability == pytest.approx(shares[1] if second else 0.0)
    assert answer.posterior.runner_up.tolist() == (second or [UNPAIRED] * len(rows))


@pytest.mark.parametrize("seed", range(240))
def test_a_wide_beam_finds_the_most_probable_of_all_hypotheses_and_its_share(seed):
    scan, prediction = small_problem(seed)
    prediction = dressed(prediction, seed)
    everything = hypotheses(scan, prediction, np.ones(len(prediction), bool), [UNPAIRED] * len(scan), None)
    answer = map_hypothesis(scan, prediction, **MODEL, **WIDE)
    check(answer, prediction, everything)
    assert not answer.effort.limit_hit


@pytest.mark.parametrize("seed", range(120))
def test_with_locality_what_is_near_is_decided_first(seed):
    scan, prediction = small_problem(500 + seed, locality=True)
    # localities without strays: each pairing is local to all that are local to the first
    group = np.random.default_rng(seed).integers(0, 3, len(prediction))
    prediction = dataclasses.replace(dressed(prediction, seed), local=lambda rows: group[rows][:, None] == group[rows])
    near, related = prediction.near, prediction.local(np.arange(len(prediction)))
    ranking = hypotheses(scan, prediction, near, [UNPAIRED] * len(scan), None)
    first = ranking[0][1]
    lists = oracles.compatible(scan, prediction, 0.999)
    if any(not near[j] for i, found in enumerate(lists) if first[i] == UNPAIRED for _, j in found):
        ranking = hypotheses(scan, prediction, ~near, first, related)
    check(map_hypothesis(scan, prediction, **MODEL, **WIDE), prediction, ranking)
    apart = hypotheses(scan, prediction, np.ones(len(prediction), bool), [UNPAIRED] * len(scan), None)
    check(map_hypothesis(scan, oracles.without_locality(prediction), **MODEL, **WIDE), prediction, apart)


def test_the_problems_above_are_hard_enough():
    """Answers differ from JCBB's and depend on what is in view, and runners-up are not far."""
    other = seen = close = 0
    for seed in range(240):
        scan, prediction = small_problem(seed)
        plain = map_hypothesis(scan, prediction, **MODEL)
        other += not np.array_equal(
            plain.features, jcbb(scan, dataclasses.replace(prediction, confidence=0.999)).features
        )
        looking = map_hypothesis(scan, dataclasses.replace(prediction, view=densities.edge), **MODEL)
        seen += not np.array_equal(plain.features, looking.features)
        close += plain.posterior.runner_up_probability > 0.1
    assert other > 30 and seen > 10 and close > 30, (other, seen, close)


@pytest.mark.parametrize("seed", range(30))
def test_the_denser_the_clutter_the_fewer_the_pairings(seed):
    scan, prediction = oracles.problem(np.random.default_rng(seed), 8, 10, spread=2.0)
    pairings = [map_hypothesis(scan, prediction, clutter_density=d).dof for d in (1e-6, 1e-2, 1.0, 1e3, 1e9)]
    assert pairings == sorted(pairings, reverse=True) and pairings[-1] == 0


@pytest.mark.parametrize(
    "options",
    [
        {"detection": 1.0},
        {"detection": math.nan},
        {"unseen": 0.0},
        {"clutter_density": -1.0},
        {"clutter_density": 0.0, "new_density": 0.0},
        {"width": 0},
        {"margin": 0.0},
    ],
)
def test_meaningless_options_are_refused(options):
    scan, prediction = oracles.problem(np.random.default_rng(0), 3, 3)
    with pytest.raises(ValueError, match=next(iter(options))):
        map_hypothesis(scan, prediction, **options)


@pytest.mark.parametrize("v", [[0.5, 0.5], [0.5, 0.5, 1.5], [0.5, math.nan, 0.5]])
def test_a_visibility_that_is_no_probability_is_refused(v):
    scan, prediction = oracles.problem(np.random.default_rng(0), 3, 3)
    with pytest.raises(ValueError, match="visibility"):
        map_hypothesis(scan, dataclasses.replace(prediction, view=lambda positions, covariances: np.array(v)))


def test_a_view_that_does_not_move_weighs_what_is_missed_from_the_predicted_pose():
    """Two features explain one measurement equally well: the one that should not be in view is not taken."""
    at = np.array([[3.0, 0.1], [3.0, -0.1]])
    scan, prediction = Scan.from_points([[3.0, 0.0]], sigma=0.05), Prediction.from_gaussian(at, 0.01 * np.eye(4))
    for hidden in (0, 1):
        seen = np.where(np.arange(2) == hidden, 0.01, 0.99)
        still = dataclasses.replace(prediction, view=lambda positions, covariances, v=seen: v, view_moves=False)
        assert map_hypothesis(scan, still).features.tolist() == [1 - hidden]
