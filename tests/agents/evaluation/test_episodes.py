"""Episodes that agree with themselves, whoever watches; arguments that the environments take."""

import numpy as np
import pytest

from agents.drivers.base import make_agent
from agents.evaluation.episodes import ExploreArguments, run_episode

SMALL = ExploreArguments("office-small")


def test_a_record_agrees_with_itself_and_watching_does_not_change_it():
    seen, env = [], SMALL.make("goal")
    record = run_episode(env, make_agent("random"), 1)
    watched = run_episode(env, make_agent("random"), 1, watch=lambda e: seen.append(e.unwrapped.episode.ticks))
    curve = record["curve"]
    assert len(curve["ticks"]) == len(curve["map_error"]) == len(curve["coverage"])
    assert np.all(np.diff(curve["ticks"]) > 0) and curve["ticks"][-1] == record["ticks"] == 300
    assert record["map_error"] == pytest.approx(curve["map_error"][-1], abs=1e-5)
    assert record["return"] == pytest.approx(curve["map_error"][0] - curve["map_error"][-1], abs=1e-5)
    assert record["map_lost"] == float(record["map_error"] > 0.8 or record["duplicates"] > 10)
    assert seen == list(range(1, 301))
    timed = {"seconds": 0.0, "ticks_per_second": 0.0}
    assert str(watched | timed) == str(record | timed)


def test_arguments_are_those_of_the_environment_and_hashable():
    changed = ExploreArguments("office-small", (("sensor.range", 4.0), ("budget", 20)))
    env = changed.make("twist")
    assert (env.unwrapped.scenario.sensor.range, env.unwrapped.scenario.budget) == (4.0, 20)
    assert changed.plain["overrides"] == {"sensor.range": 4.0, "budget": 20} and hash(changed) != hash(SMALL)
    assert ExploreArguments("clutter/1").make("goal").unwrapped.scenario.sensor.clutter == 3.0
    with pytest.raises(ValueError, match=r"sensor\.rang.*range"):
        ExploreArguments("office-small", (("sensor.rang", 4.0),)).make("goal")
