"""Figures are drawn in one style, where matplotlib is installed."""

import pytest

from slam_gym.bench import figures
from slam_gym.bench.figures import legend_below, panels, proportions, save
from slam_gym.metrics.statistics import Interval


def test_without_matplotlib_nothing_is_drawn(monkeypatch, tmp_path):
    monkeypatch.setattr(figures, "find_spec", lambda name: None)
    assert not save(tmp_path, {"never": lambda: pytest.fail("drawn")}) and not list(tmp_path.iterdir())


def test_every_figure_becomes_a_file(tmp_path):
    pytest.importorskip("matplotlib")

    def draw():
        figure, axes = panels(1, 2, (4.0, 2.0), sharey=True)
        axes[0][0].plot([0, 1], [0, 1], label="line")
        legend_below(figure, axes[0][0])
        return figure

    assert save(tmp_path / "new", {"a": draw, "b": draw})
    assert {path.name for path in (tmp_path / "new").iterdir()} == {"a.png", "b.png"}


def test_proportions_stand_where_they_were_asked_for_and_gaps_are_left_out():
    pytest.importorskip("matplotlib")
    _, axes = panels(1, 1, (3.0, 2.0))
    unknown = Interval(*[float("nan")] * 3)
    rows = [{"asked": "rule", "x": Interval(0.5, 0.4, 0.7)}, {"asked": ">= 3", "x": unknown}]
    rows.append({"asked": ">= 4", "x": Interval(0.2, 0.1, 0.3)})
    proportions(axes[0][0], rows, "x", shift=0.25, color="red", marker="o")
    points = axes[0][0].lines[0]
    assert points.get_xdata().tolist() == [0.25, 2.25] and points.get_ydata().tolist() == [0.5, 0.2]
    assert [text.get_text() for text in axes[0][0].get_xticklabels()] == ["rule", "3", "4"]
    proportions(axes[0][0], [{"asked": "rule", "x": unknown}], "x", shift=0.0, color="red")
