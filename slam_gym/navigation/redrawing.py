"""Sweeps taken out of the explored grid and put in again elsewhere, as the poses they were taken from are corrected.

Evidence saturates, so that it cannot be subtracted; the numbers of kept sweeps that had an echo in a cell, and that
crossed it, can. Where these change, evidence and class are made anew from them, as if the sweeps had come in any order.
"""

from __future__ import annotations

import math

import numpy as np

from slam_gym._compile import compiled
from slam_gym.navigation.grid import FREE, HIT, MISS, SATURATION, UNKNOWN, WALL, Layers, PackedLayers, reclassify, trace
from slam_gym.types import Array


@compiled
def redraw(
    packed: PackedLayers,
    first_sweep: int,
    origin: Array,
    resolution: float,
    moved: tuple[Array, Array, Array],
    bearings: Array,
    max_range: float,
) -> None:
    """Move sweeps: `moved` are their poses so far (k, 3), their new poses (k, 3), and their ranges (k, b).

    A pose that is NaN stands for a sweep that is not in the grid. The numbers of sweeps from `first_sweep` to
    `first_sweep` + 2k − 1 are used up.
    """
    layers, (before, after, ranges) = Layers(*packed), moved
    size, sweep, changed, touched = layers.cells.size, first_sweep, 0, layers.touched
    hits, crossings = layers.hits.ravel(), layers.crossings.ravel()
    marked, journal = np.zeros(size, np.bool_), np.empty(size, np.int32)
    old_hits, old_crossings = np.empty(size, np.uint16), np.empty(size, np.uint16)
    for k in range(len(ranges)):
        for pose, change in ((before[k], -1), (after[k], 1)):
            if math.isnan(pose[0]):
                continue
            echoes, end = trace(layers, sweep, origin, resolution, pose, bearings, ranges[k], max_range)
            sweep += 1
            for i in range(end):
                cell = touched[i]
                if not marked[cell]:
                    marked[cell], journal[changed] = True, cell
                    old_hits[changed], old_crossings[changed] = hits[cell], crossings[cell]
                    changed += 1
                if i < echoes:
                    hits[cell] += change
                else:
                    crossings[cell] += change
    for i in range(changed):
        cell = journal[i]
        if hits[cell] != old_hits[i] or crossings[cell] != old_crossings[i]:
            _made_anew(layers, cell, int(hits[cell]), int(crossings[cell]))


@compiled
def _made_anew(layers: Layers, cell: int, hits: int, crossings: int) -> None:
    """Evidence and class of a cell from the sweeps in it alone."""
    weight = int(HIT) * hits + int(MISS) * crossings
    layers.evidence.ravel()[cell] = min(SATURATION, max(-SATURATION, weight))
    after = UNKNOWN if hits + crossings == 0 else (WALL if weight > 0 else FREE)
    if layers.cells.ravel()[cell] != after:
        reclassify(layers, cell, after)
