"""The DLR log: counts that others have found in it, its frame, and files that are not what they should be."""

import gzip

import numpy as np
import pytest

from slam_gym.geometry import compose, transform
from slam_gym.recordings import RecordingError, open_recordings
from slam_gym.recordings.dlr import dlr
from slam_gym.types import SPURIOUS, UNLABELLED

STEP = "STEP image.ppm 0.01 -0.2 0.1 4e-4 1e-5 9e-4 2e-5 3e-5 1e-4\n"
CIRCLE = "LANDMARK_C 0.5 -2 0.9 0.01 0.002 0.04"


def test_the_log_has_all_its_steps_circles_and_labels(data_dir) -> None:
    (log,) = open_recordings("dlr", data_dir / "dlr")
    assert len(log) == 3297 and len(log.points) == 14_745
    assert (log.sources == SPURIOUS).sum() == 436
    assert len(np.unique(log.sources[log.sources >= 0])) == 576
    assert 500.0 < np.hypot(*log.motions[:, :2].T).sum() < 510.0
    distances, bearings = np.hypot(*log.points.T), np.abs(np.arctan2(log.points[:, 1], log.points[:, 0]))
    assert distances.max() < log.range and bearings.max() < 0.5 * log.field_of_view


def test_circles_stay_where_they_are_while_the_robot_drives_by(data_dir) -> None:
    """In a frame that fits the motion, not in its mirror image: over five steps odometry is good to centimetres."""
    log = dlr(data_dir / "dlr")
    scatter = {1.0: [], -1.0: []}
    for first in range(0, 3000, 100):
        for side, found in scatter.items():
            pose, seen = np.zeros(3), {}
            for step in range(first, first + 5):
                pose = compose(pose, log.motions[step] * [1.0, side, side]) if step > first else pose
                places = transform(pose, log.scan(step).points)
                for source, place in zip(log.sources_of(step).tolist(), places):
                    seen.setdefault(source, []).append(place)
            found += [
                np.std(places, axis=0).max() for source, places in seen.items() if source >= 0 and len(places) > 2
            ]
    assert np.median(scatter[1.0]) < 0.05 < 2.0 * np.median(scatter[1.0]) < np.median(scatter[-1.0])


def test_motions_and_covariances_turn_with_the_frame(tmp_path) -> None:
    (tmp_path / "map.circles").write_text(f"# comment\n{STEP}{CIRCLE} 3\n{STEP}{CIRCLE}\n{CIRCLE} 1 2\n{CIRCLE} -1\n")
    log = dlr(tmp_path)
    np.testing.assert_allclose(log.motions[0], [0.2, 0.01, 0.1])
    np.testing.assert_allclose(log.points[0], [2.0, 0.5])
    np.testing.assert_allclose(log.covariances[0], [[0.04, -0.002], [-0.002, 0.01]])
    expected = [[9e-4, -1e-5, -3e-5], [-1e-5, 4e-4, 2e-5], [-3e-5, 2e-5, 1e-4]]
    np.testing.assert_allclose(log.motion_covariances[0], expected, atol=1e-11)
    assert log.sources.tolist() == [3, UNLABELLED, UNLABELLED, SPURIOUS] and log.starts.tolist() == [0, 1, 4]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", "no step"),
        (f"{CIRCLE} 1\n", "line 1: a circle before the first step"),
        (f"{STEP}LANDMARK_C 1 2\n", "line 2: expected 6 finite numbers"),
        (f"{STEP}{CIRCLE.replace('0.9', 'nan')} 1\n", "line 2: expected 6 finite numbers"),
        (f"{STEP}{CIRCLE} -7\n", "line 2: identity -7"),
        (STEP.replace("0.1", "word"), "line 1: could not convert"),
        (f"{STEP}HOUSE 1\n", "line 2: 'HOUSE'"),
        (f"{STEP}{CIRCLE.replace('0.01', '-1')} 1\n", "covariances"),
    ],
)
def test_what_is_no_log_is_refused_by_file_and_line(tmp_path, text, line) -> None:
    (tmp_path / "map.circles.gz").write_bytes(gzip.compress(text.encode()))
    with pytest.raises(RecordingError, match=rf"map\.circles\.gz: .*{line}"):
        dlr(tmp_path)
    with pytest.raises(FileNotFoundError, match=r"map\.circles: not there.*Cite"):
        dlr(tmp_path / "nowhere")
