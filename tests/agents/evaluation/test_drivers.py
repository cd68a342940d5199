"""Drivers are evaluated on the same episodes, and learned ones are pooled over their model files."""

import json

import numpy as np
import pytest
from rich.console import Console

from agents.evaluation.drivers import Driver, driver_evaluation, drivers_of, kidnappings, tables
from agents.evaluation.episodes import ExploreArguments
from agents.evaluation.pipeline import DRIVERS, Execution, Results, carry_out
from slam_gym.metrics.statistics import interquartile_mean


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    evaluation = driver_evaluation(
        drivers_of(["random", "nearest_frontier"], [], False), ExploreArguments("office-small"), range(3)
    )
    return carry_out(evaluation, tmp_path_factory.mktemp("drivers"), Execution(console=Console(quiet=True)))


def test_every_agent_drives_the_same_episodes(finished):
    records = finished.records
    names = ["random", "nearest_frontier"]
    assert [(r["agent"], r["episode"]) for r in records] == [(name, k) for name in names for k in range(3)]
    assert {r["ticks"] for r in records} == {300}
    starts = {(r["episode"], r["curve"]["coverage"][0]) for r in records}
    assert len(starts) == 3  # coverage before the first step is a fingerprint of world and start


def test_the_table_is_that_of_the_records(finished):
    content, (table,) = finished.content, tables(finished)
    assert content["complete"] and content["conditions"]["scenario"] == "office-small"
    assert content["seeds"][2] == {"seed": 2, "options": {"world": 2}}
    values = np.array([r["map_error"] for r in finished.records if r["agent"] == "random"])
    assert content["table"]["random"]["map_error"]["estimate"] == interquartile_mean(values)
    assert table.rows["random"]["map_error"].estimate == interquartile_mean(values)
    assert list(table.rows) == list(content["table"]) == ["random", "nearest_frontier"]
    assert json.dumps(content["table"], allow_nan=False)


def test_a_model_alone_adds_the_learned_agent():
    assert [d.agent for d in drivers_of(["random"], ["a.pt", "b.pt"], False)] == ["random", "ppo", "ppo"]
    assert drivers_of(["random", "random"], [], False) == [Driver("random")]


def test_what_became_of_robots_that_were_carried_away():
    carried = {"agent": "random", "episode": 0, "kidnapped": 1.0, "relocations_wrong": 2.0}
    records = [
        carried | {"recovered": 1.0, "ticks_astray": 30.0},
        carried | {"episode": 1, "recovered": 0.0, "ticks_astray": 400.0},
        {"agent": "lawnmower", "episode": 0, "kidnapped": 0.0},
    ]
    (line,) = kidnappings(Results(DRIVERS, {}, records))
    assert line.startswith("random: carried away 2, recovered 1, never 1, wrong relocations 4; ticks astray 30")
