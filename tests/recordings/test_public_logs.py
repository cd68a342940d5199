"""Victoria Park and MR.CLAM as they are published: counts and figures that others have found in them."""

import gzip
import shutil

import numpy as np
import pytest

from slam_gym.geometry import compose, observe, relative
from slam_gym.recordings.mrclam import ROBOTS, mrclam
from slam_gym.recordings.recording import Recording, RecordingError
from slam_gym.recordings.victoria_park import victoria_park
from slam_gym.types import NONE, UNKNOWN


@pytest.fixture(scope="module")
def park(data_dir) -> Recording:
    return victoria_park(data_dir / "victoria_park")


def driven(recording: Recording) -> np.ndarray:
    """Poses (T, 3) of dead reckoning."""
    poses, pose = [], np.zeros(3)
    for motion in recording.motions:
        pose = compose(pose, motion)
        poses.append(pose)
    return np.array(poses)


def at_reference(recording: Recording, times: np.ndarray) -> np.ndarray:
    """Reference poses (t, 3) at `times`, interpolated."""
    x, y, heading = recording.reference_poses.T
    heading = np.unwrap(heading)
    return np.column_stack([np.interp(times, recording.reference_times, v) for v in (x, y, heading)])


def test_the_park_has_all_its_scans_detections_and_labels(park) -> None:
    assert len(park) == 7249 and len(park.points) == 52_974 and np.diff(park.starts).max() == 18
    assert (park.sources >= 0).sum() == 46_860 and len(np.unique(park.sources[park.sources >= 0])) == 299
    labelled = [k for k in range(len(park)) if (park.sources_of(k) >= 0).any()]
    assert len(labelled) == 7122
    assert not any((park.sources_of(k) == UNKNOWN).any() for k in labelled)


def test_trunks_are_where_labels_say_as_seen_from_neighbouring_scans(park) -> None:
    """Over a second, dead reckoning is good to decimetres: a labelled trunk hardly moves, whatever the frame is."""
    poses, errors = driven(park), []
    for k in range(100, 7000, 50):
        before, after = park.sources_of(k), park.sources_of(k + 4)
        motion = relative(poses[k], poses[k + 4])
        for i, source in enumerate(before):
            if source >= 0 and source in after:
                expected = observe(motion, park.scan(k).points[i][None])[0]
                errors.append(np.hypot(*(park.scan(k + 4).points[list(after).index(source)] - expected)))
    assert len(errors) > 300 and np.median(errors) < 0.3


def test_dead_reckoning_leaves_the_park_as_it_does_for_everybody(park) -> None:
    """Some 90 m off after alignment (92 m published); the speed of the encoder's wheel, uncorrected, would do worse."""
    from slam_gym.metrics.map_quality import align_se2

    inside = (park.reference_times > park.times[0]) & (park.reference_times < park.times[-1])
    poses, gps = driven(park), park.reference_poses[inside, :2]
    positions = np.column_stack([np.interp(park.reference_times[inside], park.times, poses[:, i]) for i in (0, 1)])
    pose = align_se2(positions, gps)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    aligned = positions @ np.array([[c, s], [-s, c]]) + pose[:2]
    assert 60.0 < np.sqrt(((aligned - gps) ** 2).sum(axis=1).mean()) < 110.0


def test_a_folder_without_the_park_says_where_to_get_it(tmp_path) -> None:
    with pytest.raises(FileNotFoundError, match=r"aa3_dr\.mat: not there\. Victoria Park.*Cite"):
        victoria_park(tmp_path)


def test_damaged_files_of_the_park_are_named(data_dir, tmp_path) -> None:
    folder = tmp_path / "park"
    shutil.copytree(data_dir / "victoria_park", folder, copy_function=shutil.copyfile)
    path = folder / "aa3_gpsx.mat"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RecordingError, match=r"aa3_gpsx\.mat"):
        victoria_park(folder)
    shutil.copyfile(folder / "aa3_dr.mat", path)
    with pytest.raises(RecordingError, match=r"aa3_gpsx\.mat: variable 'timeGps' is missing"):
        victoria_park(folder)


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_motions_of_a_robot_are_those_of_the_vicon(data_dir, robot) -> None:
    log = mrclam(data_dir / "mrclam" / "MRCLAM_Dataset6", robot)
    true = at_reference(log, log.times)
    errors = np.array([relative(relative(true[k - 1], true[k]), log.motions[k]) for k in range(1, len(log))])
    nees = np.einsum("ti,tij,tj->t", errors, np.linalg.inv(log.motion_covariances[1:]), errors)
    assert np.median(nees) < 2.4 and (nees < 30.0).mean() > 0.95  # the median of χ²_3 is 2.37


@pytest.mark.parametrize("robot", ROBOTS)
def test_barcodes_are_seen_where_the_vicon_has_them(data_dir, robot) -> None:
    log = mrclam(data_dir / "mrclam" / "MRCLAM_Dataset6", robot)
    true = at_reference(log, log.times)
    place = dict(zip(log.landmark_ids.tolist(), log.landmarks))
    assert sorted(place) == list(range(6, 21)) and set(log.sources) <= {NONE, *place}
    errors = []
    for k in range(len(log)):
        for point, source in zip(log.scan(k).points, log.sources_of(k).tolist()):
            if source != NONE:
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
