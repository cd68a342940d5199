"""A recording in memory and as a file: what goes in comes out, and whatever is wrong is named."""

from dataclasses import fields

import numpy as np
import pytest

from slam_gym.recordings import Recording, RecordingError, load, save, write_tum
from slam_gym.slam.slam import Slam
from slam_gym.types import UNKNOWN_KIND


def by_hand(rng: np.random.Generator | None = None, steps: int = 6) -> dict[str, object]:
    """The fields of a log, as somebody who has read the format page would write them down: a slow drive past posts."""
    rng = rng or np.random.default_rng(0)
    posts = np.array([[2.0, 1.0], [3.0, -1.0], [4.0, 1.5], [5.0, -2.0]])
    seen = [posts - [0.2 * t, 0.0] for t in range(steps)]
    points = np.concatenate(seen) + 0.02 * rng.standard_normal((4 * steps, 2))
    return {
        "name": "by hand", "source": "the test", "terms": "any",
        "times": np.arange(steps) / 2.0,
        "motions": np.array([[0.2 * (t > 0), 0.0, 0.0] for t in range(steps)]),
        "motion_covariances": np.tile(1e-4 * np.eye(3), (steps, 1, 1)),
        "starts": 4 * np.arange(steps + 1),
        "points": points,
        "covariances": np.tile(4e-4 * np.eye(2), (4 * steps, 1, 1)),
        "sizes": np.where(np.arange(4 * steps) % 2, 0.3, np.nan),
        "size_variances": np.where(np.arange(4 * steps) % 2, 0.01, np.nan),
        "kinds": np.tile([2, UNKNOWN_KIND, 0, 2], steps),
        "sources": np.tile([7, 8, 9, 30], steps),
        "reference_times": np.array([0.0, 2.5]),
        "reference_poses": np.array([[0.0, 0.0, np.nan], [1.0, 0.0, 0.0]]),
        "landmark_ids": np.array([7, 8]),
        "landmarks": posts[:2],
        "range": 6.0, "field_of_view": 3.0,
    }  # fmt: skip


def test_a_part_has_the_scans_of_its_steps() -> None:
    recording = Recording(**by_hand())
    part = recording.part(2, 5)
    assert len(part) == 3
    for k in range(3):
        np.testing.assert_array_equal(part.scan(k).points, recording.scan(k + 2).points)
        np.testing.assert_array_equal(part.odometry(k).motion, recording.odometry(k + 2).motion)
        np.testing.assert_array_equal(part.sources_of(k), recording.sources_of(k + 2))
    for first, last in ((3, 3), (-1, 2), (0, 7)):
        with pytest.raises(IndexError, match="of a recording of 6"):
            recording.part(first, last)


def test_lists_are_arrays_and_what_cannot_be_saved_is_refused() -> None:
    told = by_hand() | {"motions": [[0, 0, 0], *[[1, 2, 1]] * 5], "sources": [7, 8, 9, 30] * 6}
    exact = Recording(**told | {"motions": np.array(told["motions"], np.float64)})
    np.testing.assert_array_equal(Recording(**told).every(2).motions, exact.every(2).motions)
    for changes in ({"sources": np.full(24, np.nan)}, {"name": 5}, {"times": list("012345")}):
        with pytest.raises(RecordingError, match=f"field '{next(iter(changes))}'"):
            Recording(**told | changes)


def test_what_a_log_does_not_tell_is_unknown() -> None:
    told = by_hand()
    for name in ("sizes", "size_variances", "reference_times", "reference_poses", "landmark_ids", "landmarks"):
        del told[name]
    recording = Recording(**told)
    assert np.isnan(recording.scan(3).sizes).all() and np.isnan(recording.scan(3).size_variances).all()
    assert recording.reference_poses.shape == (0, 3) and recording.landmarks.shape == (0, 2)


@pytest.mark.parametrize("large", [10**9, 2**62, 1 << 20])
def test_large_identities_are_numbered_anew_in_their_order(large) -> None:
    told = by_hand()
    told["sources"] = np.where(np.arange(24) == 5, -1, np.tile([7, large, 9, 30], 6))
    told["landmark_ids"] = np.array([large, 7])
    recording = Recording(**told)
    assert recording.sources[:8].tolist() == [0, 3, 1, 2, 0, -1, 1, 2]
    assert recording.landmark_ids.tolist() == [3, 0]
    assert recording.part(2, 4).sources.tolist() == recording.sources[8:16].tolist()


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
    earlier = load(written(tmp_path / "earlier.npz", kinds=None))  # its release knew no kinds
    assert (earlier.kinds == UNKNOWN_KIND).all() and earlier.part(1, 3).scan(0).kinds.shape == (4,)


def broken(name: str, index, value) -> np.ndarray:
    array = np.array(by_hand()[name])
    array[index] = value
    return array


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "something"}, "field 'format' does not say 'slam_gym recording'"),
        ({"version": 2}, "field 'version' is 2; this release reads version 1"),
        ({"points": None}, "field 'points' is missing"),
        ({"colour": 3}, "unknown field 'colour'"),
        ({"name": 3}, "field 'name' has entries of type int64"),
        ({"range": "far"}, "field 'range' has entries of type <U3"),
        ({"range": np.inf}, "field 'range' is inf"),
        ({"sources": np.zeros(24)}, "field 'sources' has entries of type float64"),
        ({"sources": broken("sources", 5, -3)}, "field 'sources': entry 5 is neither an identity nor -1 nor -2"),
        ({"kinds": broken("kinds", 5, -1)}, "field 'kinds': entry 5 is neither a class from 0 nor -2"),
        ({"points": np.zeros((24, 3))}, r"field 'points' has shape \(24, 3\), expected \(24, 2\)"),
        ({"sizes": np.zeros(23)}, r"field 'sizes' has shape \(23,\), expected \(24,\)"),
        ({"points": broken("points", (3, 1), np.nan)}, "field 'points': entry 3 is not finite"),
        ({"motions": broken("motions", (2, 2), np.inf)}, "field 'motions': entry 2 is not finite"),
        ({"times": broken("times", 4, 0.1)}, "field 'times': entry 4 comes before"),
        ({"starts": broken("starts", 2, 20)}, "field 'starts': entry 3 descends"),
        ({"starts": broken("starts", 6, 25)}, "field 'starts' goes from 0 to 25, expected 0 to 24"),
        ({"covariances": broken("covariances", 7, [[1, 0], [0, -1]])}, "field 'covariances': entry 7 is no covariance"),
        ({"motion_covariances": broken("motion_covariances", 1, -np.eye(3))}, "'motion_covariances': entry 1 is no"),
        ({"size_variances": broken("size_variances", 1, -1.0)}, "field 'size_variances': entry 1 is negative"),
        ({"reference_poses": broken("reference_poses", (0, 1), np.nan)}, "'reference_poses': entry 0 has no finite"),
        ({"reference_poses": broken("reference_poses", (0, 2), np.inf)}, "'reference_poses': entry 0 has an infinite"),
        ({"landmark_ids": np.array([7, 7])}, "field 'landmark_ids' names a landmark twice"),
        ({"times": np.array(["a"] * 6, dtype=object)}, "field 'times' is not a numpy array"),
        # what would overflow further in
        ({"sizes": broken("sizes", 1, np.inf)}, "field 'sizes': entry 1 is larger than 1e"),
        ({"sizes": broken("sizes", 3, -np.inf)}, "field 'sizes': entry 3 is larger than 1e"),
        ({"size_variances": broken("size_variances", 1, np.inf)}, "field 'size_variances': entry 1 is larger than 1e"),
        ({"points": broken("points", (2, 0), 1e200)}, "field 'points': entry 2 is larger than 1e"),
        ({"motions": broken("motions", (4, 1), -1e200)}, "field 'motions': entry 4 is larger than 1e"),
        ({"motion_covariances": broken("motion_covariances", (4, 1, 1), 1e200)},
         "field 'motion_covariances': entry 4 is larger than 1e"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_with_its_file_field_and_entry(tmp_path, changes, message) -> None:
    path = written(tmp_path / "bad.npz", **changes)
    with pytest.raises(RecordingError, match=message) as caught:
        load(path)
    assert str(path) in str(caught.value)


def test_evo_reads_back_what_was_written(tmp_path) -> None:
    file_interface = pytest.importorskip("evo.tools.file_interface")
    times, poses = 1.7e9 + 0.05 * np.arange(5.0), np.random.default_rng(0).uniform(-3, 3, (5, 3))
    write_tum(tmp_path / "run.tum", times, poses)
    read = file_interface.read_tum_trajectory_file(tmp_path / "run.tum")
    np.testing.assert_allclose(read.timestamps, times, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(read.positions_xyz[:, :2], poses[:, :2], rtol=1e-8)
    headings = [np.arctan2(matrix[1, 0], matrix[0, 0]) for matrix in read.poses_se3]
    np.testing.assert_allclose(np.exp(1j * np.array(headings)), np.exp(1j * poses[:, 2]), rtol=1e-7)


@pytest.mark.parametrize(("times", "poses"), [([0.0], [[0, 0]]), ([0.0, 1.0], [[0, 0, 0]]), ([0.0], [[np.nan, 0, 0]])])
def test_what_is_no_trajectory_is_refused(tmp_path, times, poses) -> None:
    with pytest.raises(ValueError, match="times, poses"):
        write_tum(tmp_path / "run.tum", times, poses)
