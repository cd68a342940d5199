"""MR.CLAM as it is published: motions, barcodes and stationary groups against the Vicon."""

import gzip
import shutil

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from slam_gym.association.relocation.location import locate
from slam_gym.geometry import observe, relative, wrap_angle
from slam_gym.recordings import Recording, RecordingError
from slam_gym.recordings.mrclam import ROBOTS, mrclam, stationary
from slam_gym.recordings.recording import interpolate
from slam_gym.types import SPURIOUS, Landmarks


@pytest.mark.parametrize("robot", ROBOTS[::2])
def test_motions_and_barcodes_of_a_robot_are_those_of_the_vicon(data_dir, robot) -> None:
    log = mrclam(data_dir / "mrclam" / "MRCLAM_Dataset6", robot)
    true = interpolate(log.reference_times, log.reference_poses, log.times)
    moved = np.array([relative(relative(true[k - 1], true[k]), log.motions[k]) for k in range(1, len(log))])
    nees = np.einsum("ti,tij,tj->t", moved, np.linalg.inv(log.motion_covariances[1:]), moved)
    assert np.median(nees) < 2.4 and (nees < 30.0).mean() > 0.95  # the median of χ²_3 is 2.37
    place = dict(zip(log.landmark_ids.tolist(), log.landmarks))
    assert sorted(place) == list(range(6, 21)) and set(log.sources) <= {SPURIOUS, *place}
    errors = []
    for k in range(len(log)):
        for point, source in zip(log.scan(k).points, log.sources_of(k).tolist()):
            if source != SPURIOUS:
                errors.append(np.hypot(*(point - observe(true[k], place[source][None])[0])))
    assert np.median(errors) < 0.2 and np.percentile(errors, 95) < 0.6


def test_a_set_that_is_not_there_or_damaged_is_named(data_dir, tmp_path) -> None:
    with pytest.raises(FileNotFoundError, match=r"Robot2_Odometry\.dat: not there.*Cite"):
        mrclam(tmp_path, 2)
    with pytest.raises(ValueError, match="robot: 6 is none of"):
        mrclam(tmp_path, 6)
    folder = tmp_path / "set"
    shutil.copytree(data_dir / "mrclam" / "MRCLAM_Dataset6", folder, copy_function=shutil.copyfile)
    path = folder / "Robot1_Measurement.dat.gz"
    lines = gzip.decompress(path.read_bytes()).decode().splitlines()
    for number, line, message in (
        (20, "1 2 3", "Measurement"),
        (30, lines[5], "back in time"),
        (9, "a b c d", "could"),
    ):
        text = "\n".join([*lines[:number], line, *lines[number:]])
        path.write_bytes(gzip.compress(text.encode()))
        with pytest.raises(RecordingError, match=message):
            mrclam(folder, 1)
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(RecordingError, match=r"Robot1_Measurement\.dat\.gz"):
        mrclam(folder, 1)


@pytest.fixture(scope="module")
def folder(data_dir):
    return data_dir / "mrclam" / "stationary"


def true_pairings(groups: Recording, k: int) -> np.ndarray:
    """Rows of `landmarks` behind the measurements of a group."""
    rows = {identity: row for row, identity in enumerate(groups.landmark_ids.tolist())}
    return np.array([rows[identity] for identity in groups.sources_of(k).tolist()])


@pytest.mark.parametrize("number", range(1, 6))
def test_groups_are_what_the_file_says_and_their_true_pairings_put_the_robot_where_the_vicon_has_it(
    folder, number
) -> None:
    """In polar form; and the stated noise explains the errors: their NEES has about the median of χ²_3, 2.37."""
    path = folder / f"mrclam{number}.mat"
    groups, file = stationary(path), loadmat(path)
    rows = file["measurement"]
    assert len(groups) == len(file["groundtruth"]) and len(groups.landmarks) == 15
    by_group = np.split(np.arange(len(rows)), np.cumsum(np.bincount(rows[:, 0].astype(int))[1:])[:-1])
    for k in np.linspace(0, len(groups) - 1, 50).astype(int):
        scan, told = groups.scan(k), rows[by_group[k]]
        assert len(scan) >= 3 and (told[:, 0] == k + 1).all()
        np.testing.assert_allclose(np.hypot(*scan.points.T), told[:, 2], atol=1e-9)
        np.testing.assert_allclose(np.arctan2(*scan.points.T[::-1]), told[:, 3], atol=1e-9)
        np.testing.assert_array_equal(groups.sources_of(k), told[:, 1])
    landmarks, away, nees = Landmarks.from_points(groups.landmarks, sigma=0.01), [], []
    for k in range(0, len(groups), len(groups) // 200):
        found = locate(groups.scan(k), landmarks, true_pairings(groups, k))
        error = found.pose - groups.reference_poses[k]
        error[2] = wrap_angle(error[2])
        away.append(np.hypot(*error[:2]))
        nees.append(error @ np.linalg.solve(found.covariance, error))
    assert np.median(away) < 0.2 and np.percentile(away, 90) < 0.6
    assert 0.2 < np.median(nees) < 5.0


def test_damaged_groups_are_named(folder, tmp_path) -> None:
    with pytest.raises(FileNotFoundError, match=r"mrclam9\.mat: not there.*Cite"):
        stationary(folder / "mrclam9.mat")
    whole = {name: loadmat(folder / "mrclam1.mat")[name] for name in ("landmark", "groundtruth", "measurement")}
    path = tmp_path / "mrclam1.mat"
    for name, change, message in (
        ("measurement", lambda t: np.vstack([t, [1.0, 99.0, 2.0, 0.0]]), "is of no landmark"),
        ("measurement", lambda t: np.vstack([[1e6, 1.0, 2.0, 0.0], t]), "row 1 is of no group"),
        ("groundtruth", lambda t: t[::-1], "not numbered"),
        ("groundtruth", lambda t: t[:, :3], "'groundtruth': expected a table of 4 columns"),
        ("landmark", lambda t: t * np.nan, "'landmark': row 1 is not finite"),
        ("landmark", lambda t: np.vstack([t, t[:1]]), "names a landmark twice"),
    ):
        savemat(path, whole | {name: change(whole[name])})
        with pytest.raises(RecordingError, match=message):
            stationary(path)
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(RecordingError, match=r"mrclam1\.mat"):
        stationary(path)
