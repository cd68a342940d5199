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
from slam_gym.bench.records import Record, means, medians
from slam_gym.bench.timing import PROCESS, THREAD, Timed, fastest, timed
from slam_gym.types import UNPAIRED, Array, IntArray, Landmarks, Scan

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


Clique = Callable[[IntArray, int], Timed[list[int]]]
PEERS: dict[str, Clique] = {"igraph": igraph_clique}


def installed() -> list[str]:
    """Peers that are there."""
    return [name for name in PEERS if find_spec(name) is not None]


def agreement(
    sizes: Iterable[int], queries: int, peers: Sequence[str], limit: float, rng: np.random.Generator
) -> list[Record]:
    """Success (accepted or not) and time of the index beside the exact cliques; ratio: clique alone / index.

    A peer stops once a row has taken it `limit` seconds.
    """
    rows = []
    for n in sizes:
        truth, landmarks = point_map(n, rng)
        index, pairs = FeatureIndex(landmarks), pairs_by_length(landmarks)
        for kind in _KINDS:
            drawn = [query(truth, kind, rng) for _ in range(queries)]
            found = [by_index(index, one) for one in drawn]
            row = {
                "n": n,
                **kind.row,
                **means(found, "index", "accepted", "wrong", "ambiguous"),
                **medians(found, "ms"),
            }
            for name, clique in ((name, PEERS[name]) for name in peers):
                row |= beside(name, by_cliques(clique, drawn, landmarks, pairs, limit), found)
            rows.append(row)
    return rows


def by_index(index: FeatureIndex, one: Query) -> Record:
    """What the index makes of a scan."""
    answer, ms = index.relocate(one.scan), 1e-3 * fastest(index.relocate, one.scan, repeats=3, clock=THREAD)
    right = NEAR.holds(answer.pose, one.pose)
    verdict = {"accepted": answer.accepted, "wrong": answer.accepted and not right, "ambiguous": answer.ambiguous}
    return {"index": right, **verdict, "ms": ms}


def by_cliques(
    clique: Clique, asked: Sequence[Query], landmarks: Landmarks, pairs: PairsByLength, limit: float
) -> list[Record]:
    """What a peer makes of the scans that it has the time for."""
    records: list[Record] = []
    for one in asked:
        if sum(record["ms"] for record in records) > 1e3 * limit:
            break
        edges, building = timed(consistency_edges, one.scan, pairs, len(landmarks), clock=PROCESS)
        vertices, microseconds = clique(edges, len(one.scan) * len(landmarks))
        decisions = np.full(len(one.scan), UNPAIRED)
        for vertex in vertices:
            decisions[vertex // len(landmarks)] = vertex % len(landmarks)
        right = NEAR.holds(locate(one.scan, landmarks, decisions).pose, one.pose)
        records.append({"right": right, "ms": 1e-3 * microseconds, "graph ms": 1e-3 * building})
    return records


def beside(name: str, records: Sequence[Record], of_index: Sequence[Record]) -> Record:
    """Figures of a peer, and of the index on the same scans."""
    clique, index = medians(records, "ms")["ms"], medians(of_index, "ms")["ms"]
    return {
        **{name: means(records, "right")["right"], f"{name}: scans": len(records)},
        f"{name}: index on those": means(of_index[: len(records)], "index")["index"],
        **{f"{name}: ms": clique, **medians(records, "graph ms"), f"{name}: ratio": clique / index},
    }
