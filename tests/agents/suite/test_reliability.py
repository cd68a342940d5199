"""Decisions by their probability, counted and summed."""

import json
import math

import numpy as np
import pytest

from agents.suite.reliability import EDGES, binned, by_associator, tables, together
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
