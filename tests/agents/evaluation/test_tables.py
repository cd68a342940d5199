"""Estimates, differences and tables: what is pooled, what is paired, what is bold, what fits a terminal."""

import math

import numpy as np
import pandas as pd
import pytest
from rich.console import Console
from scipy.stats import binomtest

from agents.evaluation.tables import (
    Column,
    Table,
    best_names,
    cell,
    columns,
    difference,
    estimate,
    estimate_of,
    estimates,
    grouped,
    print_table,
    share,
)
from slam_gym.metrics.statistics import Interval, mean

HIGHER, LOWER = Column("score", "score", 3, "higher"), Column("error", "error", 3, "lower")


def test_models_of_one_agent_are_averaged_in_each_world_since_they_share_the_worlds():
    frame = pd.DataFrame([
        {"name": "ppo", "setting": "x", "model": model, "episode": k, "map_error": value, "coverage": np.nan}
        for model, value in (("a.zip", 0.2), ("b.zip", 0.4)) for k in range(10)
    ])  # fmt: skip
    row = estimates(frame, [Column("map_error", "map error", 3), Column("coverage", "coverage", 3)])
    assert (row["map_error"].estimate, row["map_error"].low, row["map_error"].high) == pytest.approx((0.3, 0.3, 0.3))
    assert math.isnan(row["coverage"].estimate)
    alike, error = frame.assign(map_error=frame["episode"] * 0.1), [Column("map_error", "map error", 3)]
    assert estimates(alike, error) == estimates(alike[:10], error)


def test_of_events_the_mean_is_taken_since_an_interquartile_mean_hides_a_quarter_of_them():
    frame = pd.DataFrame(
        {"name": "a", "setting": "x", "model": "", "episode": range(20), "recovered": [0.0] * 4 + [1.0] * 16}
    )
    assert estimates(frame, columns("recovered"))["recovered"].estimate == 0.8


def test_differences_are_paired_over_episodes_and_settings():
    frame = pd.DataFrame([
        {"name": name, "setting": setting, "episode": k, "f1": base + 0.1 * k + (0.05 if name == "a" else 0.0)}
        for name in ("a", "b") for setting, base in (("x", 0.0), ("y", 0.5)) for k in range(10)
    ])  # fmt: skip
    found = grouped(frame, "name")
    gap = difference(found["a"], found["b"], "f1")
    assert (gap.estimate, gap.low, gap.high) == pytest.approx((0.05, 0.05, 0.05))
    assert difference(found["a"], grouped(found["b"], "setting")["y"][:-1], "f1").estimate == pytest.approx(0.05)
    assert math.isnan(difference(found["a"], frame[:0], "f1").estimate)


def test_worlds_that_settings_share_count_once():
    rng, covered = np.random.default_rng(0), 0
    for _ in range(200):
        worlds, own = rng.normal(0.3, 0.1, 30), rng.normal(0.0, 0.1, (5, 30))
        rows = [{"setting": s, "episode": k, "f1": worlds[k] + own[s, k]} for s in range(5) for k in range(30)]
        found = estimate_of(pd.DataFrame(rows), "f1", mean, resamples=400)
        covered += found.low <= 0.3 <= found.high
    assert 0.87 < covered / 200 < 0.99  # 0.75 if resampled in each setting
    rows = [{"setting": s, "episode": k, "f1": float(s)} for s in range(2) for k in range(12 - 2 * s)]
    assert estimate_of(pd.DataFrame(rows), "f1", mean).estimate == 0.5  # without the worlds that lack a setting
    none, one, half = (estimate([first] + [0.0] * 11, statistic=share) for first in (0.0, 1.0 / 7.0, 1.0))
    exact = binomtest(1, 12).proportion_ci()
    assert none.high == pytest.approx(1.0 - 0.025 ** (1.0 / 12.0)) and none.high < one.high < half.high
    assert (half.low, half.high) == pytest.approx((exact.low, exact.high))


def test_a_few_values_have_no_interval_and_are_told_from_nothing() -> None:
    alone, apart = estimate([0.7]), estimate([0.1, 0.5] * 4 + [0.3])
    assert (alone.estimate, apart.estimate) == pytest.approx((0.7, 0.3)) and cell(alone, 3) == ("0.700", "")
    assert np.isnan([alone.low, alone.high, apart.low, apart.high]).all()
    assert best_names({"a": alone, "b": apart}, LOWER) == set()
    assert np.isfinite(estimate([0.2, 0.4] * 5).low)
    few, many = (Table("Few", "name", [LOWER], {"a": {"error": value}}) for value in (alone, estimate([0.2, 0.4] * 5)))
    assert few.note == "interquartile mean" and many.note == "interquartile mean, 95 % interval"


def test_the_ceiling_is_never_the_best_and_what_is_not_told_apart_shares_the_place():
    found = {"a": Interval(0.5, 0.4, 0.6), "b": Interval(0.9, 0.8, 0.95), "true_association": Interval(1.0, 1.0, 1.0)}
    assert best_names(found, HIGHER) == {"b"} and best_names(found, LOWER) == {"a"}
    assert best_names(found, Column("x", "x", 3)) == set()
    assert best_names(found | {"c": Interval(0.8, 0.7, 0.85)}, HIGHER) == {"b", "c"}
    assert best_names({"a": Interval(0.5, 0.4, 0.6), "b": Interval(0.5, 0.4, 0.6)}, HIGHER) == set()
    assert not Table("", "", [LOWER], {"a": {"error": 0.1}, "b": {"error": 0.2}}).bold["error"]  # each from one run


@pytest.mark.parametrize("width", [60, 80, 200])
def test_a_table_fits_the_terminal_and_no_header_is_cut(width, capsys):
    columns = [Column(f"scenario-{k}", f"scenario-{k}", 3) for k in range(9)] + [Column("rest", "rest", 1)]
    row = {column.key: Interval(0.1234, 0.0567, 0.2345) for column in columns}
    table = Table("scores [of some]", "who", columns, {"some_body": row})
    print_table(table, Console(width=width))
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= width and "…" not in text and "scores [of some]" in text
    assert all(f"scenario-{k}" in text for k in range(9)) and "rest" in text
    assert (text.count("some body") == 1) == (width == 200) and "0.057–0.234" in text
