"""Scans of known origin: they fit together, and searches find the robot in the surveyed map."""

from dataclasses import replace

import numpy as np
import pytest

from slam_gym.association import gcbb
from slam_gym.recordings import RecordingError
from slam_gym.recordings.mrclam_groups import stationary


@pytest.fixture(scope="module")
def groups(data_dir):
    return data_dir / "mrclam" / "stationary"


def test_gcbb_finds_the_robot_among_the_surveyed_landmarks(groups) -> None:
    cases = stationary(groups / "mrclam5.mat")
    large = np.flatnonzero(np.diff(cases.starts) >= 7)[::60]
    near = 0
    for k in large.tolist():
        found = gcbb(cases.scan(k), cases.map())
        near += np.hypot(*(found.pose[:2] - cases.poses[k, :2])) < 0.5
    assert len(large) > 10 and near >= 0.9 * len(large)


def test_cases_that_do_not_fit_together_are_refused(groups) -> None:
    cases = stationary(groups / "mrclam1.mat")
    for name, value in (
        ("poses", cases.poses[:-1]),
        ("points", cases.points * np.nan),
        ("starts", cases.starts[::-1]),
        ("sources", cases.sources + 100),
        ("landmark_ids", np.ones_like(cases.landmark_ids)),
    ):
        with pytest.raises(RecordingError):
            replace(cases, **{name: value})
