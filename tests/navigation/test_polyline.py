"""A path as a line, against the same written over whole arrays."""

import math

import numpy as np
import pytest

from slam_gym.navigation.polyline import length_left, next_stretch, on_path, points_ahead


def reference(path, position):
    """Segment, length covered on it and gap of the nearest point, and the lengths of all segments."""
    steps = np.diff(path, axis=0)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    along = ((position - path[:-1]) * steps).sum(axis=1) / np.maximum(lengths, 1e-9) ** 2
    along = np.clip(along, 0.0, 1.0)
    gaps = np.hypot(*(position - path[:-1] - along[:, None] * steps).T)
    nearest = int(np.argmin(gaps))
    return nearest, along[nearest] * lengths[nearest], gaps[nearest], lengths


@pytest.mark.parametrize("seed", range(20))
def test_nearest_point_and_what_is_left_are_those_of_whole_arrays(seed) -> None:
    rng = np.random.default_rng(seed)
    path, position = rng.uniform(0.0, 9.0, (rng.integers(2, 30), 2)), rng.uniform(-1.0, 10.0, 2)
    if seed % 3 == 0:
        path[1] = path[0]  # a segment without length
    segment, covered, gap, lengths = reference(path, position)
    assert tuple(on_path(path, position)) == pytest.approx((segment, covered, gap), abs=1e-12)
    assert length_left(path, position) == pytest.approx(gap + lengths[segment:].sum() - covered, abs=1e-12)


@pytest.mark.parametrize("seed", range(20))
def test_points_ahead_lie_on_the_path_evenly(seed) -> None:
    rng = np.random.default_rng(seed)
    path, position = rng.uniform(0.0, 9.0, (rng.integers(1, 12), 2)), rng.uniform(-1.0, 10.0, 2)
    rest = path[int(np.argmin(((path - position) ** 2).sum(axis=1))) :]
    points = points_ahead(path, position, 0.2)
    if len(rest) == 1:
        np.testing.assert_array_equal(points, rest)
        return
    starts = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(rest, axis=0).T))])
    along = np.arange(0.0, starts[-1], 0.2)
    expected = np.column_stack([np.interp(along, starts, rest[:, axis]) for axis in range(2)])
    np.testing.assert_allclose(points, expected, atol=1e-12)


def test_a_straight_line_by_hand() -> None:
    path = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0]])
    assert tuple(on_path(path, np.array([1.0, 2.0]))) == (0, 1.0, 2.0)
    assert length_left(path, np.array([1.0, 2.0])) == 2.0 + 3.0 + 3.0
    assert len(points_ahead(path, np.zeros(2), 0.5)) == 14
    assert math.isclose(length_left(path, np.array([4.0, 3.0])), 0.0, abs_tol=1e-12)


def test_the_length_left_is_measured_along_the_path() -> None:
    path = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0]])
    for position, left in [
        ((0, 0), 7.0),
        ((1, 0), 6.0),
        ((3.9, 0), 3.1),
        ((4, 2), 1.0),
        ((2, 0.5), 5.5),
        ((4, 4), 1.0),
    ]:
        assert length_left(path, np.array(position, float)) == pytest.approx(left)
    assert length_left(np.zeros((2, 2)), np.array([0.3, 0.4])) == pytest.approx(0.5)


def test_the_next_stretch_and_the_rest_make_up_the_path() -> None:
    path = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 20.0], [30.0, 20.0]])
    stretch, rest = next_stretch(path, np.array([1.0, 0.2]), 15.0)
    np.testing.assert_allclose(stretch, [[0, 0], [4, 0], [4, 12.0]])
    np.testing.assert_array_equal(rest, path[2:])
    stretch, rest = next_stretch(path, np.array([20.0, 20.1]), 15.0)
    np.testing.assert_array_equal(stretch, path[2:])
    assert len(rest) == 0
