"""Entries in processes of their own decide as they would here, and whatever they do, the evaluation goes on."""

import os
import select
import sys
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from agents.drivers.base import make_agent
from agents.evaluation.episodes import ExploreArguments, run_episode
from agents.ranking import entry_process, protocol
from agents.ranking.entry_process import EntryAgent, EntryError, EntryProcess, associate_in, relocate_in
from agents.ranking.protocol import FIRST, LOST, lose
from slam_gym.association import gcbb, marginal
from slam_gym.association.prediction import predict
from slam_gym.slam.slam import Slam
from tests.rollouts import differences, relocate

STRANGERS = "tests.agents.ranking.strangers"
WORLD = ExploreArguments("office-small", (("budget", 60),))


@pytest.fixture
def started():
    """Entries that end with the test."""
    entries = []

    def start(role, name):
        entries.append(EntryProcess(role, name))
        return entries[-1]

    yield start
    for entry in entries:
        entry.close()


def timeless(record):
    return {name: value for name, value in record.items() if name not in ("seconds", "ticks_per_second")}


def test_an_agent_drives_as_it_does_in_this_process(started):
    agent = EntryAgent(started("agent", "nearest_frontier"))
    here = run_episode(WORLD.make("goal"), make_agent("nearest_frontier"), 1)
    assert timeless(run_episode(WORLD.make(agent.action), agent, 1)) == timeless(here)


@pytest.mark.parametrize("detection", [0.9, 0.02])
def test_an_associator_that_looks_everything_up_decides_as_it_does_in_this_process(started, detection):
    world = replace(WORLD, overrides=(*WORLD.overrides, ("sensor.detection", detection)))  # 0.02: empty scans
    served, driver = partial(associate_in, started("associator", "marginal")), make_agent("nearest_frontier")
    here = run_episode(world.make("goal", associator=marginal), driver, 1)
    assert not differences(timeless(run_episode(world.make("goal", associator=served), driver, 1)), timeless(here))


def test_a_relocator_finds_what_it_finds_in_this_process(started):
    served, env = partial(relocate_in, started("relocator", "gcbb")), relocate()
    for seed in range(2):
        env.reset(seed=seed)
        problem = env.kidnapped.scan, env.mapped.landmarks, env.mapped.locality("covisibility")
        one, other = served(*problem), gcbb(*problem)
        np.testing.assert_array_equal(one.features, other.features)
        assert not differences(one.pose, other.pose) and one.accepted == other.accepted


def test_an_entry_finds_no_simulator_and_replaces_no_score(started):
    own, other = (EntryAgent(started("agent", f"{STRANGERS}:{name}")) for name in ("Driver", "Snooping"))
    expected, found = (run_episode(WORLD.make("goal"), agent, 0) for agent in (own, other))
    assert timeless(found) == timeless(expected) and found["decisions"] > 1


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("Raising", "ValueError: no idea  [31m"), ("Exiting", "its process ended"), ("Sleeping", "no answer in 1 s"),
        ("Illegal", "is not legal"), ("Writing", "nonsense"), ("Flooding", "nonsense"),
    ],
)  # fmt: skip
def test_a_driver_that_fails_loses_the_episode_and_drives_the_next(monkeypatch, started, name, said):
    process = started("agent", f"{STRANGERS}:{name}")
    monkeypatch.setattr(entry_process, "LIMIT", 1.0)
    monkeypatch.setattr(protocol, "process", lambda role, name: process)
    worlds = (FIRST, FIRST + 1) if name == "Exiting" else (FIRST,)  # every failure ends the process, in the same way
    for world in worlds:
        (record,) = lose(name, "agent", "office-small", world)
        assert record["loss"] == LOST and said in record["failed"] and name in record["failed"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs a named pipe")
def test_what_an_entry_has_started_ends_with_it(monkeypatch, started, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    monkeypatch.setenv("LEFT", str(tmp_path / "pipe"))
    process = started("agent", f"{STRANGERS}:Leaving")
    monkeypatch.setattr(protocol, "process", lambda role, name: process)
    pipe = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    (record,) = lose("Leaving", "agent", "office-small", FIRST)
    assert "its process ended" in record["failed"]
    assert select.select([pipe], [], [], 60.0)[0] and os.read(pipe, 1) == b""  # nobody has it open any more
    os.close(pipe)


@pytest.mark.parametrize(
    ("name", "said"),
    [("pairing_all_with_one", r"features\[0\]: 1000000"), ("answering_a_list", "expected a Hypothesis")],
)
def test_an_associator_that_answers_nonsense_is_refused(started, name, said):
    served, slam, env = partial(associate_in, started("associator", f"{STRANGERS}:{name}")), Slam(), WORLD.make("twist")
    env.reset(seed=0)
    episode = env.unwrapped.episode
    slam.step(episode.odometry, episode.scan, "jcbb")
    with pytest.raises(EntryError, match=said):
        served(episode.scan, predict(slam.map, 6.0))


@pytest.mark.parametrize(
    ("role", "name", "said"),
    [
        ("agent", "nobody", "unknown agent 'nobody'"),
        ("agent", "clairvoyant", "by the truth"),
        ("associator", "nowhere:f", "nowhere"),
    ],
)
def test_what_does_not_exist_is_refused_at_the_start(role, name, said):
    with pytest.raises(EntryError, match=said):
        EntryProcess(role, name)


def test_the_evaluator_imports_nothing_of_an_entry(started, tmp_path, monkeypatch):
    (tmp_path / "theirs.py").write_text("import sys\nsys.theirs = True\n\ndef associate(scan, prediction): ...\n")
    (tmp_path / "agents").mkdir()
    (tmp_path / "agents" / "__init__.py").touch()  # theirs, too
    monkeypatch.chdir(tmp_path)
    started("associator", "theirs:associate")
    assert "theirs" not in sys.modules and not hasattr(sys, "theirs")
