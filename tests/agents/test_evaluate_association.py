"""The command that evaluates associators: in the loop, over the suite; bad input in one line."""

import json
import re

import numpy as np
import pytest

from agents.evaluate_association import main
from slam_gym.association import nearest_neighbour
from slam_gym.world.floor_plan_file import save_floor_plan
from slam_gym.world.generators import OfficeGenerator
from tests.agents.reports import PNG, Page


def mine(scan, prediction):
    """An associator of a user: nearest neighbour."""
    return nearest_neighbour(scan, prediction)


def test_the_command_in_the_loop(tmp_path, capsys):
    own = f"{__name__}:mine"
    line = ["--associators", own, "true_association", "--scenarios", "office-small", "clutter/1", "--episodes", "2"]
    assert main([*line, "--set", "budget=60", "--jobs", "1", "--out", str(tmp_path / "out")]) == 0
    page = Page((tmp_path / "out" / "report.html").read_text(encoding="utf-8"))
    assert len(page.pictures) == 2
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    told = results["table"]["office-small"][own]
    for expected in ("mine", "true association", "Against mine", f"{told['recall']['estimate']:.3f}", "--episodes 2"):
        assert expected in page.text
    assert told["precision"]["estimate"] > 0.5 and list(results["table"]) == ["office-small", "clutter/1", "all"]
    shown = capsys.readouterr().out
    assert "mine" in shown and "clutter/1, 2 episodes" in shown


def test_the_command_of_the_suite(tmp_path, capsys):
    out = tmp_path / "out"
    line = ["--suite", "--quick", "--experiments", "closure", "kidnapped", "--worlds", "1", "--problems", "4"]
    line += ["--associators", "nearest_neighbour", "jcbb", "true_association", "--jobs", "1", "--out", str(out)]
    assert main([*line, "--relocators", "gcbb"]) == 0
    page = Page((out / "report.html").read_text(encoding="utf-8"))
    assert len(page.pictures) >= 4 and (out / "suite.png").read_bytes().startswith(PNG)
    results = json.loads((out / "results.json").read_text())
    numbers, relocation = results["numbers"], results["relocation"]
    for scores in (*numbers.values(), {"kidnapped": relocation["gcbb"]["kidnapped"]}):
        assert all(0.0 <= value["estimate"] <= 1.0 for value in scores.values())
    assert all(value["low"] is None is value["high"] for value in scores.values())  # of one world nobody knows
    assert [value["estimate"] for value in numbers["true_association"].values()] == [1.0] * 2
    assert numbers["jcbb"]["all"]["estimate"] > numbers["nearest_neighbour"]["all"]["estimate"]
    shown = capsys.readouterr().out
    assert f"{numbers['jcbb']['closure']['estimate']:.3f}" in shown and "kidnapped" in shown


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (["--associators", "nn"], r"nn.*jcbb.*nearest_neighbour"),
        (["--associators", "nowhere.pt"], r"nowhere\.pt"),
        (["--scenarios", "offic"], r"unknown scenario 'offic'.*office-small.*closure/…"),
        (["--scenarios", "closure/9"], r"closure/9.*closure/0 … closure/4"),
        (["--driver", "nobody"], r"nobody.*nearest_frontier"),
        (["--driver", "ppo"], r"ppo"),
        (["--relocation", "gps"], r"gps.*gcbb"),
        (["--episodes", "0"], r"--episodes.*at least 1"),
        (["--suite", "--worlds", "0"], r"--worlds.*at least 1"),
        (["--suite", "--experiments", "fog"], r"fog.*closure"),
        (["--suite", "--relocators", "gps"], r"gps.*gcbb"),
        (["--resume", "--out", "nowhere"], r"nowhere.*resume"),
        (["--suite", "--set", "budget=9"], r"--set.*--suite"),
        (["--suite", "--floor-plan", "a.json"], r"--floor-plan is about drives"),
        (["--floor-plan", "nowhere.json"], r"nowhere\.json"),
        (["--resolution", "0.1"], r"resolution=0\.1 goes with a floor_plan"),
        (["--suite", "--recording", "mrclam"], r"give one of them"),
        (["--experiments", "closure"], r"--experiments belongs to --suite, which was not asked for"),
        (["--recording", "mrclam", "--worlds", "2"], r"--worlds belongs to --suite, not to --recording"),
        (["--suite", "--relocation", "gcbb"], r"--relocation .* not to --suite"),
    ],
)
def test_bad_input_is_told_in_one_line_that_names_it(tmp_path, monkeypatch, line, said):
    monkeypatch.chdir(tmp_path)
    with pytest.raises((ValueError, FileNotFoundError)) as caught:
        main(line + ([] if "--out" in line else ["--out", "out"]))
    assert re.search(said, str(caught.value)) and "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_associators_are_compared_on_a_floor_plan(tmp_path, capsys):
    plan = tmp_path / "two.json"
    save_floor_plan(OfficeGenerator(rooms=2)(np.random.default_rng(1)), plan)
    line = ["--floor-plan", str(plan), "--associators", "jcbb", "--relocation", "none", "--episodes", "1"]
    assert main([*line, "--set", "budget=30", "--jobs", "1", "--out", str(tmp_path / "out")]) == 0
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert results["conditions"]["floor_plan"] == str(plan) and list(results["table"]) == ["building"]
    assert "building on two.json, 1 episode, driven" in capsys.readouterr().out
