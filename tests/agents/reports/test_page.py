"""The pieces of every report: one file that reads without the network, tables with what is best in bold."""

import re

import pytest

from agents.evaluation.tables import Column, Table
from agents.reports.page import Report, card, image, label, page, provenance, table
from slam_gym.metrics.statistics import Interval
from tests.agents.reports import PNG, Page

CONTENT = {
    "commands": [{"command": "python -m agents.evaluate --x '<&>'", "started": "now", "seconds": 3}],
    "complete": True,
    "conditions": {"split": "test", "overrides": {"sensor.range": 4.0}, "relocation": None},
    "asked": {"episodes": 8},
    "models": {"/a/b.pt": {"sha256": "abc", "training": {"timesteps": 5, "scenario": "hall", "seed": 2}}},
    "versions": {"slam_gym": "0.1.0"},
}
NAMES = ["random", "mine:Agent<b>"]


def test_a_page_is_well_formed_and_says_how_it_was_made():
    read = Page(page(Report("A <title>", "about & more", [card(image(PNG, "a 'picture'"))]), CONTENT))
    assert read.pictures == [PNG]
    for expected in (
        "A <title>",
        "about & more",
        "--x '<&>'",
        "overrides.sensor.range 4.0",
        "k = 0 … 7",
        "slam_gym 0.1.0",
    ):
        assert expected in read.text
    assert "b.pt: sha256 abc, 5 decisions on hall, seed 2" in provenance(CONTENT) and "None" not in provenance(CONTENT)


def test_an_unfinished_evaluation_says_so():
    assert "unfinished" in page(Report("t", "s", []), CONTENT | {"complete": False})
    assert "unfinished" not in page(Report("t", "s", []), CONTENT)


def cells(markup: str) -> list[list[tuple[str, str]]]:
    """(class, text) of the cells of each row but the first column and the header."""
    rows = re.findall(r"<tr><td>.*?</tr>", markup)
    return [re.findall(r"<td(?: class=(\w+))?>(?!<span)(.*?)</td>", row) for row in rows]


def test_the_best_of_a_column_is_bold():
    columns = [Column("a", "a", 2, "lower"), Column("b", "b", 0, "higher"), Column("c", "c", 1)]
    found = {
        NAMES[0]: {"a": Interval(0.5, 0.4, 0.6), "b": 3, "c": 1.0},
        NAMES[1]: {"a": Interval(0.2, 0.1, 0.3), "b": 3},
    }
    markup = table(Table("", "who", columns, found), NAMES)
    assert "Agent<b>" in Page(markup).text
    (first, second) = cells(markup)
    assert first == [("", "0.50<small>[0.40, 0.60]&nbsp;</small>"), ("", "3"), ("", "1.0")]
    assert second == [("best", "0.20<small>[0.10, 0.30]&nbsp;</small>"), ("", "3"), ("", "")]


def test_differences_are_signed_and_bold_where_they_are_told_from_0():
    rows = {"a": {"x": Interval(-0.2, -0.3, -0.1)}, "b": {"x": Interval(0.1, -0.1, 0.3)}}
    markup = table(Table("", "…", [Column("x", "x", 1)], rows, differences=True), ["a", "b"])
    assert cells(markup) == [
        [("best", "−0.2<small>[−0.3, −0.1]&nbsp;</small>")], [("", "+0.1<small>[−0.1, +0.3]&nbsp;</small>")],
    ]  # fmt: skip


def test_a_name_keeps_its_colour():
    dots = [re.findall("#[0-9a-f]{6}", label(name, ["a", "b", "true_association"]))[0] for name in ("a", "b")]
    assert dots[0] != dots[1]
    with pytest.raises(KeyError):
        label("c", ["a"])
