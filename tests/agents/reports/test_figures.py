"""Figures that several reports share: one colour a name, pictures of the size that was asked for."""

import numpy as np
import pytest

from agents.reports.figures import INK, Panel, as_png, band, colours, curve_chart, dot_chart, new_figure
from slam_gym.metrics.statistics import Interval
from tests.agents.reports import PNG


def test_every_name_has_its_colour_and_the_truth_is_ink():
    found = colours(["true_association", "jcbb", "singles"])
    assert found["true_association"] == INK and len(set(found.values())) == 3
    assert found["jcbb"] == colours(["jcbb", "singles"])["jcbb"]


@pytest.fixture
def groups():
    ticks = [0, 100, 300]
    return {
        name: [
            {"episode": k, "x": value + 0.01 * k, "y": np.nan, "ticks": 300,
             "curve": {"ticks": ticks, "x": [1.0, 0.5, value]}}
            for k in range(4)
        ]
        for name, value in (("jcbb", 0.2), ("true_association", 0.1))
    }  # fmt: skip


@pytest.mark.parametrize("scale", ["linear", "percent", "log"])
def test_dots_are_drawn_whatever_is_missing(groups, scale):
    assert dot_chart(groups, [Panel("x", "x", scale), Panel("y", "nothing", scale)]).startswith(PNG)


def test_curves_are_drawn_over_the_longest_episode(groups):
    assert curve_chart(groups, [Panel("x", "x", "percent"), Panel("x", "x again")]).startswith(PNG)


def test_a_band_spans_its_intervals():
    figure = new_figure(2.0)
    axis = figure.subplots()
    band(axis, np.arange(2), [Interval(1.0, 0.5, 2.0), Interval(2.0, 1.0, 3.0)], "jcbb", ["jcbb"], marked=True)
    assert axis.lines[0].get_ydata().tolist() == [1.0, 2.0] and axis.lines[0].get_label() == "jcbb"
    low, high = axis.collections[0].get_paths()[0].get_extents().intervaly
    assert (low, high) == (0.5, 3.0) and as_png(figure).startswith(PNG)
