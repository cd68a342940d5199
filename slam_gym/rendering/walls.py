"""Explored walls as lines, since cells would look like saw teeth in pictures against which their grid is turned."""

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import KDTree

from slam_gym.geometry import transform
from slam_gym.navigation.explored_grid import WALL, Cells
from slam_gym.types import Array

WIDTH = 0.5  # [cells] of a line
_SMOOTHING = 1.0  # [cells] standard deviation of the weights of a centre of mass


def wall_lines(cells: Cells, pose: Array, resolution: float) -> tuple[Array, Array]:
    """Points (w, 2) [m] that stand for the wall cells, and lines (s, 4) [m] x1 y1 x2 y2 between those that touch.

    A point is the local centre of mass of walls. `pose` (3,) is the pose of the grid's lower left corner,
    `resolution` [m] the side of a cell.
    """
    walls = cells == WALL
    rows, columns = np.indices(cells.shape)
    mass, x, y = (gaussian_filter(np.where(walls, of, 0.0), _SMOOTHING)[walls] for of in (1.0, columns, rows))
    centres = transform(pose, resolution * (np.stack([x, y], axis=1) / mass[:, None] + 0.5))
    touching = KDTree(np.argwhere(walls)).query_pairs(1.5, output_type="ndarray")
    return centres, centres[touching].reshape(-1, 4)
