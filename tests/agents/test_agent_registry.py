"""Names of agents: what is known, what is refused, what an agent may see."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from agents.drivers.base import AGENTS, BASELINES, find_agent, is_learned, make_agent, visible

ROOT = Path(__file__).parents[2]


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
