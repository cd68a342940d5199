"""Kidnapped robots found again."""

from dataclasses import replace

import pytest

from slam_gym.bench.speed import relocate
from slam_gym.bench.speed.relocate import METHODS, relocate_all, summary
from slam_gym.scenarios import get_scenario


def test_every_method_is_given_every_scan(monkeypatch):
    short = replace(get_scenario("office"), budget=150)
    monkeypatch.setattr(relocate, "get_scenario", lambda name: short)
    methods = {name: METHODS[name] for name in ("gcbb", "greedy")}
    monkeypatch.setattr(relocate, "METHODS", methods)
    records = relocate_all("office", 1, 3, True) + relocate_all("office", 1, 3, False)
    assert len(records) == 2 * 2 * 6
    assert all(sum(r["inside"] for r in records if r["method"] == name) == 6 for name in methods)
    for r in records:
        assert r["right"] + r["wrong"] == r["accepted"] and not (r["right"] and not r["inside"])
    rows = summary(records)
    assert [(row["sizes"], row["method"]) for row in rows] == [(s, m) for s in (True, False) for m in methods]
    assert rows[0]["right"] >= 2 / 3


def test_fractions_are_of_the_scans_inside_and_outside():
    base = {"scenario": "s", "sizes": True, "method": "m", "ms": 1.0}
    inside = [{"inside": True, "right": k < 3, "wrong": k == 3, "nodes": k} for k in range(4)]
    outside = [{"inside": False, "right": False, "wrong": k == 0, "nodes": 10 * k} for k in range(3)]
    (row,) = summary([base | record for record in inside + outside])
    assert (row["right"], row["wrong"], row["nodes"]) == (0.75, 0.25, 1.5)
    assert (row["outside: wrong"], row["outside: nodes"]) == (pytest.approx(1 / 3), 10.0)
