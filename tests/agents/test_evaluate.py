"""The command that evaluates drivers: a table, files and a report; bad input in one line; Ctrl-C and --resume."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from agents.evaluate import main
from agents.evaluation.records import Journal
from tests.agents.reports import Page

ROOT = Path(__file__).parents[2]
LINE = ["--scenario", "office-small", "--agents", "random", "nearest_frontier", "--episodes", "3", "--no-films"]


def test_the_command_leaves_a_table_files_and_a_report(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main([*LINE, "--first", "7", "--jobs", "1", "--set", "budget=60", "--set", "sensor.range=4"]) == 0
    (out,) = (tmp_path / "results").glob("office-small-*")
    results = json.loads((out / "results.json").read_text())
    assert results["conditions"]["overrides"] == {"budget": 60, "sensor.range": 4}
    records = Journal(out / "episodes.jsonl").read()
    assert {record["ticks"] for record in records} == {60} and {record["episode"] for record in records} == {7, 8, 9}
    page = Page((out / "report.html").read_text(encoding="utf-8"))
    told = results["table"]["random"]["map_error"]["estimate"]
    assert f"{told:.3f}" in page.text and f"{told:.2f}" in capsys.readouterr().out
    assert "3 episodes" in page.text and "k = 7 … 9" in page.text
    assert "overrides.sensor.range 4" in page.text and "--set budget=60" in page.text
    with pytest.raises(ValueError, match=r"overrides .*sensor\.range.* not \{\}"):
        main([*LINE, "--jobs", "1", "--resume"])


CUT = """
import os, signal, sys
from agents import evaluate
from agents.evaluation import pipeline
from agents.cli import run_main

signal.signal(signal.SIGINT, signal.default_int_handler)  # whoever runs the tests may ignore it
append = pipeline.Journal.append
def cut(journal, record):
    append(journal, record)
    if len(journal.read()) == 3:
        os.killpg(0, signal.SIGINT)  # as Ctrl-C does: the workers get it too
pipeline.Journal.append = cut
sys.exit(run_main(evaluate.main))
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="sends SIGINT")
def test_ctrl_c_keeps_what_is_finished_and_says_how_to_go_on(tmp_path):
    out = tmp_path / "cut"
    line = [*LINE, "--out", str(out)]
    cut = subprocess.run(
        [sys.executable, "-c", CUT, *line, "--jobs", "2"],
        cwd=ROOT, capture_output=True, text=True, start_new_session=True, timeout=120,
    )  # fmt: skip
    assert cut.returncode == 130, cut.stderr
    assert "--resume" in cut.stdout and "Traceback" not in cut.stderr
    assert 3 <= len(Journal(out / "episodes.jsonl").read()) < 6
    resumed = subprocess.run(
        [sys.executable, "-m", "agents.evaluate", *line, "--jobs", "1", "--resume"],
        cwd=ROOT, capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    assert "map error" in resumed.stdout
    done = {(record["agent"], record["episode"]) for record in Journal(out / "episodes.jsonl").read()}
    assert done == {(agent, k) for agent in ("random", "nearest_frontier") for k in range(3)}


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (["--agents", "greedy"], r"greedy.*nearest_frontier"),
        (["--scenario", "offic"], r"offic.*office-small.*hall"),
        (["--associator", "nn"], r"nn.*jcbb.*nearest_neighbour"),
        (["--agents", "ppo"], r"ppo.*--model"),
        (["--model", "nowhere.pt"], r"nowhere\.pt.*no such file"),
        (["--floor-plan", "nowhere.json"], r"nowhere\.json"),
        (["--episodes", "0"], r"--episodes.*at least 1"),
        (["--resume", "--out", "nowhere"], r"nowhere.*resume"),
    ],
)
def test_bad_input_is_told_in_one_line_that_names_it(tmp_path, monkeypatch, line, said):
    monkeypatch.chdir(tmp_path)
    with pytest.raises((ValueError, FileNotFoundError)) as caught:
        main([*line, "--no-films"] + ([] if "--out" in line else ["--out", "out"]))
    assert re.search(said, str(caught.value))
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()
