"""Corners of an outline: what counts as one, and how far apart they stay."""

import numpy as np
import pytest

from slam_gym.world.contours import corners, straightened, thinned


def test_corners_ignore_small_steps_and_keep_thin_wall_ends():
    stepped = np.array([[0, 0], [5, 0], [5, 0.1], [10, 0.1], [10, 5], [0, 5]])
    assert len(corners(stepped)[0]) == 4
    thin = np.array([[0, 0], [10, 0], [10, 5], [5.1, 5], [5.1, 3], [5.0, 3], [5.0, 5], [0, 5]])
    found = corners(thin)[0]
    assert len(found) == 7 - 1  # four corners of the room, the wall's end, and one of the two at its foot
    assert np.hypot(*(found - [5.05, 3.0]).T).min() <= 0.06


@pytest.mark.parametrize("seed", range(5))
def test_of_points_too_close_to_each_other_the_heavier_stays(seed):
    rng = np.random.default_rng(seed)
    points, weights = rng.uniform(0.0, 3.0, (80, 2)), rng.permutation(80).astype(float)
    kept = thinned(points, weights)
    apart = np.hypot(*(points[:, None] - points).transpose(2, 0, 1))
    assert (apart[np.ix_(kept, kept)] + np.eye(len(kept)) >= 0.3).all()
    for dropped in np.setdiff1d(np.arange(80), kept):
        assert (weights[kept[apart[dropped, kept] < 0.3]] > weights[dropped]).any()
    assert thinned(np.empty((0, 2)), np.empty(0)).shape == (0,)


def test_vertices_at_which_a_ring_does_not_turn_are_dropped():
    ring = np.array([[0.0, 0.0], [4.0, 0.1], [8.0, 0.0], [8.0, 6.0], [8.0, 9.0], [8.0, 6.0], [0.0, 6.0]])
    assert straightened(ring).tolist() == [[0.0, 0.0], [8.0, 0.0], [8.0, 6.0], [0.0, 6.0]]
