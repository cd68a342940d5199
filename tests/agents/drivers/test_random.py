"""The random agent is uniform and repeatable."""

import numpy as np

from agents.drivers.random import RandomAgent
from slam_gym.simulation.goals import FRONTIERS, SLOTS
from tests.agents.drivers import offered


def test_random_is_uniform_over_the_legal_goals_and_repeats_with_its_seed():
    agent = RandomAgent()
    offer = offered([(1, 0, 1, 1, 0), (2, 0, 2, 1, 0)], [(0, 1, 1, 0, 0.1)])
    drawn = []
    for _ in range(2):
        agent.reset(5)
        drawn.append([agent.act(*offer) for _ in range(4000)])
    assert drawn[0] == drawn[1]
    counts = np.bincount(drawn[0], minlength=SLOTS)[[0, 1, 2, 1 + FRONTIERS]]
    assert counts.sum() == 4000
    assert np.abs(counts - 1000).max() < 4 * np.sqrt(4000 * 0.25 * 0.75)
