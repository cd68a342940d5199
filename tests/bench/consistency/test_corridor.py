"""The reference corridor as a command; what each associator comes to in it is held by the tests of the step."""

import csv

import numpy as np
import pytest

from slam_gym.bench.consistency.corridor import EXPECTED, run_corridor, summary
from slam_gym.bench.runner import main


def test_a_run_judges_every_step_in_the_frame_of_its_start():
    run = run_corridor("true_association", 0)
    assert run.poses.shape == run.estimates.shape == (45, 3) and run.nees.shape == (45,)
    assert run.nees[0] == 0.0 and (run.nees[1:] > 0.0).all()
    np.testing.assert_array_equal(run.pose_errors[0], np.zeros(3))
    assert np.abs(run.pose_errors[:, 2]).max() < np.pi and np.hypot(*run.pose_errors[:, :2].T).max() < 2.0
    assert run.tally.fp == 0 and run.slam.map.n == 88


def test_the_covariance_told_and_the_confidence_reach_the_filter():
    runs = [run_corridor("jcbb", 1), run_corridor("jcbb", 1, q=2.0), run_corridor("jcbb", 1, confidence=0.95)]
    assert runs[1].nees[5] < runs[0].nees[5]
    assert not np.array_equal(runs[2].estimates, runs[0].estimates)


def test_a_row_is_the_mean_of_its_runs():
    row, runs = summary("jcbb", range(2), 1.0, 0.99), [run_corridor("jcbb", seed) for seed in range(2)]
    assert row["TP"] == np.mean([run.tally.tp for run in runs])
    assert row["features"] == np.mean([run.slam.map.n for run in runs])
    assert row["ANEES"] == pytest.approx(np.mean([run.nees[1:].mean() / 3.0 for run in runs]))


def test_the_command_has_a_row_for_each_setting_and_associator(tmp_path, capsys):
    main(["corridor", "--seeds", "1", "--out", str(tmp_path)])
    shown = capsys.readouterr().out
    assert all(words in shown for words in EXPECTED.values())
    with (tmp_path / "corridor.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["associator"] for row in rows] == 3 * list(EXPECTED)
