"""MR.CLAM: the stationary groups as relocation cases."""

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from slam_gym.association.relocation.location import locate
from slam_gym.geometry import wrap_angle
from slam_gym.recordings import RecordingError
from slam_gym.recordings.mrclam_groups import stationary


@pytest.fixture(scope="module")
def groups(data_dir):
    return data_dir / "mrclam" / "stationary"


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
