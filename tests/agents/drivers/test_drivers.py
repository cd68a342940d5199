"""Drivers by name: what is known, what is refused, what a driver may see, and how the classical ones choose."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from agents.drivers.base import AGENTS, BASELINES, find_agent, is_learned, make_agent, visible
from agents.drivers.baselines import InformationGain, Lawnmower, NearestFrontier, RandomAgent
from slam_gym.simulation.goals import FRONTIERS, SLOTS
from tests.agents.drivers import offered

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("name", AGENTS)
def test_every_listed_agent_is_there_and_says_what_it_is(name):
    cls = find_agent(name)
    assert cls.name == name
    assert is_learned(name) == (name == "ppo")
    assert not any(is_learned(baseline) for baseline in BASELINES)
    with pytest.raises(ValueError, match="learned: give its file" if is_learned(name) else "takes no model file"):
        make_agent(name, None if is_learned(name) else "model.zip")


def test_agents_see_nothing_that_is_measured_against_the_truth():
    info = {"truth": {"pose": np.zeros(3)}, "map_error": 0.3, "pose_nees": 2.0, "coverage": 0.5, "pairings_right": 4}
    seen = visible(info | {"ticks": 7, "pose": np.ones(3), "action_mask": np.ones(16, bool)})
    assert set(seen) == {"ticks", "pose", "action_mask"}


def test_those_that_ship_need_no_torch():
    code = "import sys; from agents.drivers.base import BASELINES, make_agent; "
    code += "[make_agent(n) for n in (*BASELINES, 'learned')]; "
    code += "sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0


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


def test_nearest_frontier_goes_by_path_length_and_leaves_revisits_alone():
    agent = NearestFrontier()
    frontiers = [(1, 0, 9.0, 5, 0), (5, 5, 4.0, 1, 0), (9, 9, 12.0, 30, 0)]
    assert agent.act(*offered(frontiers, [(0, 1, 0.5, 0, 1.0)])) == 2
    assert agent.act(*offered([], [(0, 1, 0.5, 0, 1.0)])) == 0


def test_lawnmower_finishes_its_lane_before_it_takes_the_next_one():
    agent = Lawnmower()
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


NEAR, FAR = (1, 0, 2.0, 4.0, 0.0), (9, 0, 10.0, 10.0, 0.0)  # 0.020 and 0.012 m² a tick


def test_information_gain_weighs_new_area_and_reduction_per_tick():
    agent = InformationGain()
    assert agent.act(*offered([FAR, NEAR])) == 2
    assert agent.act(*offered([FAR, NEAR], [(2, 0, 4.0, 0.0, 1.09)])) == 2  # just below 0.020 m² a tick
    assert agent.act(*offered([FAR, NEAR], [(2, 0, 4.0, 0.0, 1.11)])) == 1 + FRONTIERS


def test_what_has_been_looked_at_promises_less_the_next_time():
    agent, spots = InformationGain(), [(2, 0, 4.0, 0.0, 4.0), (5, 0, 8.0, 0.0, 6.0)]  # 0.073 and 0.057 m² a tick
    chosen = [agent.act(*offered([], spots)) - FRONTIERS for _ in range(4)]
    assert chosen == [1, 2, 1, 2]
    agent.reset(0)
    assert agent.act(*offered([], spots)) == 1 + FRONTIERS
