"""What the readers of logs share."""

import numpy as np
import pytest
from scipy.io import savemat

from slam_gym.recordings import RecordingError
from slam_gym.recordings.reading import Spans, read_matlab, starts_of


def test_spans_are_cut_where_commands_take_over() -> None:
    looks, commands = np.array([0.0, 1.0, 1.0, 4.0]), np.array([0.5, 1.0, 2.5, 2.5, 9.0])
    spans = Spans.between(looks, commands)
    assert spans.step.tolist() == [1, 1, 3, 3] and spans.command.tolist() == [-1, 0, 1, 3]
    assert spans.sums(spans.seconds, 4).tolist() == [0.0, 1.0, 0.0, 3.0]
    assert spans.headings(np.array([1.0, 2.0, 4.0, 8.0])).tolist() == [0.0, 1.0, 0.0, 4.0]
    assert len(Spans.between(looks[:1], commands).step) == 0


def test_steps_start_where_those_before_them_end() -> None:
    assert starts_of([2, 0, 3]).tolist() == [0, 2, 2, 5] and starts_of([]).tolist() == [0]
    assert starts_of(np.array([True, False, True])).dtype == np.int64


def test_matlab_files_are_read_or_named(tmp_path) -> None:
    path = tmp_path / "log.mat"
    with pytest.raises(FileNotFoundError, match=r"log\.mat: not there\. Cite somebody"):
        read_matlab(path, ("a",), "Cite somebody.")
    cells = np.empty((1, 2), object)
    cells[0, :] = [np.arange(6.0).reshape(3, 2), np.zeros((3, 0))]
    savemat(path, {"a": np.arange(3.0), "b": 1.0, "zt": cells})
    content = read_matlab(path, ("a", "zt"), "")
    assert list(content) == ["a", "zt"] and content["a"].ravel().tolist() == [0.0, 1.0, 2.0]
    assert [cell.shape for cell in content["zt"].ravel()] == [(3, 2), (3, 0)]
    with pytest.raises(RecordingError, match=r"log\.mat: variable 'c' is missing"):
        read_matlab(path, ("a", "c"), "")
    path.write_bytes(path.read_bytes()[:150])
    with pytest.raises(RecordingError, match=r"log\.mat: no readable MATLAB file"):
        read_matlab(path, ("a",), "")
