"""The report of recordings: a section a log with its tables and, where its files are there, its pictures."""

from pathlib import Path

import pytest
from rich.console import Console

from agents.evaluation.pipeline import Execution, carry_out
from agents.evaluation.recordings import FOLDER, Log, logs_of, recording_evaluation
from agents.reports.recordings import report
from slam_gym.recordings import save
from tests.agents.evaluation import posts_log
from tests.agents.reports import Page


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory):
    folder: Path = tmp_path_factory.mktemp("recording")
    save(posts_log(40), folder / "drive.npz")
    logs = logs_of(Log(str(folder / "drive.npz")))
    evaluation = recording_evaluation(["jcbb", "true_association"], logs, folder)
    return folder, carry_out(evaluation, folder, Execution(console=Console(quiet=True)))


def test_the_report_has_its_tables_and_pictures(evaluated):
    folder, results = evaluated
    page = Page("\n".join(report(results, folder).sections))
    assert len(page.pictures) == 2
    for expected in ("40 scans", "the test", "jcbb", "true association", "landmarks₀"):
        assert expected in page.text


def test_without_the_files_there_are_no_pictures(evaluated, tmp_path):
    folder, results = evaluated
    assert (folder / FOLDER).is_dir()
    assert not Page("\n".join(report(results, tmp_path).sections)).pictures
