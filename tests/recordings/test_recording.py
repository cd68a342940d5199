"""A recording in memory: its parts, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest

from slam_gym.recordings import Recording, RecordingError


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


def test_a_recording_cannot_be_made_wrong_by_replacing_a_field() -> None:
    with pytest.raises(RecordingError, match="field 'times' has shape"):
        replace(Recording(**by_hand()), motions=np.zeros((5, 3)), times=np.zeros((2, 2)))


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


def test_identities_below_a_million_are_kept() -> None:
    told = by_hand() | {"sources": np.tile([7, 8, 9, (1 << 20) - 1], 6)}
    assert Recording(**told).sources.max() == (1 << 20) - 1


@pytest.mark.parametrize(
    ("name", "index", "value", "message"),
    [
        ("sizes", 1, np.inf, "field 'sizes': entry 1 is larger than 1e"),
        ("sizes", 3, -np.inf, "field 'sizes': entry 3 is larger than 1e"),
        ("size_variances", 1, np.inf, "field 'size_variances': entry 1 is larger than 1e"),
        ("points", (2, 0), 1e200, "field 'points': entry 2 is larger than 1e"),
        ("motions", (4, 1), -1e200, "field 'motions': entry 4 is larger than 1e"),
        ("motion_covariances", (4, 1, 1), 1e200, "field 'motion_covariances': entry 4 is larger than 1e"),
    ],
)
def test_what_would_overflow_further_in_is_refused(name, index, value, message) -> None:
    told = by_hand()
    told[name] = np.array(told[name], np.float64)
    told[name][index] = value
    with pytest.raises(RecordingError, match=message):
        Recording(**told)


def test_starts_whose_differences_overflow_are_refused() -> None:
    told = by_hand()
    told["starts"] = np.array([0, 2**63 - 1, -(2**63), -1, 24, 24, 24])
    with pytest.raises(RecordingError, match="field 'starts': entry 2 descends"):
        Recording(**told)
