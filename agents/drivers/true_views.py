"""What there is to see in a building whose plan is known: from every place, and on every way between places.

Truth: only drivers that say so by their name use it (`agents.drivers.clairvoyant`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from slam_gym._jit import compiled
from slam_gym.simulation.episode import Site
from slam_gym.types import Array, BoolArray, IntArray
from slam_gym.world.ray_casting import pull_back

Bits = NDArray[np.uint64]
"""(…, w) sets of features, one bit each, 64 to a word."""

_SURE = 0.95  # of the sensor's range, up to which a feature is seen often enough to be mapped
_SPACING = 1.2  # [m] between viewpoints
_VIEWPOINTS = (24, 160)  # at least and at most; larger buildings have fewer, farther apart,
_WORDS = 4_000_000  # so that what is seen on all ways takes no more of these if it can


class Ways(NamedTuple):
    """The shortest ways from some cells to all cells, and what is seen on them: the same there and back."""

    lengths: Array  # (s, c) [m]; inf where none leads
    seen: Bits  # (s, c, w) from the cells of the way, both ends included


class TrueViews:
    """Views of one building: `cells` (c, 2) [m] in W, the `viewpoints` (v,) among them, and the `ways` from those."""

    def __init__(self, site: Site, sensor_range: float) -> None:
        self.cells = site.cells
        self.seen = _seen_from(site, _SURE * sensor_range)
        self._graph = _graph(self.cells)
        most = int(np.clip(_WORDS // self.seen.size, *_VIEWPOINTS))
        self.viewpoints = _spread(self.cells, most)
        self.ways = self.ways_from(self.viewpoints)

    def ways_from(self, sources: IntArray) -> Ways:
        """The ways from `sources` (s,), indices of cells."""
        lengths, before = dijkstra(self._graph, indices=sources, return_predecessors=True)
        return Ways(lengths, _along(np.argsort(lengths, axis=1), before, self.seen, lengths))

    def nearest(self, points: Array) -> IntArray:
        """(q,) indices of the cells nearest to `points` (q, 2) in W."""
        out: IntArray = ((self.cells[None] - points[:, None]) ** 2).sum(axis=2).argmin(axis=1)
        return out


def bits_of(chosen: BoolArray) -> Bits:
    """The sets (…, w) of the features that are `chosen` (…, n)."""
    words = np.zeros((*chosen.shape[:-1], 64 * max(1, -(-chosen.shape[-1] // 64))), np.bool_)
    words[..., : chosen.shape[-1]] = chosen
    return np.packbits(words, axis=-1, bitorder="little").view("<u8").astype(np.uint64)


def _spread(cells: Array, most: int) -> IntArray:
    """Cells far from each other, (v,): each next one is the farthest from all before."""
    chosen, gaps = [0], np.hypot(*(cells - cells[0]).T)
    while len(chosen) < most and gaps.max() > _SPACING:
        chosen.append(int(gaps.argmax()))
        gaps = np.minimum(gaps, np.hypot(*(cells - cells[chosen[-1]]).T))
    return np.array(chosen, np.int64)


def _graph(cells: Array) -> sparse.csr_matrix:
    """Neighbouring cells, eight around each, joined by their distance; across a corner only past two other cells."""
    across = np.diff(np.unique(cells[:, 0]))
    side = float(across.min()) if len(across) else 1.0
    columns, rows = np.rint((cells - cells.min(axis=0)) / side).astype(np.int64).T + 1
    index = np.full((rows.max() + 2, columns.max() + 2), -1)
    index[rows, columns] = np.arange(len(cells))
    starts, ends, lengths = [], [], []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        other = index[rows + down, columns + right]
        joined = (other >= 0) & (index[rows + down, columns] >= 0) & (index[rows, columns + right] >= 0)
        starts.append(np.flatnonzero(joined))
        ends.append(other[joined])
        lengths.append(np.full(int(joined.sum()), side * math.hypot(down, right)))
    one, two, length = (np.concatenate(parts) for parts in (starts, ends, lengths))
    half = sparse.csr_matrix((length, (one, two)), shape=(len(cells), len(cells)))
    return half + half.T


def _seen_from(site: Site, reach: float) -> Bits:
    """(c, w) the features that count, within `reach` [m] and that no wall hides, from each cell of the site."""
    features, short = site.plan.features.positions, pull_back(site.plan.features)
    seen = np.zeros((len(site.cells), len(features)), np.bool_)
    for cell, row in zip(site.cells, seen):
        near = np.flatnonzero(site.observable & (np.hypot(*(features - cell).T) <= reach))
        row[near] = site.index.visible(cell, features[near], short[near])
    return bits_of(seen)


@compiled
def _along(order: IntArray, before: NDArray[np.int32], seen: Bits, lengths: Array) -> Bits:
    """(s, c, w) what is seen on the ways, cell by cell from the nearest on."""
    out = np.zeros((order.shape[0], seen.shape[0], seen.shape[1]), np.uint64)
    for s in range(order.shape[0]):
        for i in range(order.shape[1]):
            c = order[s, i]
            if lengths[s, c] == math.inf:
                break
            for w in range(seen.shape[1]):
                out[s, c, w] = seen[c, w]
                if before[s, c] >= 0:
                    out[s, c, w] |= out[s, before[s, c], w]
    return out
