"""Victoria Park as it is published: counts and figures that others have found in it."""

import shutil

import numpy as np
import pytest

from slam_gym.geometry import compose, observe, relative
from slam_gym.recordings import Recording, RecordingError
from slam_gym.recordings.victoria_park import victoria_park
from slam_gym.types import UNLABELLED


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


def test_the_park_has_all_its_scans_detections_and_labels(park) -> None:
    assert len(park) == 7249 and len(park.points) == 52_974 and np.diff(park.starts).max() == 18
    assert (park.sources >= 0).sum() == 46_860 and len(np.unique(park.sources[park.sources >= 0])) == 299
    labelled = [k for k in range(len(park)) if (park.sources_of(k) >= 0).any()]
    assert len(labelled) == 7122
    still = (park.motions == 0.0).all(axis=1)
    assert still.sum() == 276 and np.allclose(park.motion_covariances[still], 1e-8 * np.eye(3), atol=0.0)
    assert not any((park.sources_of(k) == UNLABELLED).any() for k in labelled)


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
    shutil.copyfile(folder / "aa3_dr.mat", folder / "aa3_gpsx.mat")
    with pytest.raises(RecordingError, match=r"aa3_gpsx\.mat: variable 'timeGps' is missing"):
        victoria_park(folder)
