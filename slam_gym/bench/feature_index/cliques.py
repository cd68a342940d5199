"""The feature index beside exact maximum cliques, on the same scans.

A peer finds the maximum clique of the graph of binary-consistent pairings (distances within the .99 gate), which is
built here in numpy, from the pairs of features sorted by length once per map, and timed apart from the clique itself.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Iterable, Sequence
from importlib.util import find_spec
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from slam_gym.association.relocation.location import locate
from slam_gym.association.triangles.index import FeatureIndex
from slam_gym.bench.feature_index.problems import NEAR, SIGMA, Query, QueryKind, point_map, query
from slam_gym.bench.records import Record
from slam_gym.bench.timing import PROCESS, THREAD, Timed, fastest, timed
from slam_gym.types import UNPAIRED, Array, IntArray, Landmarks, Relocation, Scan

_KINDS = [QueryKind(m, s, half) for m in (10, 20) for s in (0.0, 0.3, 0.5) for half in (False, True)]


class PairsByLength(NamedTuple):
    """All ordered pairs of features, by the distance between them."""

    lengths: Array  # (p,) [m] ascending
    first: IntArray  # (p,)
    second: IntArray  # (p,)


def pairs_by_length(landmarks: Landmarks) -> PairsByLength:
    """Once per map."""
    F = landmarks.positions
    j, l = np.nonzero(~np.eye(len(F), dtype=bool))
    apart = np.hypot(*(F[j] - F[l]).T)
    order = np.argsort(apart)
    return PairsByLength(apart[order], j[order], l[order])


def consistency_edges(scan: Scan, pairs: PairsByLength, n: int) -> IntArray:
    """Edges (e, 2) between pairings i·n + j that agree in distance within the .99 gate; errors alike for all."""
    z, gate, edges = scan.points, math.sqrt(chdtri(1, 0.01) * 4.0 * SIGMA**2), []
    for i in range(len(z)):
        for k in range(i):
            length = np.hypot(*(z[i] - z[k]))
            low, high = np.searchsorted(pairs.lengths, (length - gate, length + gate))
            edges.append(np.column_stack([i * n + pairs.first[low:high], k * n + pairs.second[low:high]]))
    return np.concatenate(edges)


def igraph_clique(edges: IntArray, vertices: int) -> Timed[list[int]]:
    """One of igraph's largest_cliques, on a graph already built."""
    graph = importlib.import_module("igraph").Graph(vertices, edges)
    found, microseconds = timed(graph.largest_cliques, clock=PROCESS)
    return Timed(list(found[0]), microseconds)


def cliquematch_clique(edges: IntArray, vertices: int) -> Timed[list[int]]:
    """cliquematch's get_max_clique, on a graph already built."""
    edges = np.ascontiguousarray(edges + 1, np.uint64)
    graph = importlib.import_module("cliquematch").Graph.from_edgelist(edges, vertices)
    found, microseconds = timed(graph.get_max_clique, clock=PROCESS)
    return Timed([int(v) - 1 for v in found], microseconds)


Clique = Callable[[IntArray, int], Timed[list[int]]]
PEERS: dict[str, Clique] = {"igraph": igraph_clique, "cliquematch": cliquematch_clique}


def installed() -> list[str]:
    """Peers that are there."""
    return [name for name in PEERS if find_spec(name) is not None]


class Graphs:
    """Consistency graphs of some queries, each built when it is first asked for."""

    def __init__(self, landmarks: Landmarks, asked: list[Query]) -> None:
        self._n, self._asked, self._built = len(landmarks), asked, dict[int, Timed[IntArray]]()
        self._pairs = pairs_by_length(landmarks)

    def __getitem__(self, q: int) -> Timed[IntArray]:
        """Edges of query number q."""
        if q not in self._built:
            self._built[q] = timed(consistency_edges, self._asked[q].scan, self._pairs, self._n, clock=PROCESS)
        return self._built[q]


class Asked(NamedTuple):
    """Queries in one map, and what the index made of them."""

    landmarks: Landmarks
    queries: list[Query]
    answers: list[Relocation]
    microseconds: float  # of the index, median


def agreement(
    sizes: Iterable[int], queries: int, peers: Sequence[str], limit: float, rng: np.random.Generator
) -> list[Record]:
    """Success (accepted or not) and time of the index beside the exact cliques; ratio: clique alone / index.

    A peer stops once a row has taken it `limit` seconds.
    """
    rows = []
    for n in sizes:
        truth, landmarks = point_map(n, rng)
        index = FeatureIndex(landmarks)
        for kind in _KINDS:
            drawn = [query(truth, kind, rng) for _ in range(queries)]
            times = [fastest(index.relocate, one.scan, repeats=3, clock=THREAD) for one in drawn]
            asked = Asked(landmarks, drawn, [index.relocate(one.scan) for one in drawn], float(np.median(times)))
            row, graphs = {"n": n, **kind.row, **index_figures(asked)}, Graphs(landmarks, drawn)
            for name in peers:
                row |= beside(name, asked, graphs, limit)
            rows.append(row)
    return rows


def index_figures(asked: Asked) -> Record:
    """Of the index, over all queries."""
    right = [NEAR.holds(a.pose, one.pose) for a, one in zip(asked.answers, asked.queries)]
    return {
        "index": float(np.mean(right)),
        "accepted": float(np.mean([a.accepted for a in asked.answers])),
        "wrong": float(np.mean([a.accepted and not r for a, r in zip(asked.answers, right)])),
        "ambiguous": float(np.mean([a.ambiguous for a in asked.answers])),
        "index ms": 1e-3 * asked.microseconds,
    }


def beside(name: str, asked: Asked, graphs: Graphs, limit: float) -> Record:
    """Of a peer, over the queries that it had the time for."""
    spent, right, times, graph_times = 0.0, [], [], []
    for q, one in enumerate(asked.queries):
        if spent > limit:
            break
        clique, microseconds = PEERS[name](graphs[q].answer, len(one.scan) * len(asked.landmarks))
        spent += 1e-6 * microseconds
        pose = locate(one.scan, asked.landmarks, _decisions(clique, one.scan, asked.landmarks)).pose
        right.append(NEAR.holds(pose, one.pose))
        times.append(microseconds)
        graph_times.append(graphs[q].microseconds)
    ours = [NEAR.holds(a.pose, one.pose) for a, one in zip(asked.answers, asked.queries)][: len(right)]
    return {
        name: float(np.mean(right)),
        f"{name}: scans": len(right),
        f"{name}: index on those": float(np.mean(ours)),
        f"{name}: ms": 1e-3 * float(np.median(times)),
        "graph ms": 1e-3 * float(np.median(graph_times)),
        f"{name}: ratio": float(np.median(times)) / asked.microseconds,
    }


def _decisions(clique: list[int], scan: Scan, landmarks: Landmarks) -> IntArray:
    decisions = np.full(len(scan), UNPAIRED)
    for vertex in clique:
        decisions[vertex // len(landmarks)] = vertex % len(landmarks)
    return decisions
