"""Agents by name: what is known, what is refused, what an agent may see, and what every classical one keeps to."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from agents.drivers.base import AGENTS, BASELINES, find_agent, is_learned, make_agent, visible
from tests.agents.drivers import offered

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("name", AGENTS)
def test_every_listed_agent_is_there_and_says_what_it_is(name):
    cls = find_agent(name)
    assert cls.name == name
    assert is_learned(name) == (name == "ppo")
    assert not any(is_learned(baseline) for baseline in BASELINES)


def test_an_unknown_name_lists_the_known_ones():
    with pytest.raises(ValueError, match=r"nearest_frontier.*information_gain"):
        make_agent("greedy")


@pytest.mark.parametrize("name", ["agents.nowhere:Agent", "agents.drivers.random:Nobody"])
def test_a_path_that_leads_nowhere_is_an_error_that_names_it(name):
    with pytest.raises(ValueError, match=name.split(":")[0]):
        make_agent(name)


def test_an_agent_of_ones_own_needs_no_registration():
    assert make_agent("agents.drivers.nearest_frontier:NearestFrontier").name == "nearest_frontier"


def test_a_learned_agent_without_model_says_how_to_get_one():
    with pytest.raises(ValueError, match=r"agents\.train"):
        make_agent("ppo")


def test_agents_see_nothing_that_is_measured_against_the_truth():
    info = {"truth": {"pose": np.zeros(3)}, "map_error": 0.3, "pose_nees": 2.0, "coverage": 0.5, "pairings_right": 4}
    seen = visible(info | {"ticks": 7, "pose": np.ones(3), "action_mask": np.ones(16, bool)})
    assert set(seen) == {"ticks", "pose", "action_mask"}


def test_the_classical_agents_import_no_torch():
    code = "import sys; from agents.drivers.base import BASELINES, make_agent; [make_agent(n) for n in BASELINES]; "
    code += "sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0


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
