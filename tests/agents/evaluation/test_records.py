"""Records survive on disk: a journal that was cut short, JSON without NaN, CSV without lists."""

import csv
import json

import pytest

from agents.evaluation.records import Journal, Key, versions, write_csv, write_json
from slam_gym.metrics.statistics import Interval


def test_a_line_cut_short_is_ignored_and_stays_a_line_of_its_own(tmp_path):
    journal = Journal(tmp_path / "records.jsonl")
    assert journal.read() == []
    journal.append({"episode": 0})
    with (tmp_path / "records.jsonl").open("a") as file:
        file.write('{"agent": "random", "epis')  # as a crash would leave it
    journal.append({"episode": 1})
    assert journal.read() == [{"episode": 0}, {"episode": 1}]


def test_a_record_is_known_by_who_where_and_when():
    record = {"agent": "ppo", "model": "a.pt", "episode": 3, "map_error": 0.1}
    assert Key.of_record(record, "agent") == Key("ppo", None, 3, "a.pt")
    assert Key.of_record({"associator": "jcbb", "setting": "hall", "episode": 1}, "associator") == (
        "jcbb",
        "hall",
        1,
        None,
    )


def test_json_without_nan(tmp_path):
    write_json(tmp_path / "x.json", {"a": [float("nan"), 1.0, {"b": float("inf")}], "c": Interval(1.0, 0.5, 1.5)})
    told = json.loads((tmp_path / "x.json").read_text(), parse_constant=lambda name: pytest.fail(name))
    assert told == {"a": [None, 1.0, {"b": None}], "c": {"estimate": 1.0, "low": 0.5, "high": 1.5}}


def test_csv_has_one_row_a_record_and_no_lists(tmp_path):
    write_csv(tmp_path / "x.csv", [{"a": 1, "curve": {"t": [1, 2]}}, {"a": 2, "b": 0.5, "curve": {}}])
    with (tmp_path / "x.csv").open() as file:
        assert list(csv.DictReader(file)) == [{"a": "1", "b": ""}, {"a": "2", "b": "0.5"}]


def test_versions_name_what_results_depend_on():
    assert {"slam_gym", "numpy", "python", "commit"} <= set(versions())
