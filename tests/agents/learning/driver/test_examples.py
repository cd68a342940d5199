"""States of drives and what came of each goal that was tried in them."""

import numpy as np

from agents.drivers.goal_network import shapes
from agents.drivers.goal_tokens import TOKEN_FIELDS, most_promising, tokens_of
from agents.drivers.learned import SIZE, VERSION
from agents.evaluation.episodes import ExploreArguments
from agents.learning.driver.examples import Drive, policy_of, together
from agents.learning.driver.sketch import Sketch, played
from slam_gym.weights import load


def test_a_drive_gives_the_same_states_each_time_and_values_for_legal_goals():
    one, two = (Drive("office-small", 7).run() for _ in range(2))
    assert all(np.array_equal(a, b) for a, b in zip(one, two))
    assert (one.values[~one.legal] == 0.0).all() and (one.values[one.legal] > 0.0).all() and one.values.max() <= 100.0
    assert (one.legal.sum(axis=1) > 1).all() and len(one) == len(one.tokens) > 1


def test_the_values_are_what_is_mapped_in_the_end():
    found, greedy = Drive("office-small", 9, budgets=(1.0, 1.0)).run(), policy_of(None)
    env = ExploreArguments("office-small", split="train").make("goal")
    env.reset(seed=9, options={"world": 9})
    sketch = Sketch(env.unwrapped.episode, 300)
    rows, tokens = most_promising(tokens_of(sketch.observation(), sketch.ticks), sketch.legal)
    assert np.array_equal(found.tokens[0], tokens.fields) and rows[0] == greedy(sketch)
    assert np.array_equal(found.legal[0], sketch.legal[rows]) and found.legal[0].sum() > 1
    for k in np.flatnonzero(found.legal[0]):
        assert found.values[0, k] == 100.0 * (1.0 - played(sketch.fork(), greedy, int(rows[k])))


def test_who_drives_on_decides_what_a_goal_is_worth():
    weights = load("driver", VERSION, TOKEN_FIELDS, shapes(SIZE))
    greedy, learner = (Drive("office-small", 7, w).run() for w in (None, weights))
    assert np.array_equal(greedy.tokens[0], learner.tokens[0])
    assert not all(np.array_equal(a, b) for a, b in zip(greedy.values, learner.values))
    assert len(together([greedy, learner])) == len(greedy) + len(learner)
