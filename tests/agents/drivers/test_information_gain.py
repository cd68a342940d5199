"""Greedy information gain weighs new floor and revisits on one scale."""

from agents.drivers.information_gain import GainSpec, InformationGain, InformationGainNoRevisits
from slam_gym.simulation.goals import FRONTIERS
from tests.agents.drivers import offered

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
