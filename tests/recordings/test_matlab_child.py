"""What the child takes apart is numbers only."""

import numpy as np
import pytest

from slam_gym.recordings.matlab_child import taken_apart


def test_cells_become_shapes_and_values() -> None:
    cells = np.empty((1, 2), object)
    cells[0, :] = [np.arange(4.0).reshape(2, 2), np.zeros((3, 0))]
    parts = taken_apart("zt", cells)
    assert parts["zt shapes"].tolist() == [[2, 2], [3, 0]] and parts["zt shape"].tolist() == [1, 2]
    assert parts["zt values"].tolist() == [0.0, 1.0, 2.0, 3.0]
    assert list(taken_apart("a", np.eye(2))) == ["a"]


def test_text_and_records_are_refused() -> None:
    for value in (np.array(["text"]), np.zeros(1, [("a", float)]), np.array([np.array("text")], object), "text"):
        with pytest.raises(ValueError, match="variable 'v'"):
            taken_apart("v", value)
