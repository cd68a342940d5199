"""Records survive on disk: a journal that was cut short, JSON without NaN, CSV without lists."""

import csv
import json

import numpy as np
import pytest

from agents.evaluation.records import (
    Journal,
    Key,
    setting_of,
    stem,
    versions,
    write_csv,
    write_json,
    write_whole,
    written_whole,
)
from slam_gym.metrics.statistics import Interval


def test_a_line_cut_short_is_ignored_and_stays_a_line_of_its_own(tmp_path):
    journal = Journal(tmp_path / "records.jsonl")
    assert journal.read() == []
    journal.append({"episode": 0})
    with (tmp_path / "records.jsonl").open("a") as file:
        file.write('{"agent": "random", "epis')  # as a crash would leave it
    journal.append({"episode": 1})
    assert journal.read() == [{"episode": 0}, {"episode": 1}]


@pytest.mark.parametrize(
    ("before", "after"), [("0.25", "0.15"), ('"episode": 1', '"episode": 3'), ("jcbb", "nn"), ('"x": true', '"x": 1')]
)
def test_an_edited_line_is_refused_by_its_number(tmp_path, before, after):
    journal, path = Journal(tmp_path / "records.jsonl", "a"), tmp_path / "records.jsonl"
    for episode in range(2):
        journal.append({"associator": "jcbb", "episode": episode, "map_error": 0.25, "x": True})
    lines = path.read_text().splitlines()
    assert before in lines[1]
    path.write_text("\n".join([lines[0], lines[1].replace(before, after)]) + "\n")
    with pytest.raises(ValueError, match=r"records\.jsonl, line 2: was changed"):
        journal.read()


def test_any_byte_changed_is_refused_or_run_again(tmp_path):
    path, rng = tmp_path / "records.jsonl", np.random.default_rng(0)
    journal = Journal(path, "a")
    whole = [{"associator": "jcbb", "setting": "hall", "episode": k, "map_error": 0.1 * k} for k in range(3)]
    for record in whole:
        journal.append(record)
    data = path.read_bytes()
    for _ in range(500):
        changed, at = bytearray(data), rng.integers(len(data))
        changed[at] = rng.integers(256)
        path.write_bytes(bytes(changed))
        try:
            assert all(record in whole for record in journal.read())
        except ValueError as error:
            assert "line" in str(error)


def test_records_of_another_setting_are_refused(tmp_path):
    path = tmp_path / "records.jsonl"
    Journal(path, setting_of("suite", {"split": "test"})).append({"episode": 0})
    assert Journal(path, setting_of("suite", {"split": "test"})).read() == [{"episode": 0}]
    for other in (setting_of("suite", {"split": "train"}), setting_of("drivers", {"split": "test"})):
        with pytest.raises(ValueError, match="line 1: a record of another setting"):
            Journal(path, other).read()


def test_a_file_that_cannot_be_written_leaves_the_old_one(tmp_path, monkeypatch):
    write_whole(tmp_path / "x.html", "old")
    (tmp_path / "x.html.partial").mkdir()  # as a full disk: nothing can be written there
    with pytest.raises(OSError):
        write_whole(tmp_path / "x.html", "new")
    assert (tmp_path / "x.html").read_text() == "old"


def test_names_of_files_hold_whatever_an_associator_is_called() -> None:
    assert stem("mrclam/MRCLAM_Dataset6/robot1", "my.module:way") == "mrclam-MRCLAM_Dataset6-robot1.my-module-way"


def test_an_interruption_leaves_the_old_file_and_nothing_else(tmp_path):
    write_whole(tmp_path / "model.pt", "old")
    with pytest.raises(KeyboardInterrupt), written_whole(tmp_path / "model.pt") as partial:
        partial.write_text("half of the n")
        raise KeyboardInterrupt
    assert [path.name for path in tmp_path.iterdir()] == ["model.pt"]
    assert (tmp_path / "model.pt").read_text() == "old"


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
