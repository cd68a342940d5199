"""MR.CLAM: the stationary groups as relocation cases, and the robots of a set as one log."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from agents.evaluation.recording_run import run
from slam_gym.association import gcbb
from slam_gym.association.relocation.location import locate
from slam_gym.geometry import compose, relative, wrap_angle
from slam_gym.metrics.map_quality import landmark_rmse
from slam_gym.recordings.mrclam import ROBOTS, mrclam, mrclam_all, stationary
from slam_gym.recordings.recording import RecordingError
from slam_gym.scenarios.recorded import slam_for
from slam_gym.types import NONE


@pytest.fixture(scope="module")
def groups(data_dir):
    return data_dir / "mrclam" / "stationary"


@pytest.fixture(scope="module")
def folder(data_dir):
    return data_dir / "mrclam" / "MRCLAM_Dataset6"


@pytest.mark.parametrize("number", range(1, 6))
def test_a_group_put_back_into_polar_form_is_what_the_file_says(groups, number) -> None:
    path = groups / f"mrclam{number}.mat"
    cases, rows = stationary(path), loadmat(path)["measurement"]
    assert len(cases) == len(loadmat(path)["groundtruth"]) and len(cases.landmarks) == 15
    by_case = np.split(np.arange(len(rows)), np.cumsum(np.bincount(rows[:, 0].astype(int))[1:])[:-1])
    for k in np.linspace(0, len(cases) - 1, 50).astype(int):
        scan, told = cases.scan(k), rows[by_case[k]]
        assert len(scan) >= 3 and (told[:, 0] == k + 1).all()
        np.testing.assert_allclose(np.hypot(*scan.points.T), told[:, 2], atol=1e-9)
        np.testing.assert_allclose(np.arctan2(*scan.points.T[::-1]), told[:, 3], atol=1e-9)
        np.testing.assert_array_equal(cases.landmark_ids[cases.features_of(k)], told[:, 1])


@pytest.mark.parametrize("number", range(1, 6))
def test_the_true_pairings_put_the_robot_where_the_vicon_has_it(groups, number) -> None:
    """And the stated noise explains the errors: their NEES has about the median of χ²_3, 2.37."""
    cases = stationary(groups / f"mrclam{number}.mat")
    landmarks, away, nees = cases.map(), [], []
    for k in range(0, len(cases), len(cases) // 200):
        found = locate(cases.scan(k), landmarks, cases.features_of(k))
        error = found.pose - cases.poses[k]
        error[2] = wrap_angle(error[2])
        away.append(np.hypot(*error[:2]))
        nees.append(error @ np.linalg.solve(found.covariance, error))
    assert np.median(away) < 0.2 and np.percentile(away, 90) < 0.6
    assert 0.2 < np.median(nees) < 5.0


def test_gcbb_finds_the_robot_among_the_surveyed_landmarks(groups) -> None:
    cases = stationary(groups / "mrclam5.mat")
    large = np.flatnonzero(np.diff(cases.starts) >= 7)[::60]
    near = 0
    for k in large.tolist():
        found = gcbb(cases.scan(k), cases.map())
        near += np.hypot(*(found.pose[:2] - cases.poses[k, :2])) < 0.5
    assert len(large) > 10 and near >= 0.9 * len(large)


def test_damaged_groups_are_named(groups, tmp_path) -> None:
    with pytest.raises(FileNotFoundError, match=r"mrclam9\.mat: not there.*Cite"):
        stationary(groups / "mrclam9.mat")
    whole = {name: loadmat(groups / "mrclam1.mat")[name] for name in ("landmark", "groundtruth", "measurement")}
    path = tmp_path / "mrclam1.mat"
    for name, change, message in (
        ("measurement", lambda t: np.vstack([t, [1.0, 99.0, 2.0, 0.0]]), "is of no landmark"),
        ("measurement", lambda t: np.vstack([[1e6, 1.0, 2.0, 0.0], t]), "row 1 is of no case"),
        ("groundtruth", lambda t: t[::-1], "not numbered"),
        ("groundtruth", lambda t: t[:, :3], "'groundtruth': expected a table of 4 columns"),
        ("landmark", lambda t: t * np.nan, "'landmark': row 1 is not finite"),
    ):
        savemat(path, whole | {name: change(whole[name])})
        with pytest.raises(RecordingError, match=message):
            stationary(path)
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(RecordingError, match=r"mrclam1\.mat"):
        stationary(path)


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


def test_the_log_of_all_robots_holds_each_of_theirs(folder) -> None:
    together, logs = mrclam_all(folder), [mrclam(folder, robot) for robot in ROBOTS]
    assert len(together) == sum(map(len, logs)) and len(together.points) == sum(len(log.points) for log in logs)
    at = 0
    for log in logs:
        for k in (0, 1, len(log) // 2, len(log) - 1):
            np.testing.assert_array_equal(together.scan(at + k).points, log.scan(k).points)
            np.testing.assert_array_equal(together.sources_of(at + k), log.sources_of(k))
        np.testing.assert_array_equal(together.motions[at + 1 : at + len(log)], log.motions[1:])
        np.testing.assert_allclose(np.diff(together.times[at : at + len(log)]), np.diff(log.times), atol=1e-9)
        at += len(log)


def test_what_links_two_robots_is_their_relative_pose(folder) -> None:
    """Each log begun at the Vicon's pose, and the linked one begun at the first: all start where the Vicon says."""
    together = mrclam_all(folder, link=(0.1, 0.2, 0.3))
    x, y, heading = together.reference_poses.T
    joints = [0, *np.flatnonzero(np.diff(together.times) >= 10.0 - 1e-6) + 1]
    joints = [k for k in joints if k == 0 or together.motion_covariances[k][0, 0] == 0.1**2]
    assert len(joints) == 5

    def true(k: int) -> np.ndarray:
        at = [np.interp(together.times[k], together.reference_times, v) for v in (x, y, np.unwrap(heading))]
        return np.array(at)

    for k in joints[1:]:
        np.testing.assert_array_equal(together.motion_covariances[k], np.diag([0.1, 0.2, 0.3]) ** 2)
        off = relative(compose(true(k - 1), together.motions[k]), true(k))
        assert np.abs(off).max() < 1e-3


def test_one_map_of_all_robots_is_right_to_decimetres(folder) -> None:
    """The true association, every scan: the floor for everything else on this log."""
    log = mrclam_all(folder)
    done = run(log, "true_association", slam_for(log))
    seen = dict(zip(done.identities.tolist(), done.positions))
    place = dict(zip(log.landmark_ids.tolist(), log.landmarks))
    common = [identity for identity in seen if identity != NONE]
    assert sorted(common) == sorted(place)
    estimated, surveyed = (np.array([where[i] for i in common]) for where in (seen, place))
    assert landmark_rmse(estimated, surveyed, aligned=True) < 0.5
