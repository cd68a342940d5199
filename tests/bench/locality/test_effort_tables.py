"""Fits and tables of the benchmark of locality."""

import numpy as np
import pytest

from slam_gym.bench.locality.effort_tables import (
    answers_table,
    effort,
    effort_table,
    exponent,
    exponents_table,
    growth,
    growth_table,
    localities_table,
    power,
)
from slam_gym.bench.locality.hypothesis_count import bound
from slam_gym.bench.locality.sweep import Sweep


def attempts(n, m, **figures):
    """Made-up attempts of one search under one locality."""
    count = len(next(iter(figures.values())))
    zero = ("hypotheses", "nodes", "pairing tests", "ms", "right pairings", "true pairings", "all right", "right")
    row = {
        "search": "GCBB",
        "locality": "two hops",
        "n": n,
        "m": m,
        **dict.fromkeys((*zero, "accepted", "limit hit"), 0),
    }
    return [row | {name: float(values[i]) for name, values in figures.items()} for i in range(count)]


def test_fits_recover_the_exponents_that_counts_were_made_with():
    rng = np.random.default_rng(0)
    made = [a for n in (800, 1600, 3200) for a in attempts(n, 8, tests=3.0 * n**1.5 * rng.lognormal(0.0, 0.2, 40))]
    fit = power(made, "n", "tests", rng)
    assert fit.low < 1.5 < fit.high and fit.high - fit.low < 0.2
    made = [a for m in (4, 6, 8) for a in attempts(400, m, nodes=7.0 * 1.8**m * np.ones(3))]
    found = growth(made, "m", "nodes", rng)
    assert found.estimate == pytest.approx(1.8) and found.low == pytest.approx(1.8)
    assert np.isnan(growth(made[:3], "m", "nodes", rng).estimate)
    assert exponent([1.0, 2.0, 4.0], [3.0, 12.0, 48.0]) == pytest.approx(2.0)


def test_effort_is_of_all_pairings_and_of_scans():
    found = effort(
        attempts(50, 8, nodes=[1, 3], **{"right pairings": [6, 2], "true pairings": [6, 6], "all right": [1, 0]})
    )
    assert (found["scans"], found["nodes"]) == (2, 2.0)
    assert (found["pairings found"], found["all found"]) == (pytest.approx(8 / 12), 0.5)


def test_a_series_that_ended_early_is_named():
    longer = attempts(50, 8, nodes=[1]) + attempts(100, 8, nodes=[2])
    shorter = [row | {"search": "RS"} for row in longer[:1]]
    title, rows = effort_table("Effort", longer + shorter)
    assert "RS under two hops: n = 50, m = 8" in title and "GCBB" not in title and len(rows) == 3
    assert "ended" not in effort_table("Effort", longer).title


def test_the_unpruned_tree_has_its_own_rows():
    localities = [
        {"locality": "everything", "n": n, "m": m, "mean c": n, "max c": n, "N_h": bound(n, m, n)}
        | dict.fromkeys(("pairs", "pairings", "scans", "anyhow"), 0.0)
        for n, m in ((50, 4), (100, 4), (100, 8))
    ]
    over_n = exponents_table(Sweep(attempts(50, 4, nodes=[1]), localities[:2]), 50).rows
    assert [row["search"] for row in over_n] == ["unpruned"] and over_n[0]["N_h"] == pytest.approx(4.0, abs=0.2)
    over_m = growth_table(Sweep([], localities[1:])).rows
    assert over_m[0]["nodes: factor per measurement"] == pytest.approx(101.0)
    shown = localities_table(localities).rows
    assert shown[0]["9.22 max c"] == shown[0]["N_h"] and shown[0]["(n+1)^m"] == 51.0**4


def test_answers_are_asked_for_by_two_to_all_measurements_and_the_rule():
    flags = {"inside": True, "right": True, "pairings": 3, "accepted": True, "ambiguous": False}
    rows = answers_table("Answers", [{"search": "RS", "m": 4, **flags}]).rows
    assert [row["asked"] for row in rows] == ["rule", ">= 2", ">= 3", ">= 4"]
    assert [row["right"] for row in rows] == [1, 1, 1, 0]
