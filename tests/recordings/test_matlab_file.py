"""MATLAB files from strangers are read in a process of their own, with the same result; faults are named."""

import io

import numpy as np
import pytest
from scipy.io import savemat

from slam_gym.recordings import RecordingError
from slam_gym.recordings.matlab_file import read_matlab


def test_cells_come_back_as_they_were(tmp_path) -> None:
    cells = np.empty((1, 3), object)
    cells[0, :] = [np.arange(6.0).reshape(3, 2), np.zeros((3, 0)), np.ones((3, 1))]
    savemat(tmp_path / "log.mat", {"zt": cells, "other": "text"})
    read = read_matlab(tmp_path / "log.mat", ("zt",), "")["zt"]
    assert read.shape == (1, 3) and read.dtype == object
    for one, other in zip(read.ravel(), cells.ravel()):
        np.testing.assert_array_equal(one, other)


def test_published_files_come_back_the_same_from_the_child(data_dir, tmp_path) -> None:
    path, names = data_dir / "victoria_park" / "VictoriaParkSinSincronizar.mat", ("TLsr", "zt")
    known = read_matlab(path, names, "")
    (tmp_path / "changed.mat").write_bytes(path.read_bytes() + bytes(8))  # which loadmat passes over
    child = read_matlab(tmp_path / "changed.mat", names, "")
    np.testing.assert_array_equal(child["TLsr"], known["TLsr"])
    assert all(np.array_equal(one, other) for one, other in zip(child["zt"].ravel(), known["zt"].ravel()))


def test_what_is_not_numbers_and_what_takes_too_much_memory_is_refused(tmp_path) -> None:
    path = tmp_path / "log.mat"
    savemat(path, {"a": "text"})
    with pytest.raises(RecordingError, match=r"log\.mat: no readable MATLAB file: ValueError: variable 'a' is neither"):
        read_matlab(path, ("a",), "")
    path.write_bytes(_promising(0x7FFFFFF8))
    with pytest.raises(RecordingError, match=r"log\.mat: no readable MATLAB file"):
        read_matlab(path, ("a",), "")


def _promising(count: int) -> bytes:
    """A file whose variable has more bytes than it holds."""
    file = io.BytesIO()
    savemat(file, {"a": np.zeros(1000)})
    return file.getvalue().replace((8000).to_bytes(4, "little"), count.to_bytes(4, "little"))


def test_matlab_files_are_read_or_named(tmp_path) -> None:
    path = tmp_path / "log.mat"
    with pytest.raises(FileNotFoundError, match=r"log\.mat: not there\. Cite somebody"):
        read_matlab(path, ("a",), "Cite somebody.")
    savemat(path, {"a": np.arange(3.0), "b": 1.0})
    content = read_matlab(path, ("a",), "")
    assert list(content) == ["a"] and content["a"].ravel().tolist() == [0.0, 1.0, 2.0]
    with pytest.raises(RecordingError, match=r"log\.mat: variable 'c' is missing"):
        read_matlab(path, ("a", "c"), "")
    path.write_bytes(path.read_bytes()[:150])
    with pytest.raises(RecordingError, match=r"log\.mat: no readable MATLAB file"):
        read_matlab(path, ("a",), "")
