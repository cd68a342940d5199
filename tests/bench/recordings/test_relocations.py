"""Relocation on real data: how scans are judged, and what is counted."""

from dataclasses import replace

import numpy as np
import pytest

from slam_gym.bench.recordings import relocations
from slam_gym.bench.recordings.places import PlacedScan, park
from slam_gym.bench.recordings.relocations import (
    ASKED,
    Workload,
    answers_table,
    apart_table,
    attempts,
    localities_table,
    searches,
)
from slam_gym.bench.runner import main
from slam_gym.geometry import compose


@pytest.fixture(scope="module")
def place(data_dir):
    """The first 1500 steps of the park, mapped with the true association."""
    return park(data_dir / "victoria_park", ("true association",), 6, 1500)[0]


def record(**changes):
    row = {"place": "p", "search": "gcbb", "sizes": "used", "locality": "covisibility", "inside": True, "right": True}
    figures = {"pairings": 6, "accepted": False, "ambiguous": False, "nodes": 10, "limit hit": False, "ms": 1.0}
    return row | figures | {"metres": 0.1, "metres from GPS": 2.0} | changes


def test_an_answer_is_right_within_the_tolerance_of_its_place(place):
    """The same scans, with the pose that they are judged by moved away: nothing is right any more."""

    def judged_at(away):
        moved = [replace_pose(s, compose(s.pose, np.array([away, 0.0, 0.0]))) for s in place.scans[:6]]
        local = {"covisibility": place.localities["covisibility"]}
        found = attempts([replace(place, scans=moved, localities=local)], 2000)
        return [row for row in found if row["search"] == "gcbb" and row["sizes"] == "used"]

    here, there = judged_at(0.0), judged_at(5.0)
    assert sum(row["right"] for row in here) >= 3 and not any(row["right"] for row in there)
    for a, b in zip(here, there):
        assert all(a[name] == b[name] for name in ("pairings", "nodes", "accepted", "measurements"))


def replace_pose(placed, pose):
    return PlacedScan(placed.scan, pose, placed.inside, placed.gps)


def test_every_search_is_tried_under_every_locality_with_sizes_and_without(place):
    found = attempts([replace(place, scans=place.scans[:2])], 500)
    names = [(r["search"], r["sizes"], r["locality"]) for r in found]
    kinds = {(s, z, l) for s in searches(place.landmarks, 1) for z in ("used", "unknown") for l in place.localities}
    assert set(names) == kinds and len(names) == 2 * len(kinds)


def test_tables_are_by_place_search_and_locality():
    records = [
        record(search=s, locality=l, inside=i % 3 > 0, right=i % 3 == 1, pairings=i)
        for s in ("gcbb", "random_sampling")
        for l in ("covisibility", "everything")
        for i in range(10)
    ]
    answers = answers_table(records)
    assert len(answers) == 2 * len(ASKED)
    six = next(row for row in answers if row["asked"] == ">= 6")
    assert (six["right"], six["wrong"], six["outside: wrong"]) == (1, 1, 2)
    localities = localities_table(records)
    assert [row["locality"] for row in localities] == 2 * ["covisibility", "everything"]
    assert all((row["six: right"], row["six: wrong"], row["six: outside: wrong"]) == (1, 1, 2) for row in localities)
    assert [row["number"] for row in apart_table(records)] == [4, 4]


def test_distances_are_spans_and_unknown_ones_are_left_out():
    records = [record(metres=float(k), **{"metres from GPS": np.nan}) for k in range(5)]
    right, wrong = apart_table(records)
    assert right["m from the reference, 0 / 5 / 50 / 95 / 100 %"] == "0.00 / 0.20 / 2.00 / 3.80 / 4.00"
    assert right["m from the GPS"] == "" and wrong["number"] == 0


def test_the_command_prints_its_tables_and_writes_files(data_dir, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(relocations, "QUICK", Workload(0, 20, 1000, ()))
    main(["recordings", "--quick", "--data", str(data_dir), "--only", "room", "--out", str(tmp_path)])
    shown = capsys.readouterr().out
    for words in ("Answers by the number", "Localities", "rule", ">= 6", "limit hit", "room, surveyed"):
        assert words in shown
    lines = (tmp_path / "relocations.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 1 + 40 * 4 * 3


def test_without_data_the_command_asks_for_it(monkeypatch, capsys):
    monkeypatch.delenv("SLAM_GYM_DATA", raising=False)
    with pytest.raises(SystemExit):
        main(["recordings"])
    assert "SLAM_GYM_DATA" in capsys.readouterr().err
