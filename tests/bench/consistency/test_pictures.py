"""The picture of estimators compared."""

import pytest

from slam_gym.bench.consistency.estimators import ASSOCIATORS, METHODS

pytest.importorskip("matplotlib")
from slam_gym.bench.consistency.pictures import comparison


def test_every_run_is_a_dot_and_every_method_a_bar():
    records = [
        {"world": w, "method": m, "associator": a, "ANEES": 1.0 + s, "final [m]": 1.0, "duplicates": s}
        for w in ("loop, 2°", "hall")
        for m in METHODS
        for a in ASSOCIATORS
        for s in range(4)
    ]
    axes = comparison(records).axes
    assert len(axes) == 6 and axes[0].get_yscale() == "log" and axes[4].get_yscale() == "linear"
    for ax in axes:
        dots = [line for line in ax.lines if line.get_marker() == "."]
        assert sum(len(line.get_xdata()) for line in dots) == 2 * len(METHODS) * 4
    assert [text.get_text() for text in axes[1].get_legend().get_texts()] == list(METHODS)
