"""What makes paths stay in sight of features: places from which few are in view cost a path more.

How many there are is looked up once in each square of `LOOKOUT` metres, all around, as far as walls are known.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_gym._compile import compiled
from slam_gym.navigation.expected_gain import features_in_sight
from slam_gym.navigation.explored_grid import ExploredGrid
from slam_gym.types import Array, IntArray

ENOUGH = 2  # features in view that hold position and heading
PARTS = ENOUGH + 1  # of each level of cells
LOOKOUT = 1.0  # [m] side of the squares in which as many features are held to be in view

Levels = NDArray[np.int32]  # (h + 2, w + 2) of cells, within a border; 0 = impassable


class Sight(NamedTuple):
    """What paths are to stay in sight of, and what it may cost."""

    state: Array  # (3 + 2n,) mean of the map
    reach: float  # [m] to which features are seen
    price: float  # ≥ 0: a length with no feature in view costs 1 + price times as much, with one 1 + price / 2 times


def priced_by_sight(
    levels: Levels, weights: Array, grid: ExploredGrid, origin: Array, sight: Sight
) -> tuple[Levels, Array]:
    """Each level in `PARTS`, by how many features are missing in view, and the weight of each.

    `levels` are those of cells of the grid from `origin` (2,) [m] in B on. Part k of level l becomes `PARTS` · l + k,
    so that impassable cells stay at 0, and higher levels stay above lower ones.
    """
    side = max(1, round(LOOKOUT / grid.resolution))
    cells = _lookouts(levels, side)
    free = cells[..., 0] >= 0
    places = origin + (cells[free][:, ::-1] + 0.5) * grid.resolution
    missing = np.zeros(free.shape, dtype=np.int32)
    missing[free] = ENOUGH - features_in_sight(sight.state, grid, places, sight.reach, most=ENOUGH)
    prices = 1.0 + sight.price * np.arange(PARTS) / ENOUGH
    return _split(levels, missing, side), np.outer(weights, prices).ravel()


@compiled
def _lookouts(levels: Levels, side: int) -> IntArray:
    """Row and column of the free cell nearest to the middle of each square of `side` cells, (H, W, 2); −1 for none."""
    h, w = levels.shape[0] - 2, levels.shape[1] - 2
    out = np.full((-(-h // side), -(-w // side), 2), -1, dtype=np.int64)
    nearest = np.full(out.shape[:2], np.inf)
    for r in range(h):
        for c in range(w):
            if levels[r + 1, c + 1] > 0:
                i, j = r // side, c // side
                away = (r % side - 0.5 * (side - 1)) ** 2 + (c % side - 0.5 * (side - 1)) ** 2
                if away < nearest[i, j]:
                    nearest[i, j], out[i, j, 0], out[i, j, 1] = away, r, c
    return out


@compiled
def _split(levels: Levels, missing: NDArray[np.int32], side: int) -> Levels:
    """The part of its level that each cell is in, by what is `missing` (H, W) in its square of `side` cells."""
    out = np.zeros_like(levels)
    for r in range(1, levels.shape[0] - 1):
        for c in range(1, levels.shape[1] - 1):
            if levels[r, c] > 0:
                out[r, c] = PARTS * levels[r, c] + missing[(r - 1) // side, (c - 1) // side]
    return out
