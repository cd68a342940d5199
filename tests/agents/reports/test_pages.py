"""Reports: one file that reads without the network, tables with what is best in bold, names that cannot break it."""

import json
import re

import pandas as pd
import pytest

from agents import report
from agents.reports.pages import write_report
from tests.agents import typed
from tests.agents.reports import PNG, Page

METADATA = {
    "kind": "drivers",
    "commands": [{"command": "slam-gym evaluate --x '<&>'", "started": "now", "seconds": 3}],
    "complete": True,
    "conditions": {
        "split": "test", "scenario": "<hall>", "floor_plan": None, "associator": None,
        "overrides": {"sensor.range": 4.0}, "relocation": None,
    },
    "models": {"/a/b.zip": {"sha256": "abc", "training": {"timesteps": 5, "scenario": "hall", "seed": 2}}},
    "versions": {"slam_gym": "0.1.0"},
}  # fmt: skip


@pytest.fixture
def folder(tmp_path):
    """Eleven episodes of two agents: the second makes better maps, and has a film."""
    curve = json.dumps({"ticks": [0, 10], "map_error": [1.0, 0.5], "coverage": [0.1, 0.5]})
    numbers = dict.fromkeys(
        ("map_error_aligned", "coverage", "precision", "recall", "anees", "map_lost", "kidnapped"), 0.5
    )
    rows = [
        {"name": name, "setting": "<hall>", "episode": k, "model": "", "map_error": error + 0.01 * k, "ticks": 10,
         "ticks_per_second": 100.0, "curve": curve, "recovered": 1.0, "relocations_wrong": 0.0, "ticks_astray": 3.0,
         **numbers}
        for name, error in zip(("random", "mine:Agent<b>"), (0.6, 0.2)) for k in range(11)
    ]  # fmt: skip
    pd.DataFrame(rows).to_csv(tmp_path / "results.csv", index=False)
    (tmp_path / "results.json").write_text(json.dumps(METADATA))
    (tmp_path / "films").mkdir()
    (tmp_path / "films" / "mine-Agent-b.png").write_bytes(PNG)
    return tmp_path


def markup_of(folder):
    write_report(folder)
    return (folder / "report.html").read_text(encoding="utf-8")


def test_a_page_is_well_formed_and_says_how_it_was_made(folder):
    read = Page(markup_of(folder))
    assert len(read.pictures) == 3 and read.pictures[-1] == PNG
    for expected in ("<hall>, 11 episodes", "Agent<b>", "--x '<&>'", '"sensor.range": 4.0', "of the test split",
                     '"slam_gym": "0.1.0"', "ticks astray", "Against each other", '"sha256": "abc"'):  # fmt: skip
        assert expected in read.text
    assert "unfinished" not in read.text


def test_signed_differences_lead_and_the_best_of_a_column_is_bold(folder):
    markup = markup_of(folder)
    bold = re.findall(r'<td class="best">(.*?)</td>', markup)
    assert bold[:2] == [f"{sign}0.400<small>[{sign}0.400, {sign}0.400]&nbsp;</small>" for sign in "+−"]
    assert re.fullmatch(r"0\.250<small>\[0\.2\d\d, 0\.2\d\d\]&nbsp;</small>", bold[2]) and len(bold) == 3


def test_an_unfinished_evaluation_says_so(folder):
    (folder / "results.json").write_text(json.dumps(METADATA | {"complete": False}))
    assert "unfinished" in Page(markup_of(folder)).text


@pytest.mark.parametrize(
    ("column", "value"),
    [("map_error", None), ("map_error", "much"), ("curve", "[3]"), ("coverage", "{")],
)
def test_numbers_that_are_none_end_in_one_line(folder, column, value):
    frame = pd.read_csv(folder / "results.csv").astype({column: object})
    frame.loc[0, column] = value
    frame = frame.drop(columns=column) if value is None else frame
    frame.to_csv(folder / "results.csv", index=False)
    told = typed(report.app, folder)
    assert told.exit_code == 2 and told.stderr.count("\n") == 1
    assert f"results.csv or results.json of {folder}" in told.stderr
