"""Evaluation end to end on the smallest scenario: the same table whether or not it was interrupted; sound files."""

import csv
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from agents import evaluate as command
from agents.drivers.base import make_agent
from agents.evaluate import default_out, drivers_of, evaluate, main
from agents.evaluation.parallel import Driver
from agents.evaluation.results import Journal, in_order, table, write_json
from agents.evaluation.rollout import Setting, run_episode
from agents.reports import film as filming
from slam_gym.metrics.statistics import interquartile_mean

ROOT = Path(__file__).parents[2]
SMALL = Setting("office-small")
DRIVERS = [Driver("random"), Driver("nearest_frontier")]
QUIET = Console(quiet=True)


def run(out, episodes=3, drivers=DRIVERS, **options):
    return evaluate(drivers, SMALL, episodes, out, jobs=1, films=False, console=QUIET, **options)


def timeless(records):
    """Records without what depends on how busy the machine is, NaN made comparable."""
    drop = {"seconds", "ticks_per_second"}
    return json.dumps([{key: value for key, value in record.items() if key not in drop} for record in records])


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    out = tmp_path_factory.mktemp("evaluation") / "whole"
    return out, run(out, command="python -m agents.evaluate")


def test_every_agent_drives_the_same_episodes(finished):
    _, records = finished
    assert [(r["agent"], r["episode"]) for r in records] == [(d.agent, k) for d in DRIVERS for k in range(3)]
    assert {r["ticks"] for r in records} == {300}
    starts = {(r["episode"], r["curve"]["coverage"][0]) for r in records}
    assert len(starts) == 3  # coverage before the first step is a fingerprint of world and start


def test_episode_records_agree_with_themselves(finished):
    _, records = finished
    for record in records:
        curve = record["curve"]
        assert len(curve["ticks"]) == len(curve["map_error"]) == len(curve["coverage"])
        assert np.all(np.diff(curve["ticks"]) > 0) and curve["ticks"][-1] == record["ticks"]
        assert record["map_error"] == pytest.approx(curve["map_error"][-1], abs=1e-5)
        assert record["return"] == pytest.approx(curve["map_error"][0] - curve["map_error"][-1], abs=1e-5)


def test_interrupted_and_resumed_is_the_same_as_uninterrupted(finished, tmp_path, monkeypatch):
    out, run_all = tmp_path / "cut", command.run_all

    def interrupted(*arguments):
        for done, record in enumerate(run_all(*arguments)):
            yield record
            if done == 1:
                raise KeyboardInterrupt

    monkeypatch.setattr(command, "run_all", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run(out)
    kept = json.loads((out / "results.json").read_text())
    assert not kept["complete"] and len(Journal(out / "episodes.jsonl").read()) == 2
    with (out / "episodes.jsonl").open("a") as file:
        file.write('{"agent": "random", "epis')  # as a crash would leave it
    monkeypatch.undo()
    records = run(out, resume=True)
    assert timeless(records) == timeless(finished[1])
    ours, theirs = (json.loads((folder / "results.json").read_text()) for folder in (out, finished[0]))
    assert ours["complete"] and len(ours["commands"]) == 2
    for agent in theirs["table"]:
        assert ours["table"][agent]["map_error"] == theirs["table"][agent]["map_error"]


CUT = """
import os, signal, sys
from agents import evaluate
from agents.cli import run_main

append = evaluate.Journal.append
def cut(journal, record):
    append(journal, record)
    if len(journal.read()) == 3:
        os.killpg(0, signal.SIGINT)  # as Ctrl-C does: the workers get it too
evaluate.Journal.append = cut
sys.exit(run_main(evaluate.main))
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="sends SIGINT")
def test_ctrl_c_keeps_what_is_finished_and_says_how_to_go_on(finished, tmp_path):
    out = tmp_path / "cut"
    line = ["--scenario", "office-small", "--agents", "random", "nearest_frontier", "--episodes", "3", "--no-films"]
    line += ["--out", str(out)]
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
    ours = in_order(Journal(out / "episodes.jsonl").read(), ["random", "nearest_frontier"])
    assert timeless(ours) == timeless(finished[1])


def test_two_processes_find_the_same_as_one(finished, tmp_path):
    records = evaluate(DRIVERS, SMALL, 3, tmp_path / "two", jobs=2, films=False, console=QUIET)
    assert timeless(records) == timeless(finished[1])


def test_csv_and_json_say_what_was_run(finished):
    out, records = finished
    with (out / "episodes.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["map_error"]) for row in rows] == [record["map_error"] for record in records]
    results = json.loads((out / "results.json").read_text(), parse_constant=lambda name: pytest.fail(name))
    assert results["complete"] and results["setting"]["scenario"] == "office-small"
    assert results["commands"][0]["command"] == "python -m agents.evaluate"
    assert results["seeds"][2] == {"seed": 2, "options": {"world": 2}}
    assert {"slam_gym", "numpy", "python", "commit"} <= set(results["versions"])
    values = np.array([record["map_error"] for record in records if record["agent"] == "random"])
    assert results["table"]["random"]["map_error"]["estimate"] == interquartile_mean(values)


def test_models_of_one_agent_are_pooled_and_resampled_each_on_its_own():
    records = [
        {"agent": "ppo", "model": model, "episode": k, "map_error": value, **dict.fromkeys(
            ("coverage", "precision", "recall", "anees", "ticks", "ticks_per_second"), np.nan)}
        for model, value in (("a.pt", 0.2), ("b.pt", 0.4)) for k in range(10)
    ]  # fmt: skip
    row = table(records, ["ppo"])["ppo"]
    # Each model always gives the same value, so resampling within models leaves nothing to vary.
    assert (row["map_error"].estimate, row["map_error"].low, row["map_error"].high) == pytest.approx((0.3, 0.3, 0.3))
    assert np.isnan(row["coverage"].estimate)


def test_a_second_evaluation_does_not_overwrite_the_first(finished):
    out, _ = finished
    before = (out / "episodes.jsonl").read_bytes()
    with pytest.raises(ValueError, match="--resume"):
        run(out)
    with pytest.raises(ValueError, match="nearest_neighbour"):
        evaluate(DRIVERS, Setting("office-small", "nearest_neighbour"), 3, out, jobs=1, resume=True, console=QUIET)
    assert (out / "episodes.jsonl").read_bytes() == before


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


def test_a_model_alone_adds_the_learned_agent():
    assert [d.agent for d in drivers_of(["random"], ["a.pt", "b.pt"], False)] == ["random", "ppo", "ppo"]


def test_resume_without_folder_means_the_latest_of_this_world(tmp_path, monkeypatch):
    monkeypatch.setattr(command, "CHECKOUT", tmp_path)
    for name in ("office-20250101-000000", "office-20250301-000000", "office-small-20250401-000000"):
        (tmp_path / "results" / name).mkdir(parents=True)
    assert default_out("office", resume=True).name == "office-20250301-000000"
    assert default_out("/data/floor.npy.gz", resume=False).name.startswith("floor-2")
    with pytest.raises(ValueError, match="hall"):
        default_out("hall", resume=True)


def test_json_without_nan(tmp_path):
    write_json(tmp_path / "x.json", {"a": [float("nan"), 1.0, {"b": float("inf")}]})
    assert json.loads((tmp_path / "x.json").read_text()) == {"a": [None, 1.0, {"b": None}]}


def test_a_film_shows_the_episode_that_was_evaluated(tmp_path, monkeypatch):
    monkeypatch.setattr(filming, "FRAMES", 30)
    imageio = pytest.importorskip("imageio.v2")
    pytest.importorskip("pygame")
    picture = filming.film(SMALL, make_agent("random"), 0, tmp_path / "random.mp4")
    frames = [frame for frame in imageio.get_reader(tmp_path / "random.mp4")]
    assert 30 <= len(frames) - filming.RATE <= 31
    shown = imageio.imread(picture)
    assert shown.shape == frames[-1].shape
    assert np.abs(shown.astype(int) - frames[-1].astype(int)).mean() < 6.0
    assert np.abs(frames[0].astype(int) - frames[-1].astype(int)).mean() > 1.0


def test_watching_an_episode_does_not_change_it():
    seen = []
    env = SMALL.make("goal")
    watched = run_episode(env, make_agent("random"), 1, watch=lambda e: seen.append(e.unwrapped.episode.ticks))
    assert seen == list(range(1, 301))
    assert timeless([watched]) == timeless([run_episode(SMALL.make("goal"), make_agent("random"), 1)])
