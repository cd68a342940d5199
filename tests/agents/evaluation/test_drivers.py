"""Drivers are evaluated on the same episodes, and learned ones are pooled over their model files."""

import json

import pytest

from agents.evaluation.drives import Driver, driver_evaluation, drivers_of
from agents.evaluation.episodes import ExploreArguments
from agents.evaluation.pipeline import carry_out
from agents.options import Execution
from agents.reports.drives import drive_tables
from slam_gym.metrics.statistics import interquartile_mean


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    drivers = drivers_of(["random", "nearest_frontier"], [], False)
    evaluation = driver_evaluation(drivers, [ExploreArguments("office-small", (("budget", 80),))], range(3))
    return carry_out(evaluation, tmp_path_factory.mktemp("drivers"), Execution(jobs=1))


def test_every_agent_drives_the_same_episodes(finished):
    frame = finished.frame
    assert list(frame["name"]) == 3 * ["random", "nearest_frontier"]
    assert list(frame["episode"]) == [0, 0, 1, 1, 2, 2] and set(frame["ticks"]) == {80}
    starts = {(k, json.loads(curve)["coverage"][0]) for k, curve in zip(frame["episode"], frame["curve"])}
    assert len(starts) == 3  # coverage before the first step is a fingerprint of world and start


def test_the_table_is_that_of_the_results(finished):
    (table,), frame = drive_tables(finished), finished.frame
    assert list(table.rows) == ["random", "nearest_frontier"] and table.title == "office-small, 3 episodes"
    values = frame.loc[frame["name"] == "random", "map_error"].to_numpy()
    assert table.rows["random"]["map_error"].estimate == interquartile_mean(values)


def test_a_model_alone_adds_the_learned_agent():
    assert [d.agent for d in drivers_of(["random"], ["a.zip", "b.zip"], False)] == ["random", "ppo", "ppo"]
    assert drivers_of(["random", "random"], [], False) == [Driver("random")]


def test_what_became_of_robots_that_were_carried_away(finished):
    (table,) = drive_tables(finished)
    carried = finished.frame.assign(kidnapped=1.0, recovered=1.0, ticks_astray=30.0)
    (further,) = drive_tables(finished._replace(frame=carried))
    assert [c.title for c in further.columns[len(table.columns) :]] == ["recovered", "wrong reloc.", "ticks astray"]
    assert further.rows["random"]["ticks_astray"].estimate == 30.0
