"""Associators in the loop: metered without a change, the truth for the one that is known by name alone."""

import math

import numpy as np
import pytest
from rich.console import Console

from agents.drivers.base import make_agent
from agents.evaluation.associators import (
    Metered,
    associator_evaluation,
    columns_for,
    find_associator,
    metered,
    numbers,
    shipped,
    tables,
)
from agents.evaluation.episodes import ExploreArguments, reset_arguments, run_episode
from agents.evaluation.pipeline import Execution, carry_out
from slam_gym.association import ASSOCIATORS, nearest_neighbour
from slam_gym.envs.explore import ExploreEnv
from slam_gym.metrics.statistics import interquartile_mean
from slam_gym.types import Effort, Hypothesis

NAMES = ["nearest_neighbour", "true_association"]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    evaluation = associator_evaluation(NAMES, [ExploreArguments("office-small")], "nearest_frontier", range(2))
    return carry_out(evaluation, tmp_path_factory.mktemp("associators"), Execution(console=Console(quiet=True)))


def test_every_associator_meets_the_same_episodes(finished):
    records = finished.records
    assert [(r["associator"], r["episode"]) for r in records] == [(name, k) for name in NAMES for k in range(2)]
    assert {record["setting"] for record in records} == {"office-small"}
    assert {record["ticks"] for record in records} == {300.0}


def test_true_association_makes_no_mistake_in_the_loop(finished):
    for record in finished.records:
        truth = record["associator"] == "true_association"
        for key in ("precision", "recall", "f1", "exact"):
            assert record[key] == 1.0 if truth else 0.3 < record[key] < 1.0
        assert math.isnan(record["nodes"]) == truth and math.isnan(record["microseconds"]) == truth
        assert record["tp"] + record["fn"] <= record["in_map"]
        assert record["precision"] == record["tp"] / (
            record["tp"] + record["fp_wrong"] + record["fp_spurious"] + record["fp_duplicate"]
        )


def test_the_meter_changes_nothing_and_counts_every_scan(finished):
    env = ExploreArguments("office-small", associator="nearest_neighbour").make("goal")
    plain = run_episode(env, make_agent("nearest_frontier"), 1)
    own = next(r for r in finished.records if r["associator"] == "nearest_neighbour" and r["episode"] == 1)
    for key in ("map_error", "precision", "recall", "anees", "duplicates", "ate", "decisions"):
        assert plain[key] == own[key]
    calls = []

    def associate(scan, prediction):
        calls.append(len(scan))
        return Hypothesis(nearest_neighbour(scan, prediction).features, 0.0, 0, Effort(nodes=7, limit_hit=True))

    meter = Metered(associate)
    env = ExploreEnv("office-small", associator=meter, action="twist")
    env.reset(**reset_arguments(0))
    for _ in range(3):
        env.step(np.zeros(2, np.float32))
    assert meter.nodes == [7] * len(calls) and meter.limits == len(meter.seconds) == len(calls) == 4
    assert meter.effort()["nodes"] == 7.0 and meter.effort()["limits"] == 4.0
    meter.reset()
    assert not meter.nodes and not meter.limits and math.isnan(meter.effort()["nodes"])


def mine(scan, prediction):
    """An associator of a user: nearest neighbour."""
    return nearest_neighbour(scan, prediction)


def test_associators_are_found_by_name_and_only_the_name_is_told_the_truth():
    assert find_associator("jcbb") is ASSOCIATORS["jcbb"] and find_associator(f"{__name__}:mine") is mine
    assert metered("true_association")[1] == "true_association"
    meter, associate = metered("jcbb")
    assert meter is associate
    with pytest.raises(ValueError, match=r"nn.*jcbb"):
        find_associator("nn")
    assert set(shipped()) == set(ASSOCIATORS) and shipped()[0] == "nearest_neighbour"
    assert shipped()[-1] == "true_association"


def test_the_table_is_that_of_the_records(finished):
    (table, *headline), told = tables(finished), finished.content["table"]["office-small"]
    assert [shown.title.split()[0] for shown in headline] == ["Map", "Map"]
    for name in NAMES:
        own = [record for record in finished.records if record["associator"] == name]
        for key in ("precision", "f1", "duplicates", "map_error", "anees"):
            expected = interquartile_mean(np.array([record[key] for record in own]))
            assert told[name][key]["estimate"] == table.rows[name][key].estimate == pytest.approx(expected)
            assert told[name][key]["low"] <= told[name][key]["estimate"] <= told[name][key]["high"]
    assert told["true_association"]["nodes"]["estimate"] is None


def test_relocations_are_compared_under_names_of_their_own():
    evaluation = associator_evaluation(
        ["jcbb", "true_association"], [ExploreArguments("office-small")], "random", range(2), [None, "gcbb"]
    )
    names = ["jcbb", "jcbb + gcbb", "true_association", "true_association + gcbb"]
    assert [task.keys[0].name for task in evaluation.tasks] == 2 * names
    assert [task.arguments.relocation for task in evaluation.tasks[:4]] == [None, "gcbb"] * 2
    assert evaluation.conditions["relocation"] == [None, "gcbb"]
    one = associator_evaluation(["jcbb"], [ExploreArguments("office-small")], "random", range(1), ["indexed"])
    assert one.tasks[0].keys[0].name == "jcbb" and one.tasks[0].arguments.relocation == "indexed"


def test_several_scenarios_are_pooled_and_kidnappings_have_columns_of_their_own(finished):
    twice = finished.records + [record | {"setting": "hall"} for record in finished.records]
    assert list(numbers(twice)) == ["office-small", "hall", "all"]
    carried = [record | {"kidnapped": 1.0, "ticks_astray": 3.0} for record in finished.records]
    assert "recovered" in [column.key for column in columns_for(carried)]
    assert "recovered" not in [column.key for column in columns_for(finished.records)]
