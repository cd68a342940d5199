"""The largest cliques of a sparse graph: branch and bound with colours, on sets of bits.

Vertices come in the order of their degrees, the largest first, and each is the last member of its cliques: the subgraph
of its neighbours that came before it is small where the graph is sparse. A set of vertices that falls into k
independent classes holds no clique of more than k, which bounds the branches (Tomita and Seki, DMTCS 2003; classes in
sets of bits as in San Segundo et al., Computers & Operations Research 2011).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.types import IntArray


class Cliques(NamedTuple):
    """The largest cliques that were found."""

    members: IntArray  # (k, size) vertices, one clique a row
    complete: bool  # these are all; False: there are more, or the limit on branches ended the search


class _Subgraph(NamedTuple):
    """A part of the graph, its rows as sets of bits."""

    vertices: IntArray  # (p,) of the whole graph
    rows: IntArray  # (p, words) neighbours among `vertices`


class _Search(NamedTuple):
    """What was found, and room to work in."""

    best: IntArray  # (most, deepest) cliques found
    state: IntArray  # (3,) their size, their number, the branches still allowed
    path: IntArray  # (deepest,) the clique that is tried


_SIZE, _COUNT, _LEFT = range(3)


@compiled
def largest_cliques(edges: IntArray, vertices: int, deepest: int, most: int, branches: int) -> Cliques:
    """The cliques of largest size, of two vertices and more.

    `edges` is (e, 2), each once; no clique has more than `deepest` vertices. At most `most` of them are given, and the
    search ends after `branches`.
    """
    starts, neighbours = _adjacency(edges, vertices)
    order = np.argsort(starts[:-1] - starts[1:], kind="mergesort")  # the largest degree first
    place = np.empty(vertices, np.int64)
    place[order] = np.arange(vertices)
    search = _Search(np.empty((most, deepest), np.int64), np.array([2, 0, branches]), np.empty(deepest, np.int64))
    local = np.full(vertices, -1)
    for v in order:
        before = neighbours[starts[v] : starts[v + 1]]
        before = before[place[before] < place[v]]
        if len(before) + 1 < search.state[_SIZE]:
            continue
        search.path[0] = v
        _branch(_subgraph(before, starts, neighbours, local), search, most)
    found = min(search.state[_COUNT], most)
    complete = search.state[_COUNT] <= most and search.state[_LEFT] > 0
    return Cliques(search.best[:found, : search.state[_SIZE]].copy(), complete)


@compiled
def _adjacency(edges: IntArray, vertices: int) -> tuple[IntArray, IntArray]:
    """Starts (v + 1,) and neighbours (2e,) of each vertex."""
    starts = np.zeros(vertices + 1, np.int64)
    for e in range(len(edges)):
        starts[edges[e, 0] + 1] += 1
        starts[edges[e, 1] + 1] += 1
    starts = np.cumsum(starts)
    neighbours, filled = np.empty(2 * len(edges), np.int64), starts[:-1].copy()
    for e in range(len(edges)):
        for side in range(2):
            a = edges[e, side]
            neighbours[filled[a]] = edges[e, 1 - side]
            filled[a] += 1
    return starts, neighbours


@compiled
def _subgraph(chosen: IntArray, starts: IntArray, neighbours: IntArray, local: IntArray) -> _Subgraph:
    """The graph among `chosen`; `local` (v,) is room, −1 everywhere."""
    rows = np.zeros((len(chosen), (len(chosen) + 62) // 63), np.int64)
    for a in range(len(chosen)):
        local[chosen[a]] = a
    for a in range(len(chosen)):
        for position in range(starts[chosen[a]], starts[chosen[a] + 1]):
            b = local[neighbours[position]]
            if b >= 0:
                rows[a, b // 63] |= np.int64(1) << (b % 63)
    for a in range(len(chosen)):
        local[chosen[a]] = -1
    return _Subgraph(chosen, rows)


@compiled
def _branch(part: _Subgraph, search: _Search, most: int) -> None:
    """All cliques of path[0] and vertices of `part` that are as large as the best."""
    (p, words), deepest = part.rows.shape, len(search.path)
    candidates, order, colours = (
        np.zeros((deepest + 1, words), np.int64),
        np.empty((deepest + 1, p), np.int64),
        np.empty((deepest + 1, p), np.int64),
    )
    left = np.zeros(deepest + 1, np.int64)  # vertices of `order` not tried yet, by depth
    for a in range(p):
        candidates[1, a // 63] |= np.int64(1) << (a % 63)
    depth = 1
    left[1] = _coloured(part, candidates[1], order[1], colours[1])
    while depth > 0:
        left[depth] -= 1
        size, enough = search.state[_SIZE], search.state[_SIZE] + (search.state[_COUNT] > most)
        if left[depth] < 0 or depth + colours[depth, left[depth]] < enough or search.state[_LEFT] <= 0:
            depth -= 1
            continue
        search.state[_LEFT] -= 1
        a = order[depth, left[depth]]
        candidates[depth, a // 63] &= ~(np.int64(1) << (a % 63))
        search.path[depth] = part.vertices[a]
        depth += 1
        if depth >= size:
            _keep(search, depth, most)
        if depth == deepest:
            depth -= 1
            continue
        for word in range(words):
            candidates[depth, word] = candidates[depth - 1, word] & part.rows[a, word]
        left[depth] = _coloured(part, candidates[depth], order[depth], colours[depth])


@compiled
def _keep(search: _Search, size: int, most: int) -> None:
    """The clique on the path, which is as large as the best, or larger."""
    if size > search.state[_SIZE]:
        search.state[_SIZE], search.state[_COUNT] = size, 0
    if search.state[_COUNT] < most:
        search.best[search.state[_COUNT], :size] = search.path[:size]
    search.state[_COUNT] += 1


@compiled
def _coloured(part: _Subgraph, candidates: IntArray, order: IntArray, colours: IntArray) -> int:
    """Fill in the candidates by independent classes 1, 2, …, and the class of each; the number of candidates."""
    (p, words), count, colour = part.rows.shape, 0, 0
    uncoloured, free = candidates.copy(), np.empty(words, np.int64)
    while uncoloured.any():
        colour += 1
        free[:] = uncoloured
        for a in range(p):
            if free[a // 63] >> (a % 63) & 1:
                uncoloured[a // 63] &= ~(np.int64(1) << (a % 63))
                for word in range(words):
                    free[word] &= ~part.rows[a, word]
                order[count], colours[count] = a, colour
                count += 1
    return count
