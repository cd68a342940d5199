"""A logistic model of answers, and what ways to accept come to."""

import numpy as np
import pytest

from agents.learning.acceptance.answers import Answer, Asked
from agents.learning.acceptance.training import accepted_by, by_rule, fit, odds_of, outcome
from slam_gym.association.learned.network import network_of


def drawn(seed: int, count: int = 400) -> list[Answer]:
    """Answers that are right with log odds 2 x₀ − x₁, and one number that never varies."""
    rng = np.random.default_rng(seed)
    x = np.column_stack([rng.normal(size=(count, 2)), np.ones(count)])
    right = rng.random(count) < 1.0 / (1.0 + np.exp(x[:, 1] - 2.0 * x[:, 0]))
    return [Answer(row, bool(r), True, bool(row[0] > 0.0)) for row, r in zip(x, right)]


def test_the_odds_that_answers_were_drawn_with_are_learned():
    network = network_of(fit(drawn(0, 4000)))
    assert network.linear / network.scale == pytest.approx([2.0, -1.0, 0.0], abs=0.2)
    odds = odds_of(network, drawn(1, 4000))
    right = np.array([a.right for a in drawn(1, 4000)])
    assert right[odds > 2.0].mean() == pytest.approx(0.93, abs=0.03)


def test_nothing_is_learned_of_answers_that_are_all_alike():
    with pytest.raises(ValueError, match="all answers are right, or none is"):
        fit([a._replace(right=True) for a in drawn(0)])


def test_outcomes_are_counted_of_all_problems():
    right, wrong = Answer(np.zeros(3), True, True, True), Answer(np.zeros(3), False, True, False)
    invented = Answer(np.zeros(3), False, False, True)
    worlds = [Asked([right, wrong], 4, 5), Asked([right, invented, invented], 4, 5)]
    assert by_rule(worlds) == (0.25, 0.0, 0.2)
    everything = [np.ones(len(one.answers), np.bool_) for one in worlds]
    assert outcome(worlds, everything) == (0.25, 0.125, 0.2)


def test_what_is_dear_is_accepted_seldom():
    answers = drawn(2)
    arrays, worlds = fit(answers), [Asked(answers, len(answers), 0)]
    cheap, dear = (outcome(worlds, accepted_by(arrays, worlds, cost)) for cost in (1.0, 10.0))
    assert dear.wrong < cheap.wrong and dear.recall < cheap.recall
