"""Associators on recordings: what is done to a log, its table and their mean, over the command as it would be typed."""

import csv
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from agents.evaluate_association import main
from agents.evaluation.recordings import COLUMNS, FURTHER_COLUMNS, Log, LogTask, columns_with_numbers, logs_of, numbers
from slam_gym.geometry import compose, compose_jacobians, relative
from slam_gym.recordings import Recording, open_recordings, save
from slam_gym.scenarios.registry import GENERIC, MRCLAM, VICTORIA_PARK, slam_for
from slam_gym.types import SPURIOUS
from tests.agents.evaluation import posts_log


@pytest.fixture(scope="module")
def log() -> Recording:
    return posts_log()


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory, log):
    """The command on the log of posts, as somebody would type it."""
    folder = tmp_path_factory.mktemp("recording")
    save(log, folder / "drive.npz")
    command = ["--recording", str(folder / "drive.npz"), "--associators", "nearest_neighbour", "jcbb",
               "true_association", "--jobs", "1", "--out", str(folder / "out")]  # fmt: skip
    assert main(command) == 0
    return folder / "out", command


@pytest.mark.parametrize("count", [1, 2, 3, 7, 500])
def test_every_kth_step_compounds_the_odometry_of_the_others(log, count) -> None:
    thin = log.every(count)
    kept = list(range(0, len(log), count))
    assert len(thin) == len(kept)
    before = -1
    for row, step in enumerate(kept):
        motion, covariance = log.motions[before + 1], log.motion_covariances[before + 1]
        for k in range(before + 2, step + 1):
            a, b = compose_jacobians(motion, log.motions[k])
            covariance = a @ covariance @ a.T + b @ log.motion_covariances[k] @ b.T
            motion = compose(motion, log.motions[k])
        np.testing.assert_allclose(thin.motions[row], motion, atol=1e-12)
        np.testing.assert_allclose(thin.motion_covariances[row], covariance, atol=1e-15)
        np.testing.assert_array_equal(thin.scan(row).points, log.scan(step).points)
        np.testing.assert_array_equal(thin.sources_of(row), log.sources_of(step))
        before = step
    with pytest.raises(ValueError, match="every 0th step"):
        log.every(0)


def test_every_kth_step_ends_where_the_whole_log_does(log) -> None:
    whole, thin = (np.zeros(3) for _ in range(2))
    for motion in log.motions[: len(log.every(7)) * 7 - 6]:
        whole = compose(whole, motion)
    for motion in log.every(7).motions:
        thin = compose(thin, motion)
    np.testing.assert_allclose(relative(whole, thin), 0.0, atol=1e-9)


def test_what_is_spurious_can_be_left_out_and_neighbours_be_one(log) -> None:
    clean = log.without_spurious()
    assert (clean.sources != SPURIOUS).all() and len(clean.points) == (log.sources != SPURIOUS).sum()
    for k in (0, 50, len(log) - 1):
        np.testing.assert_array_equal(clean.scan(k).points, log.scan(k).points[log.sources_of(k) != SPURIOUS])
    np.testing.assert_array_equal(log.merged(0.0).sources, log.sources)
    one = log.merged(100.0)
    assert one.landmark_ids.tolist() == [0] and set(one.sources.tolist()) == {0, SPURIOUS}
    np.testing.assert_allclose(one.landmarks[0], log.landmarks.mean(axis=0))
    grown = one.covariances[0] - log.covariances[0]
    np.testing.assert_allclose(grown, 0.5 * np.trace(np.cov(log.landmarks.T, bias=True)) * np.eye(2), atol=1e-12)
    with pytest.raises(ValueError, match="no landmark has a place"):
        replace(log, landmark_ids=np.empty(0, np.int64), landmarks=np.empty((0, 2))).merged(1.0)


def test_logs_have_the_settings_of_their_kind(log) -> None:
    assert slam_for(replace(log, name="mrclam/MRCLAM_Dataset6/robot1")) is MRCLAM
    assert slam_for(replace(log, name="victoria_park")) is VICTORIA_PARK
    assert slam_for(log).map == GENERIC.map


def test_table_json_and_csv_say_the_same(evaluated) -> None:
    out, _ = evaluated
    results = json.loads((out / "results.json").read_text(encoding="utf-8"))
    rows = list(csv.DictReader((out / "records.csv").open(encoding="utf-8")))
    assert results["complete"] and [row["associator"] for row in rows] == list(results["table"]["drive"])
    for row in rows:
        for column in COLUMNS:
            told = results["table"]["drive"][row["associator"]][column.key]
            assert (told is None) == (row[column.key] == "nan")
            assert told is None or told == float(row[column.key])
    assert results["table"]["drive"]["true_association"]["precision"] == 1.0


def test_the_terminal_has_room_for_the_table(log, evaluated, capsys, monkeypatch) -> None:
    _, command = evaluated
    monkeypatch.setenv("COLUMNS", "80")
    assert main([*command, "--resume"]) == 0  # everything is in the journal already
    printed = capsys.readouterr().out
    assert "0/0" in printed
    table = printed[printed.index("drive, 120 scans") :]
    assert all(name in table for name in ("nearest", "jcbb", "true association", "ATE₀", "ANEES"))
    assert all(len(line) <= 80 for line in table.splitlines() if "report:" not in line)


def test_interrupted_evaluations_go_on(tmp_path, log, evaluated) -> None:
    whole, command = evaluated
    out = tmp_path / "out"
    argv = [*command[:-1], str(out)]
    assert main(argv) == 0
    lines = (out / "records.jsonl").read_text(encoding="utf-8").splitlines()
    (out / "records.jsonl").write_text(lines[0] + "\n", encoding="utf-8")
    with pytest.raises(ValueError, match="holds an evaluation already"):
        main(argv)
    with pytest.raises(ValueError, match="was evaluated with every 1, not 2"):
        main([*argv, "--resume", "--every", "2"])
    assert main([*argv, "--resume"]) == 0
    tables = [json.loads((folder / "results.json").read_text())["table"]["drive"] for folder in (whole, out)]
    for name, row in tables[0].items():
        for key in ("precision", "ate", "features", "anees"):
            assert tables[1][name][key] == row[key]


def test_of_several_logs_there_is_a_mean() -> None:
    records = [
        {"setting": setting, "associator": name, **{c.key: value for c in (*COLUMNS, *FURTHER_COLUMNS)}}
        for setting, value in (("a", 1.0), ("b", 3.0))
        for name in ("jcbb", "singles")
    ]
    found = numbers(records)
    assert list(found) == ["a", "b", "mean"] and found["mean"]["jcbb"]["ate"] == 2.0
    assert list(numbers(records[:3])["mean"]) == ["jcbb"]
    assert [c.key for c in columns_with_numbers({"x": {c.key: math.nan for c in COLUMNS} | {"ate": 1.0}})] == ["ate"]


@pytest.mark.parametrize(
    ("argv", "error", "message"),
    [
        (["--recording", "victoria_park"], FileNotFoundError, "not part of this package.*SLAM_GYM_DATA.*Cite: Guivant"),
        (["--recording", "mrclam"], FileNotFoundError, "not part of this package.*Cite: Leung"),
        (["--recording", "victoria_park", "--data", "nowhere"], FileNotFoundError, "nowhere is no folder.*Cite"),
        (["--recording", "park"], ValueError, "unknown recording 'park'; known: victoria_park, mrclam, FILE.npz"),
        (["--recording", "park.npz"], FileNotFoundError, "park.npz: not there"),
        (["--recording", "mrclam", "--every", "0"], ValueError, "--every must be at least 1"),
        (["--recording", "victoria_park", "--robots", "1"], ValueError, "--robots is for mrclam"),
        (["--recording", "victoria_park", "--suite"], ValueError, "give one of them"),
    ],
)  # fmt: skip
def test_what_cannot_be_evaluated_is_said(argv, error, message, monkeypatch) -> None:
    monkeypatch.delenv("SLAM_GYM_DATA", raising=False)
    with pytest.raises(error, match=message):
        main(argv)


def test_names_of_public_logs_stand_for_their_files(data_dir) -> None:
    found = open_recordings("mrclam", data_dir / "mrclam", [2, 4])
    assert [log.name for log in found] == ["mrclam/MRCLAM_Dataset6/robot2", "mrclam/MRCLAM_Dataset6/robot4"]
    again = open_recordings("mrclam", data_dir / "mrclam" / "MRCLAM_Dataset6", [4])[0]
    np.testing.assert_array_equal(again.points, found[1].points)
    logs = logs_of(Log("mrclam", str(data_dir / "mrclam"), every=10), [4])
    assert list(logs) == [found[1].name]
    task = LogTask("jcbb", logs[found[1].name], found[1].name, None, "jcbb")
    record = task.run(task.keys)[0]
    assert record["steps"] == math.ceil(len(again) / 10) and record["setting"] == found[1].name
