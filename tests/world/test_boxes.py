"""Furniture as boxes: outlines and distances."""

import numpy as np
import pytest

from slam_gym.world import boxes


def test_box_outlines_and_distances():
    box = np.array([[1.0, 2.0, 4.0, 2.0, np.pi / 2]])
    corners = {tuple(np.round(side[:2], 9)) for side in boxes.outlines(box)}
    assert corners == {(0.0, 0.0), (2.0, 0.0), (2.0, 4.0), (0.0, 4.0)}
    sides = boxes.outlines(box)
    np.testing.assert_allclose(sides[:, 2:], np.roll(sides[:, :2], -1, axis=0))
    area = 0.5 * np.sum(sides[:, 0] * sides[:, 3] - sides[:, 2] * sides[:, 1])
    assert area == pytest.approx(8.0), "counter-clockwise"
    for point, distance in (((1, 2), 0), ((3, 2), 1), ((1, -1), 1), ((5, 8), 5)):
        assert boxes.distance(*map(float, point), box) == pytest.approx(distance, abs=1e-12)
    assert boxes.distance(0.0, 0.0, np.empty((0, 5))) == np.inf
