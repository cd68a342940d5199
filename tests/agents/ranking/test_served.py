"""Entries in processes of their own decide as they would here, see no simulator, and their faults are told by name."""

import numpy as np
import pytest

from agents.drivers.base import make_agent
from agents.evaluation.episodes import ExploreArguments, run_episode
from agents.ranking.served import (
    Entry,
    EntryError,
    ServedAgent,
    ServedAssociator,
    ServedRelocator,
    role_of,
)
from slam_gym.association import gcbb, marginal
from slam_gym.slam.slam import Slam
from tests.rollouts import differences, relocate

STRANGERS = "tests.agents.ranking.strangers"
WORLD = ExploreArguments("office-small", (("budget", 60),))


@pytest.fixture
def serve():
    """Entries that end with the test."""
    entries = []

    def make(role, name, **options):
        entries.append(Entry(role, name, **options))
        return entries[-1]

    yield make
    for entry in entries:
        entry.close()


def told(record):
    return {name: value for name, value in record.items() if name not in ("seconds", "ticks_per_second")}


def test_an_agent_drives_as_it_does_in_this_process(serve):
    agent = ServedAgent(serve("agent", "nearest_frontier"))
    here = run_episode(WORLD.make("goal"), make_agent("nearest_frontier"), 1)
    assert told(run_episode(WORLD.make(agent.action), agent, 1)) == told(here)


def test_an_associator_that_asks_for_everything_decides_as_it_does_in_this_process(serve):
    served, driver = ServedAssociator(serve("associator", "marginal")), make_agent("nearest_frontier")
    here = run_episode(WORLD.make("goal", associator=marginal), driver, 1)
    assert told(run_episode(WORLD.make("goal", associator=served), driver, 1)) == told(here)


def test_a_relocator_finds_what_it_finds_in_this_process(serve):
    served, env = ServedRelocator(serve("relocator", "gcbb")), relocate()
    for seed in range(2):
        env.reset(seed=seed)
        problem = env.kidnapped.scan, env.mapped.landmarks, env.mapped.locality("covisibility")
        one, other = served(*problem), gcbb(*problem)
        np.testing.assert_array_equal(one.features, other.features)
        assert not differences(one.pose, other.pose) and one.accepted == other.accepted


def test_there_is_no_simulator_and_no_truth_where_an_entry_runs(serve):
    agent = ServedAgent(serve("agent", f"{STRANGERS}:Snooping"))
    assert run_episode(WORLD.make("goal"), agent, 0)["decisions"] > 0


def scan_problem():
    slam, env = Slam(), WORLD.make("twist").unwrapped
    env.reset(seed=0)
    slam.step(env.episode.odometry, env.episode.scan, "jcbb")
    return env.episode.scan, slam.map.prediction(6.0)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("failing", "associator '.*:failing': ValueError: no idea"),
        ("dying", "associator '.*:dying': its process ended"),
        ("slow", "associator '.*:slow': no answer in 1 s"),
        ("answering_nonsense", "expected a Hypothesis, got dict"),
    ],
)
def test_faults_are_told_by_name(serve, name, said):
    served = ServedAssociator(serve("associator", f"{STRANGERS}:{name}", timeout=120.0 if name != "slow" else 1.0))
    with pytest.raises(EntryError, match=said):
        served(*scan_problem())


def test_what_does_not_exist_is_refused_at_the_start():
    with pytest.raises(EntryError, match=r"agent 'nobody': ValueError: unknown agent 'nobody'"):
        Entry("agent", "nobody")


def test_roles_are_told_by_names():
    assert role_of("jcbb") == "associator" and role_of("gcbb") == "relocator" and role_of("lawnmower") == "agent"
    assert role_of(f"{STRANGERS}:Snooping") == "agent"
    with pytest.raises(ValueError, match="give --role"):
        role_of(f"{STRANGERS}:mine")
    with pytest.raises(ValueError, match="give its model file"):
        role_of("ppo")
