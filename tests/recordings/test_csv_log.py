"""Logs as tables: what is read, by rule where there is no column, and every refusal by line and column."""

import numpy as np
import pytest

from slam_gym import Scan, open_recordings
from slam_gym.recordings import RecordingError, from_csv, load, save
from slam_gym.types import UNKNOWN_KIND

HEAD = "time,forward,lateral,turn,x,y\n"


def written(folder, text):
    path = folder / "mine.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_steps_motions_and_measurements_are_read(tmp_path):
    rows = "0,3,0,1,8,1\n0,,,,6,-2\n0.5,1,0.1,-0.2,,\n\n1.5,2,0,0,4,0.5\n"
    (log,) = open_recordings(written(tmp_path, HEAD + rows))
    assert log.name == "mine.csv" and log.times.tolist() == [0.0, 0.5, 1.5] and log.starts.tolist() == [0, 2, 2, 3]
    assert log.points.tolist() == [[8, 1], [6, -2], [4, 0.5]] and log.motions[1].tolist() == [1, 0.1, -0.2]
    assert (log.sources == -2).all() and log.range == pytest.approx(np.hypot(8, 1))
    assert log.field_of_view == pytest.approx(2 * np.arctan2(2, 6))
    d = np.hypot(1, 0.1)
    sigmas = [[0.02, 0.02, 0.01], [0.02 + 0.01 * d] * 2 + [0.01 + 0.02 * d + 0.05 * 0.2]]
    assert np.allclose(log.motion_covariances[:2], np.eye(3) * np.square(sigmas)[:, None])
    save(log, tmp_path / "mine.npz")
    assert np.array_equal(load(tmp_path / "mine.npz").covariances, log.covariances)


def test_columns_for_deviations_sizes_and_identities_are_used(tmp_path):
    head = "time,forward,lateral,turn,range,bearing,sigma_range,sigma_bearing,sigma_forward,sigma_lateral,sigma_turn"
    text = (
        f"{head},size,sigma_size,kind,source\n"
        "0,1,0,0,5,0.3,0.1,0.02,0.2,0.1,0.05,0.4,0.01,3,7\n0,,,,6,-1,0.1,0.02,,,,,,,-1\n"
    )
    log = from_csv(written(tmp_path, text), range=20.0, field_of_view=3.0)
    scan = Scan.from_polar([5, 6], [0.3, -1], 0.1, 0.02)
    assert np.allclose(log.points, scan.points) and np.allclose(log.covariances, scan.covariances)
    assert np.allclose(log.motion_covariances[0], np.diag([0.04, 0.01, 0.0025])) and log.sources.tolist() == [7, -1]
    assert log.sizes[0] == 0.4 and np.isnan(log.sizes[1]) and (log.range, log.field_of_view) == (20.0, 3.0)
    assert log.scan(0).kinds.tolist() == [3, UNKNOWN_KIND]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "column 'time' is missing; there are none"),
        ("time,forward,lateral,turn,x\n", "column 'y' is missing"),
        ("time,forward,lateral,turn,x,y,colour\n", "unknown column 'colour'"),
        (HEAD, "has no row"),
        (HEAD + "0,0,0,0,1\n", "line 2: expected 6 columns"),
        (HEAD + "0,0,0,0,1,1,1\n", "line 2: expected 6 columns"),
        (HEAD + "0,0,0,zero,1,1\n", "line 2: column 'turn': 'zero' is no number"),
        (HEAD + "0,0,0,inf,1,1\n", "line 2: column 'turn': 'inf' is not finite"),
        (HEAD + "0,0,0,0,nan,nan\n", "line 2: column 'x': 'nan' is not finite; a cell without a number is empty"),
        (HEAD + "0,0,0,0,1_0,1\n", "line 2: column 'x': '1_0' is no number"),
        (HEAD.strip() + ",kind\n0,0,0,0,1,1,-1\n", "line 2: column 'kind' is -1"),
        (HEAD.strip() + ",x\n", "a column is there twice"),
        (HEAD.replace("x,y", "range,bearing") + "0,0,0,0,1,1\n1,0,0,0,0,1\n", "line 3: column 'range' is not above 0"),
        (HEAD.replace("x,y", "range,bearing") + "0,0,0,0,1,50\n", "line 2: column 'bearing' [rad] is more than a turn"),
        (HEAD + "0,0,0,9,1,1\n", "line 2: column 'turn' [rad] is more than a turn; are these degrees, or absolute"),
        (HEAD + "0,0,0,0,1,1\n1,0,2e9,0,1,1\n", "line 3: column 'lateral' is above 1e+09"),
        (HEAD + f"0,0,0,{'1' * 200_000},1,1\n", "field larger than field limit"),
        (
            HEAD.strip() + ",source\n0,0,0,0,1,1,9007199254740993\n0,0,0,0,1,1,1e17\n",
            "line 3: column 'source' is above",
        ),
        (HEAD.strip() + ",source\n0,0,0,0,1,1,-3\n", "line 2: column 'source' is below -2"),
        (HEAD.strip() + ",size,sigma_size\n0,0,0,0,1,1,,1\n", "line 2: only one of 'size' and 'sigma_size' is given"),
        (HEAD.strip() + ",size,sigma_size\n0,0,0,0,1,1,-1,1\n", "line 2: column 'size' is negative"),
        (HEAD.strip() + ",sigma_x,sigma_y\n0,0,0,0,1,1,1e200,1\n", "line 2: column 'sigma_x' is above 1e+09"),
        (HEAD.strip() + ",sigma_x,sigma_y\n0,0,0,0,1,1,1e-9,1\n", "measurement 0: covariance has a condition number"),
        (HEAD + "0,0,0,0,1,1\n\n0,,,,1,\n", "line 4: only one of 'x' and 'y' is given"),
        (HEAD + "0,0,0,0,1,1\n1,,0,0,1,1\n", "line 3: column 'forward' is empty in the first row of a step"),
        (HEAD + "0,0,0,0,1,1\n0,0,,,1,1\n", "line 3: column 'forward' is given again at the same time"),
        (HEAD + "1,0,0,0,1,1\n0,0,0,0,1,1\n", "line 3: column 'time' descends"),
        (HEAD + ",0,0,0,1,1\n", "line 2: column 'time' is empty"),
        (HEAD.strip() + ",sigma_x\n0,0,0,0,1,1,0\n", "line 2: column 'sigma_x' is not above 0"),
        (HEAD.strip() + ",sigma_turn\n0,0,0,0,1,1,\n", "line 2: column 'sigma_turn' is empty"),
        (HEAD.strip() + ",source\n0,0,0,0,1,1,1.5\n", "line 2: column 'source' is no integer"),
        (HEAD.strip() + ",size\n0,0,0,0,1,1,1\n", "columns 'size' and 'sigma_size': only one of them is there"),
    ],
)
def test_what_does_not_fit_is_refused_by_line_and_column(tmp_path, text, said):
    path = written(tmp_path, text)
    with pytest.raises(RecordingError) as refused:
        from_csv(path)
    assert str(refused.value).startswith(str(path)) and said in str(refused.value)


def test_what_is_no_text_is_refused(tmp_path):
    path = tmp_path / "mine.csv"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(RecordingError, match="is no text in UTF-8"):
        from_csv(path)
