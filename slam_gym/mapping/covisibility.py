"""The covisibility graph: which features were seen together, and how often.

Two features are covisible when one scan saw both. Neighbours make a better locality than distance, since features close
to each other on two sides of a wall are never seen together (Neira, Tardós and Castellanos 2003).
"""

from __future__ import annotations

import copy
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_gym._jit import compiled
from slam_gym.types import UNPAIRED, BoolArray, IntArray
from slam_gym.validation import indices

Counts = NDArray[np.int32]
"""(≥ n, ≥ n) number of scans that saw both of two features, symmetric, 0 on the diagonal and beyond n; (0, 0): all
features are local to each other."""

_ROOM = 64  # initial capacity


class Edges(NamedTuple):
    """Pairs of features that were seen together."""

    pairs: IntArray  # (e, 2) i < j
    counts: IntArray  # (e,) number of scans that saw both


class CovisibilityGraph:
    """Undirected graph over the features 0 … n−1 of a map, with a count on each edge.

    The counts are a matrix, which takes an eighth of the memory of the map's covariance. Features are indices as in the
    map; `add` and `keep` are called where the map adds and removes features.
    """

    def __init__(self) -> None:
        self.n = 0
        self.counts: Counts = np.zeros((_ROOM, _ROOM), np.int32)  # as compiled functions take them

    def make_room(self, more: int) -> None:
        """Make room for `more` nodes, by doubling the capacity."""
        room = len(self.counts)
        while self.n + more > room:
            room *= 2
        if room > len(self.counts):
            counts = np.zeros((room, room), np.int32)  # memory that is never touched is never allocated
            counts[: self.n, : self.n] = self.counts[: self.n, : self.n]
            self.counts = counts

    def add(self, count: int) -> None:
        """Append `count` nodes without edges."""
        if count < 0:
            raise ValueError(f"count: {count} is negative")
        self.make_room(count)
        self.n += count

    def see_together(self, features: IntArray) -> None:
        """Add 1 to the count of each pair of `features` (j,) of one scan; UNPAIRED and repetitions are ignored.

        Raises ValueError where a feature is not in the graph.
        """
        count_pairs(self.counts, indices("features", features, self.n, UNPAIRED))

    def link(self, pairs: IntArray) -> None:
        """Count each pair (k, 2) of different features as seen together once, unless it was already.

        Raises ValueError for a feature that is not in the graph, or that is paired with itself.
        """
        i, j = indices("pairs", pairs.ravel(), self.n).reshape(-1, 2).T
        if (i == j).any():
            raise ValueError(f"pairs: feature {i[i == j][0]} with itself")
        self.counts[i, j] = self.counts[j, i] = np.maximum(self.counts[i, j], 1)

    def keep(self, kept: IntArray) -> None:
        """Keep only the nodes `kept` (n',) (old indices, ascending), which become 0 … n'−1.

        Raises ValueError, before the graph is changed, where they are not ascending nodes of it.
        """
        kept = indices("kept", kept, self.n)
        if (np.diff(kept) <= 0).any():
            raise ValueError("kept: not the ascending indices of nodes in the graph")
        keep_nodes(self.counts, self.n, kept)
        self.n = len(kept)

    def followed_by(self, other: CovisibilityGraph) -> CovisibilityGraph:
        """The graph of the nodes of this graph, then those of `other`, with the edges of both."""
        graph = copy.deepcopy(self)
        graph.add(other.n)
        graph.counts[self.n : graph.n, self.n : graph.n] = other.counts[: other.n, : other.n]
        return graph

    def reordered(self, order: IntArray) -> CovisibilityGraph:
        """The graph with its nodes in another `order` (n,)."""
        graph = copy.deepcopy(self)
        graph.counts[: self.n, : self.n] = self.counts[np.ix_(order, order)]
        return graph

    def fused(self, kept: IntArray, dropped: IntArray) -> CovisibilityGraph:
        """A graph in which node kept[i] takes over the edges of dropped[i], (k,), which are removed.

        The counts of edges to a common neighbour add up; edges between kept[i] and dropped[i] are dropped.
        """
        graph = copy.deepcopy(self)
        np.add.at(graph.counts, kept, graph.counts[dropped])
        np.add.at(graph.counts.T, kept, graph.counts.T[dropped])
        np.fill_diagonal(graph.counts, 0)
        graph.keep(np.delete(np.arange(self.n), dropped))
        return graph

    def neighbours(self, i: int) -> IntArray:
        """Features seen together with i, ascending. Raises IndexError where i is not in the graph."""
        if not 0 <= i < self.n:
            raise IndexError(f"feature {i} in a graph of {self.n}")
        return np.flatnonzero(self.counts[i])

    def edges(self) -> Edges:
        """All edges, in ascending order."""
        pairs = np.argwhere(np.triu(self.counts[: self.n, : self.n]))
        return Edges(pairs, self.counts[pairs[:, 0], pairs[:, 1]].astype(np.int64))


@compiled
def count_pairs(counts: Counts, features: IntArray) -> None:
    """`CovisibilityGraph.see_together`."""
    seen = np.unique(features[features != UNPAIRED])
    for i in seen:
        for j in seen:
            counts[i, j] += i != j


@compiled
def keep_nodes(counts: Counts, n: int, kept: IntArray) -> None:
    """`CovisibilityGraph.keep`, in place."""
    first = 0  # everything before the first gap stays where it is
    while first < len(kept) and kept[first] == first:
        first += 1
    for i in range(len(kept)):
        for j in range(first if i < first else 0, len(kept)):
            counts[i, j] = counts[kept[i], kept[j]]
    counts[len(kept) : n, :n] = 0
    counts[: len(kept), len(kept) : n] = 0


@compiled
def mark_local(counts: Counts, n: int, features: IntArray) -> BoolArray:
    """(n,) whether each feature is one of `features` (j,) or a neighbour of one; UNPAIRED among them is skipped, and
    without counts, (0, 0), all n are local."""
    local = np.full(n, len(counts) == 0)
    for f in features:
        if f >= 0 and len(counts) > 0:
            for j in range(n):
                local[j] |= counts[f, j] > 0
            local[f] = True
    return local


@compiled
def among(counts: Counts, features: IntArray) -> BoolArray:
    """(j, j) whether each two of `features` (j,) are neighbours or the same; symmetric."""
    out = np.empty((len(features), len(features)), np.bool_)
    for i in range(len(features)):
        for j in range(len(features)):
            out[i, j] = features[i] == features[j] or counts[features[i], features[j]] > 0
    return out
