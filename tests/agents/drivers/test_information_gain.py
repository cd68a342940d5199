"""Greedy information gain weighs new floor and revisits on one scale."""

import numpy as np

from agents.drivers.base import visible
from agents.drivers.information_gain import GainSpec, InformationGain, InformationGainNoRevisits
from slam_gym.simulation.goals import FRONTIERS
from tests.agents.drivers import offered
from tests.rollouts import explore

SPEC = GainSpec(prior_sigma=0.5, density=0.4, speed=0.1, overhead=0.0, look=1e9)
NEAR, FAR = (1, 0, 2.0, 4.0, 0.0), (9, 0, 10.0, 10.0, 0.0)  # .04 and .02 m² a tick


def test_information_gain_weighs_new_area_and_reduction_per_tick():
    agent = InformationGain(SPEC)
    assert agent.act(*offered([FAR, NEAR])) == 2
    assert agent.act(*offered([FAR, NEAR], [(2, 0, 4.0, 0.0, 1.59)])) == 2  # just below .04 m² a tick
    assert agent.act(*offered([FAR, NEAR], [(2, 0, 4.0, 0.0, 1.61)])) == 1 + FRONTIERS


def test_without_revisits_it_takes_the_best_frontier():
    assert InformationGainNoRevisits(SPEC).act(*offered([FAR, NEAR], [(2, 0, 4.0, 0.0, 9.0)])) == 2


def test_what_has_been_looked_at_promises_less_the_next_time():
    agent, spots = InformationGain(SPEC), [(2, 0, 4.0, 0.0, 4.0), (5, 0, 8.0, 0.0, 6.0)]  # .1 and .075 m² a tick
    chosen = [agent.act(*offered([], spots)) - FRONTIERS for _ in range(4)]
    assert chosen == [1, 2, 1, 2]
    agent.reset(0)
    assert agent.act(*offered([], spots)) == 1 + FRONTIERS


def test_revisits_use_the_time_that_is_left_in_patrol():
    """Once all is explored, who goes back is surer of the map; who does not looks around to the end."""
    left = {}
    for driver in (InformationGain(), InformationGainNoRevisits()):
        env = explore("patrol", associator="true_association", relocation=None)
        observation, info = env.reset(seed=1, options={"world": 1})
        ended, explored_at = False, None
        while not ended:
            if explored_at is None and not info["action_mask"][1 : 1 + FRONTIERS].any():
                explored_at = env.episode.ticks
            observation, _, ended, _, info = env.step(driver.act(observation, visible(info)))
        P = env.episode.slam.map.arrays[1]
        left[driver.name] = np.trace(P[3:, 3:]) / (len(P) - 3)
        assert explored_at < 0.8 * env.scenario.budget
    assert left["information_gain"] < 0.9 * left["information_gain_no_revisits"]
