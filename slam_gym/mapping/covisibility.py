"""The covisibility graph: which features were seen together, and how often.

Two features are covisible when one scan saw both. Neighbours make a better locality than distance, since features close
to each other on two sides of a wall are never seen together (Neira, Tardós and Castellanos 2003).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.types import UNPAIRED, BoolArray, IntArray

_ROOM, _WIDTH = 64, 16  # initial capacity: nodes, and neighbours of each


class Edges(NamedTuple):
    """Pairs of features that were seen together."""

    pairs: IntArray  # (e, 2) i < j
    counts: IntArray  # (e,) number of scans that saw both


class CovisibilityGraph:
    """Undirected graph over the features 0 … n−1 of a map, with a count on each edge.

    Row j of the adjacency holds the neighbours of j in ascending order, so memory is nodes × largest degree. Features
    are indices as in the map; `add` and `keep` are called where the map adds and removes features.
    """

    def __init__(self) -> None:
        self.n = 0
        self._neighbours = np.zeros((_ROOM, _WIDTH), np.int64)
        self._counts = np.zeros((_ROOM, _WIDTH), np.int64)
        self._degrees = np.zeros(_ROOM, np.int64)

    @property
    def arrays(self) -> tuple[IntArray, IntArray, IntArray]:
        """Neighbours and counts (≥ n, width) and degrees (≥ n,) for compiled functions, without copying."""
        return self._neighbours, self._counts, self._degrees

    def learned(self, created: int) -> None:
        """Register that a compiled step has added `created` nodes to the arrays, or removed −`created`."""
        self.n += created

    def make_room(self, more: int) -> None:
        """Make room for `more` nodes, by doubling the capacity."""
        room = len(self._degrees)
        while self.n + more > room:
            room *= 2
        if room > len(self._degrees):
            rows = room - len(self._degrees)
            self._degrees = np.pad(self._degrees, (0, rows))
            self._neighbours = np.pad(self._neighbours, ((0, rows), (0, 0)))
            self._counts = np.pad(self._counts, ((0, rows), (0, 0)))

    def widen(self, needed: int) -> None:
        """Make room for at least `needed` neighbours of each node."""
        columns = max(needed, 2 * self._neighbours.shape[1]) - self._neighbours.shape[1]
        self._neighbours = np.pad(self._neighbours, ((0, 0), (0, columns)))
        self._counts = np.pad(self._counts, ((0, 0), (0, columns)))

    def add(self, count: int) -> None:
        """Append `count` nodes without edges."""
        if count < 0:
            raise ValueError(f"count: {count} is negative")
        self.make_room(count)
        self._degrees[self.n : self.n + count] = 0
        self.n += count

    def see_together(self, features: IntArray) -> None:
        """Add 1 to the count of each pair of `features` (j,) of one scan; UNPAIRED and repetitions are ignored.

        Raises ValueError where a feature is not in the graph.
        """
        features = self._existing(features, UNPAIRED)
        needed = count_pairs(self._neighbours, self._counts, self._degrees, self.n, features)
        if needed > self._neighbours.shape[1]:
            self.widen(needed)
            count_pairs(self._neighbours, self._counts, self._degrees, self.n, features)

    def keep(self, kept: IntArray) -> None:
        """Keep only the nodes `kept` (n',) (old indices, ascending), which become 0 … n'−1.

        Raises ValueError, before the graph is changed, where they are not ascending nodes of it.
        """
        kept = np.ascontiguousarray(kept, dtype=np.int64)
        if len(kept) and (kept[0] < 0 or kept[-1] >= self.n or (np.diff(kept) <= 0).any()):
            raise ValueError("kept: not the ascending indices of nodes in the graph")
        keep_nodes(self._neighbours, self._counts, self._degrees, self.n, kept)
        self.n = len(kept)

    def followed_by(self, other: CovisibilityGraph) -> CovisibilityGraph:
        """The graph of the nodes of this graph, then those of `other`, with the edges of both."""
        ours, theirs = self.edges(), other.edges()
        pairs = np.concatenate([ours.pairs, theirs.pairs + self.n])
        return graph_of(self.n + other.n, Edges(pairs, np.concatenate([ours.counts, theirs.counts])))

    def fused(self, kept: IntArray, dropped: IntArray) -> CovisibilityGraph:
        """A graph in which node kept[i] takes over the edges of dropped[i], (k,), which are removed.

        The counts of edges to a common neighbour add up; edges between kept[i] and dropped[i] are dropped.
        """
        became = np.arange(self.n)
        became[dropped] = kept
        edges = self.edges()
        pairs = np.sort(became[edges.pairs], axis=1)
        are_distinct = pairs[:, 0] != pairs[:, 1]
        pairs, edge_of = np.unique(pairs[are_distinct], axis=0, return_inverse=True)
        counts = np.bincount(edge_of.ravel(), weights=edges.counts[are_distinct], minlength=len(pairs)).astype(np.int64)
        graph = graph_of(self.n, Edges(pairs, counts))
        graph.keep(np.delete(np.arange(self.n), dropped))
        return graph

    def count(self, i: int, j: int) -> int:
        """The number of scans that saw both features. Raises IndexError where one is not in the graph."""
        if not (0 <= i < self.n and 0 <= j < self.n):
            raise IndexError(f"features {i} and {j} in a graph of {self.n}")
        neighbours = self._neighbours[i, : self._degrees[i]]
        at = int(np.searchsorted(neighbours, j))
        return int(self._counts[i, at]) if at < len(neighbours) and neighbours[at] == j else 0

    def neighbours(self, i: int) -> IntArray:
        """Features seen together with i, ascending. Raises IndexError like `count`."""
        if not 0 <= i < self.n:
            raise IndexError(f"feature {i} in a graph of {self.n}")
        return self._neighbours[i, : self._degrees[i]].copy()

    def local_to(self, features: IntArray) -> BoolArray:
        """(n,) whether each node is one of `features` or a neighbour of one. Raises ValueError as `see_together`."""
        return mark_local(self._neighbours, self._degrees, self.n, self._existing(features, UNPAIRED))

    def among(self, features: IntArray) -> BoolArray:
        """(j, j) whether each two of `features` (j,) are neighbours or the same; symmetric.

        Raises ValueError where a feature is not in the graph.
        """
        return among(self._neighbours, self._degrees, self.n, self._existing(features, 0))

    def _existing(self, features: IntArray, lowest: int) -> IntArray:
        features = np.ascontiguousarray(features, dtype=np.int64)
        if ((features < lowest) | (features >= self.n)).any():
            raise ValueError("features: not all of them are in the graph")
        return features

    def edges(self) -> Edges:
        """All edges, in ascending order."""
        filled = np.arange(self._neighbours.shape[1]) < self._degrees[: self.n, None]
        start = np.repeat(np.arange(self.n), self._degrees[: self.n])
        end, counts = self._neighbours[: self.n][filled], self._counts[: self.n][filled]
        is_ascending = start < end
        return Edges(np.column_stack([start[is_ascending], end[is_ascending]]), counts[is_ascending])


def graph_of(n: int, edges: Edges) -> CovisibilityGraph:
    """The graph of n nodes with `edges`, each listed once. Raises ValueError unless each joins two different nodes."""
    pairs = np.asarray(edges.pairs, np.int64).reshape(-1, 2)
    if np.any((pairs < 0) | (pairs >= n)) or np.any(pairs[:, 0] == pairs[:, 1]):
        raise ValueError(f"edges: not all of them join two different nodes of {n}")
    graph = CovisibilityGraph()
    graph.add(n)
    ends, others = np.concatenate([pairs, pairs[:, ::-1]]).T
    order = np.lexsort((others, ends))
    degrees = np.bincount(ends, minlength=n)
    at = np.arange(len(order)) - np.repeat(np.cumsum(degrees) - degrees, degrees)
    width = max(int(degrees.max(initial=0)), _WIDTH)
    graph._neighbours, graph._counts = (np.zeros((len(graph._degrees), width), np.int64) for _ in range(2))
    graph._neighbours[ends[order], at] = others[order]
    graph._counts[ends[order], at] = np.concatenate([edges.counts, edges.counts])[order]
    graph._degrees[:n] = degrees
    return graph


@compiled
def count_pairs(neighbours: IntArray, counts: IntArray, degrees: IntArray, n: int, features: IntArray) -> int:
    """Count each pair of `features`; returns the row width needed. If the rows are narrower, nothing is counted."""
    seen, k, needed = np.empty(len(features), np.int64), 0, 0
    for f in features:
        at = k
        while at > 0 and seen[at - 1] > f:  # insertion sort, dropping UNPAIRED and repetitions
            at -= 1
        if f == UNPAIRED or (at > 0 and seen[at - 1] == f):
            continue
        for later in range(k, at, -1):
            seen[later] = seen[later - 1]
        seen[at] = f
        k += 1
    for i in range(k):
        needed = max(needed, degrees[seen[i]] + k - 1)
    if needed > neighbours.shape[1]:
        return needed
    for i in range(k):
        f = seen[i]
        degrees[f] = _merge(neighbours[f], counts[f], degrees[f], f, seen[:k])
    return needed


@compiled
def _merge(neighbours: IntArray, counts: IntArray, degree: int, f: int, seen: IntArray) -> int:
    """Count `seen` (ascending), except f, in the ascending row of f; returns the new degree of f."""
    added, at = 0, 0
    for g in seen:
        while at < degree and neighbours[at] < g:
            at += 1
        if at < degree and neighbours[at] == g:
            counts[at] += 1
        elif g != f:
            added += 1
    # insert new neighbours from the right, so that nothing is overwritten before it has moved
    read, write, s = degree - 1, degree + added - 1, len(seen) - 1
    while write > read:
        if seen[s] == f or (read >= 0 and neighbours[read] == seen[s]):
            s -= 1
        elif read >= 0 and neighbours[read] > seen[s]:
            neighbours[write], counts[write] = neighbours[read], counts[read]
            read, write = read - 1, write - 1
        else:
            neighbours[write], counts[write] = seen[s], 1
            s, write = s - 1, write - 1
    return degree + added


@compiled
def keep_nodes(neighbours: IntArray, counts: IntArray, degrees: IntArray, n: int, kept: IntArray) -> None:
    """`CovisibilityGraph.keep`, in place."""
    renumbered = np.full(n, UNPAIRED)
    for i in range(len(kept)):
        renumbered[kept[i]] = i
    for i in range(len(kept)):
        old, degree = kept[i], 0
        for at in range(degrees[old]):
            new = renumbered[neighbours[old, at]]
            if new >= 0:
                neighbours[i, degree], counts[i, degree] = new, counts[old, at]
                degree += 1
        degrees[i] = degree


@compiled
def mark_local(neighbours: IntArray, degrees: IntArray, n: int, features: IntArray) -> BoolArray:
    """`CovisibilityGraph.local_to`; if the graph's arrays are empty, all n features are local."""
    local = np.full(n, len(neighbours) == 0)
    if len(neighbours) == 0:
        return local
    for f in features:
        if f >= 0:
            local[f] = True
            for at in range(degrees[f]):
                local[neighbours[f, at]] = True
    return local


@compiled
def among(neighbours: IntArray, degrees: IntArray, n: int, features: IntArray) -> BoolArray:
    """`CovisibilityGraph.among`."""
    m = len(features)
    out = np.zeros((m, m), np.bool_)
    local = np.zeros(n, np.bool_)
    for i in range(m):
        f = features[i]
        local[f] = True
        for at in range(degrees[f]):
            local[neighbours[f, at]] = True
        for j in range(m):
            out[i, j] = local[features[j]]
        local[f] = False
        for at in range(degrees[f]):
            local[neighbours[f, at]] = False
    return out
