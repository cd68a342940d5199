"""Worlds of the suite: the truth is the ceiling, refusing earns nothing, and nobody depends on who else is asked."""

import json
import math

import numpy as np
import pytest

from agents.suite.worlds import evaluate_all
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION
from slam_gym.types import UNPAIRED, Effort, Hypothesis, Relocation

ASSOCIATION = [name for name in EXPERIMENTS if name != RELOCATION]


def run(level, world, names, count):
    """The records of some names in a world of the train split."""
    return [{"name": name} | found for name, found in zip(names, evaluate_all(level, world, names, count, "train"))]


@pytest.mark.parametrize("name", ASSOCIATION)
def test_true_association_is_the_ceiling(name):
    names = ("true_association", "jcbb", "nearest_neighbour", "singles")
    for record in run(EXPERIMENTS[name].levels[-1].id, 0, names, 5):
        assert record["problems"] == 5 and 0.0 <= record["score"] <= 1.0
        if record["name"] == "true_association":
            assert (record["score"], record["exact"], record["spoiled"], record["refused"]) == (1.0, 1.0, 0.0, 0.0)


@pytest.mark.parametrize("name", ["closure", "clutter", "density", "dynamics"])
def test_nearest_neighbour_falls_from_one_end_of_the_sweep_to_the_other(name):
    first, last = (
        np.mean([run(level.id, k, ("nearest_neighbour",), 8)[0]["precision"] for k in range(3)])
        for level in (EXPERIMENTS[name].levels[0], EXPERIMENTS[name].levels[-1])
    )
    assert first - last > 0.05


def refuse(scan, prediction):
    return Hypothesis(np.full(len(scan), UNPAIRED), 0.0, 0, Effort(nodes=len(scan)))


def test_refusing_everything_earns_nothing():
    record = run("density/1", 0, (f"{__name__}:refuse",), 4)[0]
    assert record["score"] == 0.0 and record["refused"] == 1.0 and record["spoiled"] == 0.0
    assert math.isnan(record["precision"]) and record["recall"] == 0.0


def test_answers_do_not_depend_on_who_else_is_asked():
    names = ("nearest_neighbour", "jcbb", "true_association")
    together = run("dynamics/3", 1, names, 4)
    for name, record in zip(names[1:], together[1:]):
        alone = run("dynamics/3", 1, (name,), 4)[0]
        drop = {"microseconds": 0.0}
        assert json.dumps(alone | drop) == json.dumps(record | drop)


NOWHERE = (np.empty(0, np.int64), np.zeros(3), np.eye(3), 0.0, 0)


def silent(scan, landmarks, locality):
    return Relocation(*NOWHERE, 4, False, 0, Effort())


def eager(scan, landmarks, locality):
    return Relocation(np.arange(99), *NOWHERE[1:], 4, False, 0, Effort())


def test_neither_silence_nor_eagerness_pays():
    names = (f"{__name__}:silent", f"{__name__}:eager")
    quiet, loud = run("kidnapped/0", 0, names, 8)
    assert (quiet["score"], quiet["silent"], quiet["refused"]) == (0.0, 4, 4)
    assert (loud["score"], loud["correct"], loud["invented"]) == (0.0, 0, 4)
