"""The file of a recording: what goes in comes out, and whatever is wrong is named."""

from dataclasses import fields

import numpy as np
import pytest

from slam_gym.recordings import Recording, RecordingError, load, save
from slam_gym.slam.slam import Slam
from tests.recordings.test_recording import by_hand


def written(path, **changes):
    content = {"format": "slam_gym recording", "version": 1, **by_hand(), **changes}
    np.savez(path, **{name: value for name, value in content.items() if value is not None})
    return path


def test_a_log_written_by_hand_from_the_format_page_loads_and_runs(tmp_path) -> None:
    recording = load(written(tmp_path / "mine.npz"))
    slam = Slam()
    for odometry, scan, _ in recording.steps():
        slam.step(odometry, scan)
    assert slam.map.n == 4
    np.testing.assert_allclose(slam.map.pose, [1.0, 0.0, 0.0], atol=0.1)


def test_what_is_saved_is_loaded(tmp_path) -> None:
    recording = Recording(**by_hand())
    save(recording, tmp_path / "log.npz")
    again = load(tmp_path / "log.npz")
    for field in fields(Recording):
        np.testing.assert_array_equal(getattr(again, field.name), getattr(recording, field.name), field.name)
    assert [p.name for p in tmp_path.iterdir()] == ["log.npz"]


def broken(name: str, index, value) -> np.ndarray:
    array = np.array(by_hand()[name])
    array[index] = value
    return array


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "something"}, "field 'format' does not say 'slam_gym recording'"),
        ({"format": None}, "field 'format' does not say"),
        ({"version": 2}, "field 'version' is 2; this release reads version 1"),
        ({"version": None}, "field 'version' is None"),
        ({"points": None}, "field 'points' is missing"),
        ({"colour": 3}, "unknown field 'colour'"),
        ({"name": 3}, "field 'name' is no text"),
        ({"range": "far"}, "field 'range' is no number"),
        ({"range": np.inf}, "field 'range' is inf"),
        ({"field_of_view": 7.0}, "field 'field_of_view' is 7.0"),
        ({"sources": np.zeros(24)}, "field 'sources' has entries of type float64"),
        ({"sources": broken("sources", 5, -3)}, "field 'sources': entry 5 is neither an identity nor -1 nor -2"),
        ({"points": np.zeros((24, 3))}, r"field 'points' has shape \(24, 3\), expected \(24, 2\)"),
        ({"sizes": np.zeros(23)}, r"field 'sizes' has shape \(23,\), expected \(24,\)"),
        ({"points": broken("points", (3, 1), np.nan)}, "field 'points': entry 3 is not finite"),
        ({"motions": broken("motions", (2, 2), np.inf)}, "field 'motions': entry 2 is not finite"),
        ({"times": broken("times", 4, 0.1)}, "field 'times': entry 4 comes before"),
        ({"starts": broken("starts", 2, 20)}, "field 'starts': entry 3 descends"),
        ({"starts": broken("starts", 6, 25)}, "field 'starts' goes from 0 to 25, expected 0 to 24"),
        ({"covariances": broken("covariances", 7, [[1, 0], [0, -1]])}, "field 'covariances': entry 7 is no covariance"),
        ({"covariances": broken("covariances", 7, [[1, 1], [0, 1]])}, "field 'covariances': entry 7 is no covariance"),
        ({"motion_covariances": broken("motion_covariances", 1, -np.eye(3))}, "'motion_covariances': entry 1 is no"),
        ({"size_variances": broken("size_variances", 1, np.nan)}, "field 'size_variances': entry 1 is NaN"),
        ({"size_variances": broken("size_variances", 1, -1.0)}, "field 'size_variances': entry 1 is negative"),
        ({"reference_poses": broken("reference_poses", (0, 1), np.nan)}, "'reference_poses': entry 0 has no finite"),
        ({"landmark_ids": np.array([7, 7])}, "field 'landmark_ids' names a landmark twice"),
        ({"times": np.array(["a"] * 6, dtype=object)}, "field 'times' has entries of type object"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_with_its_file_field_and_entry(tmp_path, changes, message) -> None:
    path = written(tmp_path / "bad.npz", **changes)
    with pytest.raises(RecordingError, match=message) as caught:
        load(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("keep", [0.0, 0.3, 0.9, 0.999])
def test_a_truncated_file_is_named(tmp_path, keep) -> None:
    path = written(tmp_path / "cut.npz")
    whole = path.read_bytes()
    path.write_bytes(whole[: int(keep * len(whole))])
    with pytest.raises(RecordingError, match=r"cut\.npz"):
        load(path)


def test_bits_that_flipped_do_not_pass_for_data(tmp_path) -> None:
    path = written(tmp_path / "flipped.npz")
    whole = bytearray(path.read_bytes())
    at = whole.index(np.float64(by_hand()["points"][3, 0]).tobytes())
    whole[at + 6] ^= 0xFF
    path.write_bytes(whole)
    with pytest.raises(RecordingError, match=r"flipped\.npz"):
        load(path)


def test_a_file_that_is_not_there_is_not_there(tmp_path) -> None:
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "none.npz")
