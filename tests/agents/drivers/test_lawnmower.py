"""The lawn-mower drives lane by lane, back and forth."""

import numpy as np

from agents.drivers.lawnmower import Lawnmower, LawnmowerSpec
from slam_gym.simulation.goals import FRONTIERS
from tests.agents.drivers import offered


def test_lawnmower_finishes_its_lane_before_it_takes_the_next_one():
    agent = Lawnmower(LawnmowerSpec(lane_width=4.0))
    agent.reset(0)
    goals = {(x, y): (x, y, 1.0, 1, 0) for x in (2.0, 6.0, -5.0) for y in (0.5, 4.0, 8.0)}
    pose, visited = np.zeros(3), []
    while goals:
        observation, info = offered(list(goals.values()), pose=pose)
        chosen = list(goals)[agent.act(observation, info) - 1]
        del goals[chosen]
        visited.append(chosen)
        pose = np.array([*chosen, 0.7])  # the robot's heading must not matter
    assert visited[:3] == [(2.0, 0.5), (6.0, 0.5), (-5.0, 0.5)]  # ahead first, then back
    assert [y for _, y in visited] == [0.5] * 3 + [4.0] * 3 + [8.0] * 3
    there, back = [(2.0, 4.0), (6.0, 4.0), (-5.0, 4.0)], [(-5.0, 4.0), (2.0, 4.0), (6.0, 4.0)]
    assert visited[3:6] in (there, back)


def test_lawnmower_goes_over_the_revisits_once_no_frontier_is_left():
    agent = Lawnmower()
    agent.reset(0)
    assert agent.act(*offered([], [(3, 0, 3, 0, 0.1)])) == 1 + FRONTIERS
