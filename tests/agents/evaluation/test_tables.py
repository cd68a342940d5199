"""Estimates, differences and tables: what is pooled, what is paired, what is bold, what fits a terminal."""

import math

import numpy as np
import pytest
from rich.console import Console

from agents.evaluation.tables import (
    Column,
    Table,
    best_names,
    by_name,
    by_setting,
    cell,
    difference,
    display_name,
    estimate,
    estimates,
    print_table,
)
from slam_gym.metrics.statistics import Interval

HIGHER, LOWER = Column("score", "score", 3, "higher"), Column("error", "error", 3, "lower")


def test_models_of_one_agent_are_pooled_and_resampled_each_on_its_own():
    records = [
        {"agent": "ppo", "model": model, "episode": k, "map_error": value, "coverage": np.nan}
        for model, value in (("a.pt", 0.2), ("b.pt", 0.4)) for k in range(10)
    ]  # fmt: skip
    row = estimates(records, [Column("map_error", "map error", 3), Column("coverage", "coverage", 3)])
    # Each model always gives the same value, so resampling within models leaves nothing to vary.
    assert (row["map_error"].estimate, row["map_error"].low, row["map_error"].high) == pytest.approx((0.3, 0.3, 0.3))
    assert np.isnan(row["coverage"].estimate)


def test_differences_are_paired_over_episodes_and_settings():
    records = [
        {"associator": name, "setting": setting, "episode": k, "f1": base + 0.1 * k + (0.05 if name == "a" else 0.0)}
        for name in ("a", "b") for setting, base in (("x", 0.0), ("y", 0.5)) for k in range(4)
    ]  # fmt: skip
    found = by_name(records, "associator")
    gap = difference(found["a"], found["b"], "f1")
    assert (gap.estimate, gap.low, gap.high) == pytest.approx((0.05, 0.05, 0.05))
    assert difference(found["a"], by_setting(found["b"])["y"][:-1], "f1").estimate == pytest.approx(0.05)
    assert math.isnan(difference(found["a"], [], "f1").estimate)


def test_the_ceiling_is_never_the_best_and_what_is_not_told_apart_shares_the_place():
    found = {"a": Interval(0.5, 0.4, 0.6), "b": Interval(0.9, 0.8, 0.95), "true_association": Interval(1.0, 1.0, 1.0)}
    assert best_names(found, HIGHER) == {"b"} and best_names(found, LOWER) == {"a"}
    assert best_names(found, Column("x", "x", 3)) == set()
    assert best_names(found | {"c": Interval(0.85, 0.7, 0.9)}, HIGHER) == {"b", "c"}
    assert best_names({"a": Interval(0.5, 0.4, 0.6), "b": Interval(0.5, 0.4, 0.6)}, HIGHER) == set()


def test_plain_numbers_are_compared_as_they_are_shown():
    assert best_names({"a": 0.1234, "b": 0.12341, "c": 0.2, "d": math.nan}, LOWER) == {"a", "b"}


@pytest.mark.parametrize(
    ("value", "digits", "signed", "told"),
    [
        (Interval(0.5, 0.25, 0.75), 2, False, ("0.50", "0.25, 0.75")),
        (Interval(math.nan, math.nan, math.nan), 2, False, ("–", "")),
        (Interval(-0.0001, -0.5, 0.5), 3, True, ("+0.000", "−0.500, +0.500")),
        (7, 0, False, ("7", "")),
        (math.nan, 1, False, ("–", "")),
        (math.inf, 1, False, ("∞", "")),
        (23456.7, 1, False, ("2e+04", "")),
        (23456.7, 0, False, ("23457", "")),
    ],
)
def test_values_as_text(value, digits, signed, told):
    assert cell(value, digits, signed) == told


def test_names_in_tables_are_short():
    assert display_name("a.b:my_way") == "my way" and display_name("/x/y/branches.pt") == "branches.pt"
    assert display_name("jcbb") == "jcbb"


@pytest.mark.parametrize("width", [60, 160])
def test_a_table_says_what_the_terminal_has_room_for(width, capsys):
    columns = [Column(f"score{k}", f"score {k}", 3) for k in range(6)] + [Column("rest", "rest", 1, optional=True)]
    row = {column.key: Interval(0.1234, 0.0567, 0.2345) for column in columns}
    print_table(Table("scores [of some]", "who", columns, {"some_body": row}), Console(width=width))
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= width and "some body" in text and "scores [of some]" in text
    if width == 60:
        assert "0.12" in text and ".06–.23" in text and "0.123" not in text and "rest" not in text
    else:
        assert "0.123" in text and "0.057–0.234" in text and "rest" in text


def test_headers_are_never_cut_a_table_that_is_too_wide_goes_on_below(capsys):
    columns = [Column(f"scenario-{k}", f"scenario-{k}", 3, "lower") for k in range(9)]
    row = {column.key: Interval(0.123, 0.101, 0.234) for column in columns}
    print_table(Table("Map error", "associator", columns, {"marginal + gcbb": row}), Console(width=80))
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= 80 and "…" not in text
    assert all(f"scenario-{k}" in text for k in range(9)) and text.count("associator") == text.count("marginal") == 2


def test_one_value_of_each_stratum_has_no_interval_and_is_told_from_nothing() -> None:
    alone, apart = estimate(np.array([0.7])), estimate(np.array([0.2, 0.4]), np.array([0, 1]))
    assert (alone.estimate, apart.estimate) == pytest.approx((0.7, 0.3))
    assert np.isnan([alone.low, alone.high, apart.low, apart.high]).all()
    assert cell(alone, 3) == ("0.700", "")
    assert best_names({"a": alone, "b": apart}, Column("x", "x", 3, "lower")) == set()
    assert np.isfinite(estimate(np.array([0.2, 0.3, 0.4]), np.array([0, 0, 1])).low)
