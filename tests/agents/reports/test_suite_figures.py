"""The figures of the suite are drawn for whatever was asked."""

import math

import numpy as np
import pytest

from agents.reports.suite_figures import capability_bars, level_chart, outcome_bars, radar, reliability_chart
from agents.suite.numbers import LevelCurve
from slam_gym.metrics.statistics import Interval
from tests.agents.reports import PNG

SCORE = Interval(0.5, 0.4, 0.6)


@pytest.mark.parametrize("names", [["jcbb", "singles", "true_association"], ["true_association"], ["jcbb"]])
def test_scores_are_drawn(names):
    scores = {name: {"closure": SCORE, "clutter": SCORE, "density": SCORE, "all": SCORE} for name in names}
    curves = {name: LevelCurve(np.array([0.0, 1.0]), [SCORE, SCORE]) for name in names}
    for picture in (capability_bars(scores, names), radar(scores, names), level_chart(curves, "knob", names)):
        assert picture.startswith(PNG)


def test_outcomes_are_drawn_even_where_there_were_none():
    outcomes = {"correct": 3, "silent": 1, "wrong": 0, "refused": 0, "invented": 0}
    assert outcome_bars({"gcbb": outcomes, "spectral": dict.fromkeys(outcomes, 0)}).startswith(PNG)


def test_reliability_is_drawn_where_bins_are_empty_or_certain():
    bins = {"decisions": [0, 3, 9], "predicted": [math.nan, 0.4, 1.0], "right": [math.nan, 0.0, 1.0]}
    found = {"marginal": {key: np.array(values) for key, values in bins.items()}}
    assert reliability_chart(found).startswith(PNG)
