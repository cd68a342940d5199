"""Logs: what is done to one before it is mapped, who is run over which, and means over several."""

import math

import numpy as np
import pandas as pd
import pytest

from agents.evaluation.recordings import logs_of, map_and_measure
from agents.options import Recorded
from agents.reports.recordings import COLUMNS, FURTHER_COLUMNS, means, tables
from slam_gym.geometry import compose, compose_jacobians
from slam_gym.recordings import Recording, open_recordings
from tests.agents.evaluation import posts_log


@pytest.fixture(scope="module")
def log() -> Recording:
    return posts_log()


@pytest.mark.parametrize("count", [1, 2, 7, 500])
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


def test_of_several_logs_there_is_a_mean_and_columns_without_numbers_are_left_out() -> None:
    numbers = [column.key for column in (*COLUMNS, *FURTHER_COLUMNS)]
    frame = pd.DataFrame([
        {"setting": setting, "name": name, **dict.fromkeys(numbers, value), "anees": math.nan}
        for setting, value in (("a", 1.0), ("b", 3.0)) for name in ("singles", "jcbb")
    ])  # fmt: skip
    assert list(means(frame)["ate"]) == [2.0, 2.0] and list(means(frame)["name"]) == ["singles", "jcbb"]
    assert list(means(frame[1:])["name"]) == ["jcbb"]  # the only one that was run over both
    assert [c.key for c in tables(frame[:2], "")[0].columns] == [c.key for c in COLUMNS if c.key != "anees"]


def test_names_of_public_logs_stand_for_their_files(data_dir, tmp_path) -> None:
    found = open_recordings("mrclam", data_dir / "mrclam", [2, 4])
    assert [log.name for log in found] == ["mrclam/MRCLAM_Dataset6/robot2", "mrclam/MRCLAM_Dataset6/robot4"]
    (log,) = logs_of(Recorded(data_dir / "mrclam", [4], every=10), "mrclam")
    assert log.name == found[1].name
    (record,) = map_and_measure(log, "jcbb", "jcbb", None, tmp_path)
    assert record["steps"] == math.ceil(len(found[1]) / 10)
