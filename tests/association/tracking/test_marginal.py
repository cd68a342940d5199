"""What is decided by marginals, and what is told of it."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from scipy.special import logsumexp

from slam_gym.association import jcbb, marginal
from slam_gym.association.compatibility import individual
from slam_gym.association.tracking.marginals import marginals
from slam_gym.slam.slam import Slam
from slam_gym.types import UNPAIRED, Odometry, Prediction, Scan
from tests.oracles import association as oracles
from tests.oracles import densities
from tests.oracles.densities import MODEL, RATES, WIDE, small_problem


@pytest.mark.parametrize("seed", range(40))
def test_decisions_follow_the_cost_of_a_wrong_pairing(seed):
    scan, prediction = oracles.problem(np.random.default_rng(seed), 8, 10, spread=2.0)
    found, row_of = marginals(scan, prediction), {int(f): j for j, f in enumerate(prediction.features)}
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


def test_the_problems_above_are_hard_enough():
    """Costs decide, and answers differ from those of JCBB."""
    fewer = other = 0
    for seed in range(40):
        scan, prediction = oracles.problem(np.random.default_rng(seed), 8, 10, spread=2.0)
        cheap, dear = marginal(scan, prediction, cost=1.0), marginal(scan, prediction, cost=100.0)
        fewer += dear.pairings < cheap.pairings
        other += not np.array_equal(marginal(scan, prediction).features, jcbb(scan, prediction).features)
    assert fewer > 15 and other > 15, (fewer, other)


@pytest.mark.parametrize("seed", range(20))
def test_the_posterior_tells_of_all_decisions_together(seed):
    scan, prediction = small_problem(seed)
    every = densities.every_hypothesis(scan, prediction)
    scores = np.array([densities.log_density(scan, prediction, rows, RATES) for rows in every])
    answer = marginal(scan, prediction, cost=5.0, **MODEL, **WIDE)
    row_of = {int(f): j for j, f in enumerate(prediction.features)} | {UNPAIRED: UNPAIRED}
    decided = every.index([row_of[int(f)] for f in answer.features])
    assert answer.posterior.log_density == pytest.approx(scores[decided])
    assert answer.posterior.probability == pytest.approx(np.exp(scores[decided] - logsumexp(scores)))
    others = np.delete(scores, decided)
    second = np.exp(others.max() - logsumexp(scores)) if len(others) else 0.0
    assert answer.posterior.runner_up_probability == pytest.approx(second)


def test_experience_goes_with_the_run_and_is_nobody_elses():
    """The next prediction brings what the last hypothesis has learned; another run begins with nothing."""
    scan, odometry = (
        Scan.from_points([[1.0, 0.5], [2.0, -0.5], [1.5, 1.0]], sigma=0.05),
        Odometry.from_motion([0.1, 0, 0], 0.01),
    )
    slam, fresh = Slam(), Slam()
    first = slam.step(odometry, scan, "marginal")
    assert first.prediction.experience is None and first.hypothesis.experience.unpaired > 0.0
    second = slam.step(odometry, scan, "marginal")
    assert second.prediction.experience is first.hypothesis.experience
    slam.step(odometry, scan, "jcbb")
    assert slam.step(odometry, scan, "marginal").prediction.experience is second.hypothesis.experience
    assert fresh.step(odometry, scan, "marginal").prediction.experience is None


def test_a_wrong_pairing_with_a_provisional_feature_may_cost_less():
    prediction = Prediction.from_gaussian([[0.0, 0.0], [1.0, 0.0]], 0.05 * np.eye(4))
    scan = Scan.from_points([[0.4, 0.0]], sigma=0.05)
    p = marginals(scan, prediction).pairings[0]
    assert 0.6 < p[0] < 0.9  # worth it at a cost of 1, not at 10
    for provisional, price, expected in ((True, 1.0, 0), (True, 10.0, UNPAIRED), (False, 1.0, UNPAIRED)):
        told = dataclasses.replace(prediction, provisional=np.array([provisional, False]))
        assert marginal(scan, told, provisional_cost=price).features.tolist() == [expected]
        assert marginal(scan, told).features.tolist() == [UNPAIRED]


def test_a_measurement_between_two_features_is_refused():
    """JCBB takes the nearer one."""
    prediction = Prediction.from_gaussian([[0.0, 0.0], [1.0, 0.0]], 0.1 * np.eye(4))
    scan = Scan.from_points([[0.45, 0.0]], sigma=0.05)
    assert jcbb(scan, prediction).features.tolist() == [0]
    answer = marginal(scan, prediction)
    assert answer.features.tolist() == [UNPAIRED] and answer.posterior.unpaired[0] < 0.5
    assert marginal(scan, prediction, cost=1.0).features.tolist() == [0]


def test_what_is_new_is_told_from_the_others_although_the_gates_are_wide():
    """A robot that may stand half a metre away sees four features and, beside one of them, something else."""
    at = np.array([[1.0, 0.0], [3.0, 0.5], [4.0, -2.0], [2.0, 2.0]])
    prediction = Prediction.from_gaussian(at, np.tile(0.25 * np.eye(2), (4, 4)) + 1e-4 * np.eye(8))
    seen = np.concatenate([at, [[1.4, 0.3]]])
    scan = Scan.from_points(seen + np.array([0.5, 0.4]), sigma=0.02)
    answer = marginal(scan, prediction)
    assert answer.features.tolist() == [0, 1, 2, 3, UNPAIRED]
    assert answer.new.tolist() == [False] * 4 + [True]
    assert (individual(scan, prediction).measured == 4).any()


def test_of_two_features_at_one_place_none_is_paired():
    """Which one it is, nothing tells."""
    at = np.repeat(np.column_stack([np.arange(3.0), np.zeros(3)]), [2, 1, 1], axis=0)
    prediction = Prediction.from_gaussian(at, 0.01 * np.ones((8, 8)) + 1e-4 * np.eye(8))
    answer = marginal(Scan.from_points([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]], sigma=0.01), prediction)
    assert answer.features.tolist() == [UNPAIRED, 2, 3]
    assert answer.posterior.unpaired[0] < 1e-3 and answer.posterior.probability < 1e-3


@pytest.mark.parametrize(
    "options",
    [
        {"cost": 0.9},
        {"cost": math.inf},
        {"provisional_cost": 0.9},
        {"detection": 1.0},
        {"detection": math.nan},
        {"density": 0.0},
        {"density": math.inf},
        {"unseen": 0.0},
        {"width": 0},
        {"margin": 0.0},
    ],
)
def test_meaningless_options_are_refused(options):
    with pytest.raises(ValueError, match=f"{next(iter(options))}: "):
        marginal(*oracles.problem(np.random.default_rng(0), 3, 3), **options)
