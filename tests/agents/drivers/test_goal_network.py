"""The network of goals: what its scores may depend on, and what they may not."""

import numpy as np

from agents.drivers.goal_network import GAP, Size, choose, gaps_between, greedy_score, scores, shapes
from agents.drivers.goal_tokens import CHOICES, TOKEN_FIELDS, Tokens, most_promising

SIZE = Size(width=8, heads=2, layers=2, members=2)
RNG = np.random.default_rng(0)
ARRAYS = {name: RNG.normal(0.0, 0.3, shape).astype(np.float32) for name, shape in shapes(SIZE).items()}


def some_tokens(goals=7):
    rng = np.random.default_rng(1)
    fields, places = rng.normal(size=(goals, len(TOKEN_FIELDS))), rng.uniform(-9.0, 9.0, (goals, 2))
    return Tokens(fields, places, rng.uniform(0.0, 0.2, goals)), rng.random(goals) < 0.7


def test_the_order_of_goals_does_not_matter_and_their_number_may_change():
    tokens, legal = some_tokens()
    order = np.random.default_rng(2).permutation(len(legal))
    turned = Tokens(*(part[order] for part in tokens))
    assert np.allclose(scores(ARRAYS, SIZE, turned, legal[order]), scores(ARRAYS, SIZE, tokens, legal)[order])
    legal = np.append(legal, False)
    more = Tokens(*(np.concatenate([part, part[:1]]) for part in tokens))
    assert np.allclose(scores(ARRAYS, SIZE, more, legal)[:-1], scores(ARRAYS, SIZE, tokens, legal[:-1]))


def test_goals_that_are_not_legal_have_no_score_and_no_say():
    tokens, legal = some_tokens()
    found = scores(ARRAYS, SIZE, tokens, legal)
    assert np.isneginf(found[~legal]).all() and np.isfinite(found[legal]).all()
    other = tokens._replace(fields=np.where(legal[:, None], tokens.fields, 3.0))
    assert np.allclose(scores(ARRAYS, SIZE, other, legal)[legal], found[legal])
    other = tokens._replace(fields=np.where(np.arange(len(legal))[:, None] == legal.argmax(), 3.0, tokens.fields))
    assert not np.allclose(scores(ARRAYS, SIZE, other, legal)[legal][1:], found[legal][1:])


def test_without_a_residual_it_is_the_greedy_driver():
    tokens, legal = some_tokens()
    silent = ARRAYS | {"score.weight": np.zeros((2, 1, 8)), "score.bias": np.zeros((2, 1)), "greed": np.full(2, 3.0)}
    assert np.allclose(scores(silent, SIZE, tokens, legal)[legal], 3.0 * greedy_score(tokens.rates)[legal])


def test_gaps_are_symmetric_distances_that_end_somewhere():
    gaps = gaps_between(np.array([[0.0, 0.0], [3.0, 4.0], [100.0, 0.0]]))
    assert np.allclose(gaps, gaps.T) and np.isclose(gaps[0, 1], 5.0 / GAP) and gaps[0, 2] == 4.0


def test_it_chooses_among_the_most_promising_goals_that_are_legal():
    tokens, legal = some_tokens(goals=12)
    rows, weighed = most_promising(tokens, legal)
    best = np.flatnonzero(legal)[np.argsort(-tokens.rates[legal])][:CHOICES]
    assert np.array_equal(rows, best) and np.array_equal(weighed.fields, tokens.fields[best])
    for scale in (1.0, -1.0):
        turned = ARRAYS | {name: scale * ARRAYS[name] for name in ("score.weight", "score.bias", "greed")}
        expected = best[scores(turned, SIZE, weighed, np.ones(CHOICES, bool)).argmax()]
        assert choose(turned, SIZE, tokens, legal) == expected
    assert choose(ARRAYS, SIZE, tokens, np.arange(12) == 5) == 5
