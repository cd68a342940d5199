"""The command that evaluates associators: in the loop, over the suite, on a log; bad input in one line."""

import json

import numpy as np
import pandas as pd
import pytest

from agents.evaluate_association import app
from slam_gym.recordings import save
from slam_gym.world.floor_plan_file import save_floor_plan
from slam_gym.world.generators import OfficeGenerator
from tests.agents import typed
from tests.agents.ranking.test_board import MINE
from tests.agents.reports import Page
from tests.recordings import drive


def test_the_command_in_the_loop(tmp_path):
    out = tmp_path / "out"
    line = ["--associators", MINE, "true_association", "--scenario", "office-small", "clutter/1", "--episodes", "2"]
    result = typed(app, *line, "--set", "budget=60", "--jobs", 1, "--output", out)
    assert result.exit_code == 0, result.output
    page, frame = Page((out / "report.html").read_text(encoding="utf-8")), pd.read_csv(out / "results.csv")
    assert len(page.pictures) == 2 * (1 + 4)  # of each scenario the dots, and the maps of four contenders
    for expected in ("mine", "true association", "Against each other", '"gcbb"'):
        assert expected in page.text
    assert set(frame["setting"]) == {"office-small", "clutter/1"} and len(frame) == 16
    assert all(said in result.output for said in ("mine", "clutter/1, 2 episodes", "Aligned map error above"))


def test_the_command_of_the_suite(tmp_path):
    out = tmp_path / "out"
    line = ["--suite", "--quick", "--experiments", "closure", "kidnapped", "--worlds", "1", "--problems", "4"]
    line += ["--associators", "nearest_neighbour", "marginal", "true_association", "--relocation", "gcbb"]
    result = typed(app, *line, "--jobs", 1, "--output", out)
    assert result.exit_code == 0, result.output
    page, frame = Page((out / "report.html").read_text(encoding="utf-8")), pd.read_csv(out / "results.csv")
    assert len(page.pictures) == 3
    for expected in ("Capabilities", "Ahead of the next", "Kidnapped"):
        assert expected in page.text
    assert frame["score"].between(0.0, 1.0).all()
    assert (frame.loc[frame["name"] == "true_association", "score"] == 1.0).all()
    assert "Kidnapped: searches without a prior" in result.output


def test_the_command_on_a_log(tmp_path):
    save(drive(steps=120, name="drive"), tmp_path / "drive.npz")
    line = ["--recording", tmp_path / "drive.npz", "--associators", "jcbb", "true_association", "--jobs", "1"]
    result = typed(app, *line, "--output", tmp_path / "out")
    assert result.exit_code == 0, result.output
    page = Page((tmp_path / "out" / "report.html").read_text(encoding="utf-8"))
    assert len(page.pictures) == 2 and "120 scans" in page.text and "drive, 120 scans" in result.output
    frame = pd.read_csv(tmp_path / "out" / "results.csv").set_index("name")
    assert frame.loc["true_association", "precision"] == 1.0 and f"{frame.loc['jcbb', 'ate']:.2f}" in result.output
    refused = typed(app, *line, "--output", tmp_path / "out")
    assert refused.exit_code == 2 and "holds an evaluation already" in refused.stderr
    other = typed(app, *line, "--output", tmp_path / "out", "--resume", "--every", 2)
    assert other.exit_code == 2 and "another command (every 1, not 2)" in other.stderr


def test_associators_are_compared_on_a_floor_plan(tmp_path):
    plan = tmp_path / "two.json"
    save_floor_plan(OfficeGenerator(rooms=2)(np.random.default_rng(1)), plan)
    line = ["--floor-plan", plan, "--associators", "jcbb", "--relocation", "none", "--episodes", "1"]
    result = typed(app, *line, "--set", "budget=30", "--jobs", 1, "--output", tmp_path / "out")
    metadata = json.loads((tmp_path / "out" / "results.json").read_text())
    assert metadata["conditions"]["floor_plan"] == str(plan) and set(
        pd.read_csv(tmp_path / "out" / "results.csv")["setting"]
    ) == {"two.json"}
    assert "two.json, 1 episode, driven" in result.output


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (["--associators", "nn"], ("nn", "jcbb", "nearest_neighbour")),
        (["--associators", "nowhere.zip"], ("nowhere.zip",)),
        (["--scenario", "offic"], ("unknown scenario 'offic'", "office-small")),
        (["--scenario", "closure/9"], ("closure/9", "closure/0 … closure/4")),
        (["--driver", "nobody"], ("nobody", "nearest_frontier")),
        (["--relocation", "gps"], ("gps", "gcbb")),
        (["--suite", "--worlds", "0"], ("--worlds", "equal to 1")),
        (["--suite", "--experiments", "fog"], ("fog", "closure")),
        (["--suite", "--relocation", "gps"], ("gps", "gcbb")),
        (["--suite", "--set", "budget=9"], ("--set", "--suite")),
        (["--suite", "--floor-plan", "a.json"], ("--floor-plan is about drives",)),
        (["--resolution", "0.1"], ("resolution=0.1 goes with a floor_plan",)),
        (["--suite", "--recording", "mrclam"], ("give one of them",)),
        (["--experiments", "closure"], ("--experiments belongs to --suite, which was not asked for",)),
        (["--suite", "--experiments", "closure", "--relocation", "gcbb"], ("--relocation is about the experiment",)),
        (["--recording", "mrclam", "--worlds", "2"], ("--worlds belongs to --suite, not to --recording",)),
        (["--recording", "victoria_park"], ("not part of this package", "SLAM_GYM_DATA", "Cite: Guivant")),
        (["--recording", "park"], ("unknown recording 'park'; known: victoria_park, mrclam, dlr, FILE",)),
        (["--recording", "park.npz"], ("park.npz: not there",)),
        (["--recording", "victoria_park", "--split", "train"], ("--split: a recording has no worlds",)),
        (["--film", "--associators", "jcbb"], ("two to four associators",)),
        (["--recording", "victoria_park", "--robots", "1"], ("--robots is for mrclam",)),
    ],
)
def test_bad_input_is_told_with_its_name_and_leaves_nothing(tmp_path, monkeypatch, line, said):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("SLAM_GYM_DATA", raising=False)
    result = typed(app, *line, "--output", "out")
    assert result.exit_code == 2 and all(word in result.stderr for word in said), result.output
    assert not (tmp_path / "out").exists()
