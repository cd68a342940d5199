"""The classical drivers choose what their definitions say, on goals laid out by hand."""

import numpy as np
import pytest

from agents.drivers.base import BASELINES, make_agent
from agents.drivers.information_gain import GainSpec, InformationGain
from agents.drivers.lawnmower import Lawnmower, LawnmowerSpec
from slam_gym.envs.goal_observation import encode_goals
from slam_gym.simulation.goals import FRONTIERS, SLOTS, Goals


def offered(frontiers=(), revisits=(), pose=(0.0, 0.0, 0.0)):
    """Observation and info with goals given as (x, y, path, area, reduction), x and y in B."""
    positions, numbers, legal = np.zeros((SLOTS, 2)), np.zeros((SLOTS, 3)), np.zeros(SLOTS, bool)
    positions[0], legal[0] = pose[:2], True
    for first, goals in ((1, frontiers), (1 + FRONTIERS, revisits)):
        for slot, goal in enumerate(goals, first):
            positions[slot], numbers[slot], legal[slot] = goal[:2], goal[2:], True
    goals = Goals(positions, numbers[:, 0], numbers[:, 1], numbers[:, 2], legal)
    pose = np.array(pose)
    return {"goals": encode_goals(goals, pose)}, {"pose": pose, "action_mask": legal, "ticks": 5}


@pytest.mark.parametrize("name", BASELINES)
def test_nothing_but_looking_around_on_offer(name):
    agent = make_agent(name)
    agent.reset(3)
    assert agent.act(*offered()) == 0


@pytest.mark.parametrize("name", BASELINES)
def test_only_legal_goals_are_chosen(name):
    rng, agent = np.random.default_rng(0), make_agent(name)
    for trial in range(100):
        agent.reset(trial)
        goals = np.column_stack([rng.uniform(-9, 9, (9, 2)), rng.uniform(0, 20, (9, 2)), rng.uniform(0, 0.2, 9)])
        count, back = rng.integers(0, 6), rng.integers(0, 4)
        observation, info = offered(goals[:count], goals[6 : 6 + back], pose=rng.uniform(-3, 3, 3))
        assert info["action_mask"][agent.act(observation, info)]


def test_random_is_uniform_over_the_legal_goals_and_repeats_with_its_seed():
    agent = make_agent("random")
    offer = offered([(1, 0, 1, 1, 0), (2, 0, 2, 1, 0)], [(0, 1, 1, 0, 0.1)])
    runs = []
    for _ in range(2):
        agent.reset(5)
        runs.append([agent.act(*offer) for _ in range(4000)])
    assert runs[0] == runs[1]
    counts = np.bincount(runs[0], minlength=SLOTS)[[0, 1, 2, 1 + FRONTIERS]]
    assert counts.sum() == 4000
    assert np.abs(counts - 1000).max() < 4 * np.sqrt(4000 * 0.25 * 0.75)


def test_nearest_frontier_goes_by_path_length_and_leaves_revisits_alone():
    agent = make_agent("nearest_frontier")
    frontiers = [(1, 0, 9.0, 5, 0), (5, 5, 4.0, 1, 0), (9, 9, 12.0, 30, 0)]
    assert agent.act(*offered(frontiers, [(0, 1, 0.5, 0, 1.0)])) == 2
    assert agent.act(*offered([], [(0, 1, 0.5, 0, 1.0)])) == 0


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
    assert visited[3:6] == [(2.0, 4.0), (6.0, 4.0), (-5.0, 4.0)] or visited[3:6] == [
        (-5.0, 4.0),
        (2.0, 4.0),
        (6.0, 4.0),
    ]


def test_lawnmower_goes_over_the_revisits_once_no_frontier_is_left():
    agent = Lawnmower()
    agent.reset(0)
    assert agent.act(*offered([], [(3, 0, 3, 0, 0.1)])) == 1 + FRONTIERS


def test_information_gain_weighs_new_area_and_reduction_per_tick():
    spec = GainSpec(prior_sigma=0.5, density=0.4, speed=0.1, overhead=0.0, look=1e9)
    agent = InformationGain(spec)
    near, far = (1, 0, 2.0, 4.0, 0.0), (9, 0, 10.0, 10.0, 0.0)  # .04 and .02 m² a tick
    assert agent.act(*offered([far, near])) == 2
    assert agent.act(*offered([far, near], [(2, 0, 4.0, 0.0, 1.59)])) == 2  # just below .04 m² a tick
    assert agent.act(*offered([far, near], [(2, 0, 4.0, 0.0, 1.61)])) == 1 + FRONTIERS
