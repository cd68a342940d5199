"""Decisions by their probability, counted and summed."""

import dataclasses
import json
import math

import numpy as np
import pytest

from agents.suite.reliability import EDGES, binned, by_associator, promise_tables, promised, tables, together
from agents.suite.worlds import WorldTask
from slam_gym.types import UNPAIRED, Effort, Hypothesis, Posterior


def answer(features, marginals):
    m = len(features)
    posterior = Posterior(0.0, 0.5, np.full(m, UNPAIRED), 0.1, np.array(marginals), np.zeros(m))
    return Hypothesis(np.array(features), 0.0, 0, Effort(), posterior)


def test_every_decision_falls_into_one_bin():
    answers = [answer([3, UNPAIRED, 5], [0.95, 0.2, 1.0]), answer([4, UNPAIRED], [0.95, 0.0])]
    right = [np.array([3, 2, 5]), np.array([6, UNPAIRED])]
    bins = binned(answers, right)
    assert len(bins["decisions"]) == len(EDGES) - 1 and sum(bins["decisions"]) == 5
    whole = together([{"reliability": bins}, {"reliability": bins}, {}])
    assert whole["decisions"].sum() == 10
    k = int(np.searchsorted(EDGES, 0.95)) - 1
    assert (whole["decisions"][k], whole["predicted"][k], whole["right"][k]) == (4, pytest.approx(0.95), 0.5)
    assert math.isnan(whole["right"][3]) and whole["right"][0] == 1.0 and whole["right"][-1] == 1.0
    json.dumps(bins)


def test_the_best_hypothesis_is_held_to_its_promise():
    """The best one may not be the one decided for: then it is the runner-up."""
    sure, refusing = answer([3, UNPAIRED], [0.9, 0.9]), answer([UNPAIRED, UNPAIRED], [0.6, 0.9])
    posterior = Posterior(0.0, 0.2, np.array([3, UNPAIRED]), 0.7, np.zeros(2), np.zeros(2))
    refusing = dataclasses.replace(refusing, posterior=posterior)
    right = [np.array([3, UNPAIRED]), np.array([3, UNPAIRED])]
    assert promised([sure, refusing], right) == {"promised": pytest.approx(0.6), "kept": 1.0}
    assert promised([sure, refusing], [np.array([4, UNPAIRED]), right[1]])["kept"] == 0.5
    silent = promised([Hypothesis(np.array([1]), 0.0, 2, Effort())], [np.array([1])])
    assert all(math.isnan(value) for value in silent.values())
    about = {"experiment": "drift", "episode": 0}
    records = [
        {"associator": "own", "setting": f"drift/{k}", **about, **promised([sure], [right[0]])} for k in range(2)
    ] + [{"associator": "jcbb", "setting": "drift/0", **about, **silent}]
    (table,) = promise_tables(records)
    assert list(table.rows) == ["drift", "drift/0", "drift/1"] and "own" in table.title


def test_who_says_nothing_has_no_table():
    silent = Hypothesis(np.array([1]), 0.0, 2, Effort())
    records = [
        {"associator": "jcbb", "reliability": binned([silent], [np.array([1])])},
        {"associator": "own", "reliability": binned([answer([1], [0.8])], [np.array([1])])},
    ]
    assert list(by_associator(records)) == ["own"]
    (table,) = tables(records)
    assert list(table.rows) == ["0.7 to 0.9"] and table.rows["0.7 to 0.9"]["right"] == 1.0


def test_the_suite_counts_all_decisions_of_those_who_say_how_probable_they_are():
    task = WorldTask("clutter/1", 0, ("jcbb", "map_hypothesis", "marginal"), 4, "train")
    records = task.run(task.keys)
    found = by_associator(records)
    assert list(found) == ["map_hypothesis", "marginal"]
    for bins in found.values():
        assert bins["decisions"].sum() > 20
        # most of what is all but sure is right
        assert bins["right"][-1] > 0.9
