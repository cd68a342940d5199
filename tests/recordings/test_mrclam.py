"""MR.CLAM as it is published: motions and barcodes against the Vicon."""

import gzip
import shutil

import numpy as np
import pytest

from slam_gym.geometry import observe, relative
from slam_gym.recordings import RecordingError
from slam_gym.recordings.mrclam import ROBOTS, mrclam
from slam_gym.recordings.recording import interpolate
from slam_gym.types import SPURIOUS


@pytest.mark.parametrize("robot", ROBOTS[::2])
def test_motions_and_barcodes_of_a_robot_are_those_of_the_vicon(data_dir, robot) -> None:
    log = mrclam(data_dir / "mrclam" / "MRCLAM_Dataset6", robot)
    true = interpolate(log.reference_times, log.reference_poses, log.times)
    moved = np.array([relative(relative(true[k - 1], true[k]), log.motions[k]) for k in range(1, len(log))])
    nees = np.einsum("ti,tij,tj->t", moved, np.linalg.inv(log.motion_covariances[1:]), moved)
    assert nees.mean() < 1.9 and (nees < 30.0).mean() > 0.95  # 3 for motions as bad as they say
    C = log.motion_covariances  # an early error of the heading becomes a lateral one later
    assert (C[:, 1, 2] * log.motions[:, 0]).sum() > 0.0 > (C[:, 0, 2] * log.motions[:, 1]).sum()
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
