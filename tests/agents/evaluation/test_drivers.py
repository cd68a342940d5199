"""Drivers are evaluated on the same episodes, and learned ones are pooled over their model files."""

import json

import numpy as np
import pytest

from agents.drivers.base import make_agent
from agents.evaluation.episodes import ExploreArguments, driver_evaluation, drivers_of, run_episode
from agents.evaluation.pipeline import carry_out


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    drivers = drivers_of(["random", "nearest_frontier"], [], False)
    evaluation = driver_evaluation(drivers, [ExploreArguments("office-small", (("budget", 80),))], range(3))
    return carry_out(evaluation, tmp_path_factory.mktemp("drivers"), jobs=1)


def test_every_agent_drives_the_same_episodes(finished):
    frame = finished.frame
    assert list(frame["name"]) == 3 * ["random", "nearest_frontier"]
    assert list(frame["episode"]) == [0, 0, 1, 1, 2, 2] and set(frame["ticks"]) == {80}
    starts = {(k, json.loads(curve)["coverage"][0]) for k, curve in zip(frame["episode"], frame["curve"])}
    assert len(starts) == 3  # coverage before the first step is a fingerprint of world and start


SMALL = ExploreArguments("office-small")


def test_an_error_of_a_driver_names_it(monkeypatch):
    agent = make_agent("random")
    monkeypatch.setattr(agent, "act", lambda observation, info: np.zeros(3) + np.zeros(2))
    with pytest.raises(ValueError, match="broadcast") as failed:
        run_episode(SMALL.make("goal"), agent, 0)
    assert failed.value.__notes__ == ["raised by agent random"]


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
