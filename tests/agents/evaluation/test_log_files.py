"""The files of mapped logs, read back."""

import json
import math

import pytest
from rich.console import Console

from agents.evaluation.log_files import ERROR_FIELDS, MAP_FIELDS, read_columns
from agents.evaluation.pipeline import Execution, carry_out
from agents.evaluation.recordings import Log, logs_of, recording_evaluation
from agents.evaluation.records import stem
from slam_gym.recordings import save
from tests.agents.evaluation import posts_log


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """The folder of an evaluation of jcbb on the log of posts."""
    folder = tmp_path_factory.mktemp("recording")
    save(posts_log(), folder / "drive.npz")
    logs = logs_of(Log(str(folder / "drive.npz")))
    carry_out(recording_evaluation(["jcbb"], logs, folder), folder, Execution(console=Console(quiet=True)))
    return folder


def test_files_hold_the_run(out) -> None:
    base = out / "runs" / stem("drive", "jcbb")
    features, errors = (read_columns(base.with_name(f"{base.name}.{kind}.csv")) for kind in ("map", "errors"))
    assert tuple(features) == MAP_FIELDS and tuple(errors) == ERROR_FIELDS
    table = json.loads((out / "results.json").read_text(encoding="utf-8"))["table"]["drive"]["jcbb"]
    assert features["confirmed"].sum() == table["features"]
    assert math.sqrt((errors["error"] ** 2).mean()) == pytest.approx(table["ate"], rel=1e-6)


def test_a_log_without_a_reference_has_no_errors_and_nobody_is_warned(tmp_path, recwarn) -> None:
    (tmp_path / "errors.csv").write_text(",".join(ERROR_FIELDS) + "\n", encoding="utf-8")
    assert [len(column) for column in read_columns(tmp_path / "errors.csv").values()] == [0] * len(ERROR_FIELDS)
    assert not recwarn


def test_evo_reads_the_trajectories_and_finds_the_same_error(out) -> None:
    pytest.importorskip("evo")
    from evo.core import metrics, sync
    from evo.tools import file_interface

    table = json.loads((out / "results.json").read_text(encoding="utf-8"))["table"]["drive"]["jcbb"]
    reference, estimate = (
        file_interface.read_tum_trajectory_file(str(out / "runs" / name))
        for name in ("drive.reference.tum", "drive.jcbb.tum")
    )
    reference, estimate = sync.associate_trajectories(reference, estimate, max_diff=1e-3)
    for aligned, key in ((False, "ate_unaligned"), (True, "ate")):
        if aligned:
            estimate.align(reference, correct_scale=False)
        error = metrics.APE(metrics.PoseRelation.translation_part)
        error.process_data((reference, estimate))
        assert error.get_statistic(metrics.StatisticsType.rmse) == pytest.approx(table[key], rel=1e-3)
