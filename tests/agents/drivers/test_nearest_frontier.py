"""The nearest frontier is nearest along its path."""

from agents.drivers.nearest_frontier import NearestFrontier
from tests.agents.drivers import offered


def test_nearest_frontier_goes_by_path_length_and_leaves_revisits_alone():
    agent = NearestFrontier()
    frontiers = [(1, 0, 9.0, 5, 0), (5, 5, 4.0, 1, 0), (9, 9, 12.0, 30, 0)]
    assert agent.act(*offered(frontiers, [(0, 1, 0.5, 0, 1.0)])) == 2
    assert agent.act(*offered([], [(0, 1, 0.5, 0, 1.0)])) == 0
