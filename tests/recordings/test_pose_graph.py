"""Text pose graphs: both dialects say the same, and a bad line is named."""

import numpy as np
import pytest

from slam_gym.geometry import compose, transform
from slam_gym.recordings import RecordingError
from slam_gym.recordings.pose_graph import g2o, isam

MOTION, SEEN = np.diag([0.01, 0.04, 0.0025]), np.array([[0.05, 0.01], [0.01, 0.02]])
LANDMARKS = {100: (2.0, 1.0), 101: (3.0, -2.0)}
STEP = np.array([0.5, 0.1, 0.2])


def numbers(values) -> str:
    return " ".join(f"{value:.17g}" for value in np.ravel(values))


def upper(matrix) -> str:
    return numbers(matrix[np.triu_indices(len(matrix))])


def files(folder):
    """The same short log in both dialects."""
    poses, one, other = [np.zeros(3)], [], []
    for _ in range(3):
        poses.append(compose(poses[-1], STEP))
    root = {len(C): np.linalg.cholesky(np.linalg.inv(C)).T for C in (MOTION, SEEN)}
    for i, pose in enumerate(poses):
        one.append(f"VERTEX_SE2 {i} {numbers(pose)}")
        if i:
            one.append(f"EDGE_SE2 {i - 1} {i} {numbers(STEP)} {upper(np.linalg.inv(MOTION))}")
            other.append(f"{('ODOMETRY', 'EDGE2')[i % 2]} {i - 1} {i} {numbers(STEP)} {upper(root[3])}")
        for number, place in LANDMARKS.items():
            inverse = compose(np.zeros(3), pose)
            c, s = np.cos(inverse[2]), np.sin(inverse[2])
            seen = np.array([[c, s], [-s, c]]) @ (np.array(place) - pose[:2])
            one.append(f"EDGE_SE2_XY {i} {number} {numbers(seen)} {upper(np.linalg.inv(SEEN))}")
            other.append(f"LANDMARK {i} {number} {numbers(seen)} {upper(root[2])}   # a comment")
    one += [f"VERTEX_XY {number} {numbers(place)}" for number, place in LANDMARKS.items()]
    (folder / "log.g2o").write_text("\n".join(one))
    (folder / "log.txt").write_text("# a comment\n\n" + "\n".join(other))
    return folder / "log.g2o", folder / "log.txt"


def test_both_dialects_give_the_log_that_was_written(tmp_path) -> None:
    for recording in (g2o(files(tmp_path)[0]), isam(files(tmp_path)[1])):
        assert len(recording) == 4 and recording.sources.tolist() == [100, 101] * 4
        np.testing.assert_allclose(recording.motions, [[0, 0, 0], STEP, STEP, STEP])
        np.testing.assert_allclose(recording.motion_covariances[1:], [MOTION] * 3, atol=1e-12)
        np.testing.assert_allclose(recording.covariances, [SEEN] * 8, atol=1e-12)
        pose = np.zeros(3)
        for odometry, scan, _ in recording.steps():
            pose = compose(pose, odometry.motion)
            np.testing.assert_allclose(transform(pose, scan.points), list(LANDMARKS.values()), atol=1e-12)


def test_vertices_are_the_reference_if_asked(tmp_path) -> None:
    path, _ = files(tmp_path)
    path.write_text(f"FIX 0\n{path.read_text()}")  # which optimisers need
    recording = g2o(path, reference=True)
    assert recording.landmark_ids.tolist() == [100, 101] and len(recording.reference_poses) == 4
    np.testing.assert_allclose(recording.landmarks, list(LANDMARKS.values()))
    assert len(g2o(path).reference_poses) == 0


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("EDGE_SE3 0 1 0 0 0", "'EDGE_SE3' is none of"),
        ("EDGE_SE2_XY 0 100 1 2 1 0", "EDGE_SE2_XY takes 7 finite numbers"),
        ("EDGE_SE2_XY 0 100 1 nan 1 0 1", "EDGE_SE2_XY takes 7 finite numbers"),
        ("EDGE_SE2_XY 0 100 1 two 1 0 1", "could not convert"),
        ("EDGE_SE2_XY 0.5 100 1 2 1 0 1", "0.5 is no index"),
        ("EDGE_SE2_XY 0 100 1 2 1 3 1", "not positive definite"),
        ("EDGE_SE2_XY 0 -1 1 2 1 0 1", "-1 is no index"),
        ("EDGE_SE2_XY 0 9.007199254740993e15 1 2 1 0 1", "9.007199254740993e15 is no index"),
        ("EDGE_SE2_XY 0 9223372036854775808 1 2 1 0 1", "9223372036854775808 is no index"),
        (f"EDGE_SE2_XY 0 {'9' * 5000} 1 2 1 0 1", "is no index"),
        ("EDGE_SE2_XY 0 100 1 2 1e-320 0 1e300", "not positive definite"),
        ("EDGE_SE2 0 1 0 0 0 1 0 0 1 0 1", "from 0 to 1 is there twice"),
        ("VERTEX_XY 100 7 7", "vertex 100 is there twice"),
    ],
)
def test_a_bad_line_is_named(tmp_path, line, message) -> None:
    path, _ = files(tmp_path)
    count = len(path.read_text().splitlines())
    path.write_text(path.read_text() + "\n" + line)
    with pytest.raises(RecordingError, match=rf"log\.g2o: line {count + 1}: .*{message}"):
        g2o(path, reference=True)


@pytest.mark.parametrize(
    ("cut", "message"), [("EDGE_SE2 1 2", "pose 2 is not reached from pose 1"), ("EDGE_SE2_XY", "no measurement")]
)
def test_a_log_with_holes_is_refused(tmp_path, cut, message) -> None:
    path, _ = files(tmp_path)
    path.write_text("\n".join(line for line in path.read_text().splitlines() if not line.startswith(cut)))
    with pytest.raises(RecordingError, match=message):
        g2o(path)


def test_identities_that_no_float_tells_apart_stay_apart(tmp_path) -> None:
    """GTSAM writes the character of a symbol into the upper byte of its number."""
    path, _ = files(tmp_path)
    first = (ord("l") << 56) + 1
    words = [line.split() for line in path.read_text().splitlines()]
    for line in words:
        if line[0] in ("VERTEX_XY", "EDGE_SE2_XY"):
            at = 1 if line[0] == "VERTEX_XY" else 2
            line[at] = str(first + int(line[at]) - 100)
    path.write_text("\n".join(map(" ".join, words)))
    recording = g2o(path, reference=True)
    assert recording.sources.tolist() == [0, 1] * 4 and recording.landmark_ids.tolist() == [0, 1]
    np.testing.assert_allclose(recording.landmarks, list(LANDMARKS.values()))
