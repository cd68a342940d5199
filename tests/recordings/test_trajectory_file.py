"""Trajectories that others read."""

import numpy as np
import pytest

from slam_gym.recordings.trajectory_file import write_tum


def test_evo_reads_back_what_was_written(tmp_path) -> None:
    file_interface = pytest.importorskip("evo.tools.file_interface")
    times, poses = np.arange(5.0), np.random.default_rng(0).uniform(-3, 3, (5, 3))
    write_tum(tmp_path / "run.tum", times, poses)
    read = file_interface.read_tum_trajectory_file(tmp_path / "run.tum")
    np.testing.assert_allclose(read.timestamps, times)
    np.testing.assert_allclose(read.positions_xyz[:, :2], poses[:, :2], rtol=1e-8)
    headings = [np.arctan2(matrix[1, 0], matrix[0, 0]) for matrix in read.poses_se3]
    np.testing.assert_allclose(np.exp(1j * np.array(headings)), np.exp(1j * poses[:, 2]), rtol=1e-7)


@pytest.mark.parametrize(("times", "poses"), [([0.0], [[0, 0]]), ([0.0, 1.0], [[0, 0, 0]]), ([0.0], [[np.nan, 0, 0]])])
def test_what_is_no_trajectory_is_refused(tmp_path, times, poses) -> None:
    with pytest.raises(ValueError, match="times, poses"):
        write_tum(tmp_path / "run.tum", times, poses)
