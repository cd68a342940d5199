"""States of episodes and what the teacher expects of each goal in them."""

import numpy as np

from agents.drivers.goal_network import shapes
from agents.drivers.goal_tokens import TOKEN_FIELDS
from agents.drivers.learned import SIZE, VERSION
from agents.learning.driver.examples import Drive, together
from slam_gym.weights import load


def test_an_episode_gives_the_same_states_each_time_and_values_for_legal_goals():
    one, two = (Drive("office-small", 7, teacher=0.0).run() for _ in range(2))
    assert all(np.array_equal(a, b) for a, b in zip(one, two))
    assert np.isfinite(one.values).all() and (one.values[~one.legal] == 0.0).all() and one.values.max() <= 120.0
    assert one.legal[:, 0].all() and len(one) == len(one.tokens) > 1
    assert one.values[0].max() > one.values[-1].max()  # what is mapped cannot be won any more


def test_who_drives_decides_which_states_there_are():
    weights = load("driver", VERSION, TOKEN_FIELDS, shapes(SIZE))
    greedy, learner = (Drive("office-small", 7, w, teacher=0.0).run() for w in (None, weights))
    assert np.array_equal(greedy.tokens[0], learner.tokens[0])
    assert not all(np.array_equal(a, b) for a, b in zip(greedy.tokens, learner.tokens))
    assert len(together([greedy, learner])) == len(greedy) + len(learner)
