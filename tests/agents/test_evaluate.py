"""The command that evaluates drivers: a table, files and a report; bad input in one line; Ctrl-C and --resume."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from agents import report
from agents.evaluate import app
from slam_gym.metrics.statistics import interquartile_mean
from tests.agents import typed
from tests.agents.reports import Page

ROOT = Path(__file__).parents[2]
LINE = ["--scenario", "office-small", "--agents", "random", "nearest_frontier", "--episodes", "3", "--no-films"]


def test_the_command_leaves_a_table_files_and_a_report(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = typed(app, *LINE, "--seed", 7, "--jobs", 1, "--set", "budget=60", "--set", "sensor.range=4")
    assert result.exit_code == 0, result.output
    (out,) = (tmp_path / "results").glob("office-small-*")
    metadata = json.loads((out / "results.json").read_text())
    assert metadata["conditions"]["overrides"] == {"budget": 60, "sensor.range": 4}
    frame = pd.read_csv(out / "results.csv")
    assert set(frame["ticks"]) == {60} and set(frame["episode"]) == {7, 8, 9}
    page = Page((out / "report.html").read_text(encoding="utf-8"))
    told = f"{interquartile_mean(frame.loc[frame['name'] == 'random', 'map_error']):.3f}"
    assert told in page.text and told in result.output
    assert "3 episodes" in page.text and '"sensor.range": 4' in page.text
    other = typed(app, *LINE, "--jobs", 1, "--resume")
    assert other.exit_code == 2 and "the results of another command (overrides {" in other.stderr
    (out / "report.html").unlink()
    assert typed(report.app, out).exit_code == 0 and (out / "report.html").exists()
    assert typed(report.app, tmp_path).stderr.startswith(f"error: {tmp_path} holds no results.json")


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="sends SIGINT")
def test_ctrl_c_keeps_what_is_finished_and_says_how_to_go_on(tmp_path):
    cut = """
import os, signal
from agents import evaluate
from agents.evaluation import pipeline

signal.signal(signal.SIGINT, signal.default_int_handler)  # whoever runs the tests may ignore it
write = pipeline._write_rows
def write_then_interrupt(out, records):
    write(out, records)
    if len(records) == 3:
        os.killpg(0, signal.SIGINT)  # as Ctrl-C does: the workers get it too
pipeline._write_rows = write_then_interrupt
evaluate.app()
"""
    out = tmp_path / "cut"
    line = [*LINE, "--set", "budget=40", "--output", str(out)]
    done = subprocess.run(
        [sys.executable, "-c", cut, *line, "--jobs", "2"],
        cwd=ROOT, capture_output=True, text=True, start_new_session=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 130 and "--resume" in done.stdout and "Traceback" not in done.stderr, done.stderr
    first = pd.read_csv(out / "results.csv")
    assert 3 <= len(first) < 6
    resumed = typed(app, *line, "--jobs", 1, "--resume")
    assert resumed.exit_code == 0 and "map error" in resumed.output
    before, after = (frame.set_index(["name", "episode"]) for frame in (first, pd.read_csv(out / "results.csv")))
    pd.testing.assert_frame_equal(after.loc[before.index], before)
    assert len(after) == 6 and after.index.is_unique


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (["--agents", "greedy"], ("greedy", "nearest_frontier")),
        (["--scenario", "offic"], ("offic", "office-small", "hall")),
        (["--associator", "nn"], ("nn", "jcbb", "nearest_neighbour")),
        (["--agents", "ppo"], ("ppo", "--model")),
        (["--model", "nowhere.zip"], ("nowhere.zip",)),
        (["--floor-plan", "nowhere.json"], ("nowhere.json",)),
        (["--episodes", "0"], ("--episodes", "equal to 1")),
        (["--set", "sensor.range"], ("sensor.range", "NAME=VALUE")),
        (["--resume", "--output", "nowhere"], ("nowhere", "resume")),
    ],
)
def test_bad_input_is_told_with_its_name_and_leaves_nothing(tmp_path, monkeypatch, line, said):
    monkeypatch.chdir(tmp_path)
    result = typed(app, *line, "--no-films", *([] if "--output" in line else ["--output", "out"]))
    assert result.exit_code == 2 and all(word in result.stderr for word in said)
    assert not (tmp_path / "out").exists()
