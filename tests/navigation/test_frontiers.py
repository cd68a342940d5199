"""Frontiers against labelled components, and what is left out."""

import math

import numpy as np
from scipy import ndimage

from slam_gym.navigation.explored_grid import FREE, UNKNOWN, WALL, ExploredGrid
from slam_gym.navigation.frontiers import find_frontiers, frontiers
from slam_gym.navigation.planner import distance_field
from tests.oracles.statistics import for_seeds


def frontiers_by_labelling(cells, reachable, min_border):
    """The same frontiers from image-processing primitives: the distance of each from its centroid to the cell that
    stands for it, and its border; and the cells on frontiers."""
    unknown = cells == UNKNOWN
    cross = ndimage.generate_binary_structure(2, 1)
    on_frontier = (cells == FREE) & ndimage.binary_dilation(unknown, cross)
    labels, count = ndimage.label(on_frontier, np.ones((3, 3)))
    found = []
    for k in range(1, count + 1):
        member = labels == k
        border = (ndimage.binary_dilation(member, cross) & unknown).sum()
        if border < min_border:
            continue
        centroid = np.argwhere(member).mean(axis=0)
        candidates = member & reachable
        for _ in range(2):
            if candidates.any():
                break
            member = member | (ndimage.binary_dilation(member, cross) & (cells == FREE) & ~on_frontier)
            candidates = member & reachable
        where = np.argwhere(candidates)
        if len(where):
            found.append((np.round(np.hypot(*(where - centroid).T).min(), 9), border))
    return found, on_frontier


@for_seeds(30)
def test_frontiers_are_the_labelled_components(seed):
    rng = np.random.default_rng(seed)
    noise = ndimage.gaussian_filter(rng.normal(size=(40, 60)), 1.5 + seed % 3)
    cells = np.digitize(noise, np.quantile(noise, [0.3, 0.8])).astype(np.uint8)
    reachable = (cells == FREE) & (rng.random(cells.shape) < 0.3)
    found = find_frontiers(cells, reachable, 3.0, math.inf)
    centres, borders = found[:, :2], found[:, 2]
    expected, on_frontier = frontiers_by_labelling(cells, reachable, 3.0)
    assert all(reachable[row, column] for column, row in centres)
    labels, _ = ndimage.label(on_frontier, np.ones((3, 3)))
    assert len(centres) == len(expected)
    for (column, row), border in zip(centres, borders):
        near = [k for k in np.unique(labels[max(0, row - 2) : row + 3, max(0, column - 2) : column + 3]) if k > 0]
        distances = {np.round(np.hypot(*(np.argwhere(labels == k).mean(axis=0) - (row, column))), 9) for k in near}
        assert any((distance, border) in expected for distance in distances)


def test_long_frontiers_are_split():
    cells = np.full((20, 200), FREE, dtype=np.uint8)
    cells[10:] = UNKNOWN
    found = find_frontiers(cells, cells == FREE, 3.0, 15.0)
    centres, borders = found[:, :2], found[:, 2]
    assert borders.sum() >= 200 and borders.max() <= 31
    assert np.diff(np.sort(centres[:, 0])).max() <= 31


def test_frontiers_left_out_without_a_way_to_them():
    """Two free areas with a wall between them: the robot's side has a frontier, and so has the other."""
    cells = np.full((20, 41), FREE, dtype=np.uint8)
    cells[:, 20], cells[15:, :] = WALL, UNKNOWN
    grid = ExploredGrid(np.array([0.0, 0.0, 41 * 0.2, 4.0]))
    grid._cells[:] = cells
    assert {side for side in frontiers(grid, cells == FREE)[:, 0] > 20.5 * 0.2} == {False, True}
    field = distance_field(grid, np.array([1.0, 1.0]), 0.25)
    reached = frontiers(grid, field.reachable)
    assert len(reached) > 0 and (reached[:, 0] < 20 * 0.2).all()
    assert np.isfinite(field.lengths_to(reached)).all()
