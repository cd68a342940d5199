"""The grid of walls: its cells change nothing, and bad walls are refused."""

import numpy as np
import pytest

from slam_gym.world.ray_casting import WallIndex
from tests.world.test_ray_casting import ROOM, random_walls


@pytest.mark.parametrize("cell", [0.11, 0.7, 3.0, 100.0])
def test_size_of_the_cells_does_not_matter(cell):
    rng = np.random.default_rng(7)
    walls = np.vstack([random_walls(rng), np.round(random_walls(rng) / cell) * cell])  # many along cell borders
    one_by_one, index = WallIndex(np.zeros((1, 4))), WallIndex(walls, cell)
    angles = np.concatenate([rng.uniform(-np.pi, np.pi, 60), np.arange(8) * np.pi / 4])
    for origin in np.vstack([rng.uniform(-3, 18, (30, 2)), np.round(rng.uniform(0, 15, (30, 2)) / cell) * cell]):
        brute_force = one_by_one.cast(origin, angles, 9.0, segments=walls)
        np.testing.assert_allclose(index.cast(origin, angles, 9.0), brute_force, rtol=0, atol=1e-12)


def test_a_huge_building_gets_larger_cells():
    index = WallIndex(np.array([[0.0, 0.0, 1900.0, 0.0], [0.0, 1900.0, 1900.0, 1900.0]]), cell=0.05)
    assert len(index.packed[1]) < 1.1e6
    assert index.cast(np.array([950.0, 2.0]), np.array([-np.pi / 2]), 6.0)[0] == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("walls", "cell", "message"),
    [
        (np.zeros((3, 3)), 1.0, r"shape \(s, 4\)"),
        (np.array([[0, 0, 1, 1], [0, np.nan, 1, 1]]), 1.0, r"walls\[1\] is not finite"),
        (ROOM, 0.0, "cell must be a positive length"),
        (ROOM, np.nan, "cell must be a positive length"),
    ],
)
def test_bad_walls_are_refused_by_name(walls, cell, message):
    with pytest.raises(ValueError, match=message):
        WallIndex(walls, cell)
