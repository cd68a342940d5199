"""Tables as text and as CSV."""

import csv
import math

import pytest

from slam_gym.bench.report import Report, as_cell, as_text
from slam_gym.metrics.statistics import Interval


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (None, ""),
        (True, "yes"),
        (False, "no"),
        ("7 x", "7 x"),
        (12345678, "12345678"),
        (0.123456, "0.1235"),
        (12345.6, "12346"),
        (-2477.3, "-2477"),
        (1.23e9, "1.23e+09"),
        (math.nan, "nan"),
        (Interval(0.5, 0.25, 0.756), "0.5 [0.25, 0.756]"),
    ],
)
def test_cells_say_their_values(value, shown):
    assert as_cell(value) == shown


def test_columns_are_aligned_and_gaps_stay_blank():
    rows = [{"name": "a", "n": 1}, {"name": "long", "n": 1000, "more": 0.5}]
    assert as_text(rows).splitlines() == [
        "name     n  more",
        "a        1",
        "long  1000   0.5",
    ]


def test_csv_files_hold_what_the_table_rounds(tmp_path, capsys):
    rows = [{"n": 1, "x": 1 / 3}, {"n": 2, "fit": Interval(1.0, 0.5, 2.0)}]
    Report(tmp_path / "new").table("Title", rows, "file")
    assert capsys.readouterr().out.splitlines()[1] == "Title"
    with (tmp_path / "new" / "file.csv").open(encoding="utf-8") as file:
        found = list(csv.DictReader(file))
    assert float(found[0]["x"]) == 1 / 3 and found[0]["fit"] == ""
    assert [float(found[1][name]) for name in ("fit", "fit, low", "fit, high")] == [1.0, 0.5, 2.0]


def test_without_a_folder_nothing_is_written(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    report = Report()
    report.table("Title", [{"n": 1}], "file")
    report.pictures({"never": lambda: pytest.fail("drawn")})
    with report.part("this"):
        pass
    assert not list(tmp_path.iterdir()) and capsys.readouterr().out.endswith("this: 0 s\n")
