"""CCDA: relocation through the graph of consistent pairings (Bailey, 2002), by its maximum clique.

Nodes are the pairings that pass the unary constraints, edges join those that satisfy the binary one and are local to
each other. A hypothesis all of whose pairings agree is a clique. Unlike in the tree, *every* pairing must be local to
every other, and the joint test comes after: where no largest clique passes it, mirror images among them, pairings are
dropped one by one until the rest does.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Iterator
from importlib.util import find_spec

import networkx as nx
import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.relocation.answer import Best, decide, location_gates, nothing_found, offer, relocation
from slam_gym.association.relocation.constraints import Path, binary_test
from slam_gym.association.relocation.location import locate_pairings
from slam_gym.association.relocation.tree import BINARY, JOINT, LEAVES, LIMIT, NODES, UNARY, Problem, problem_of
from slam_gym.types import Array, IntArray, Landmarks, Locality, Relocation, Scan

_CLIQUES = 256  # largest cliques looked at
_MAXIMAL = 200_000  # maximal cliques that networkx goes through


def max_clique(
    scan: Scan,
    landmarks: Landmarks,
    locality: Locality | None = None,
    *,
    confidence: float = 0.99,
    min_pairings: int | None = None,
    node_limit: int = 20_000,
) -> Relocation:
    """The largest cliques of the graph of consistent pairings; of those that are jointly compatible, the least D².

    They are found by igraph where it is installed, and otherwise by networkx, which takes some hundred times as long.
    Where the graph has more than `node_limit` nodes it is not built: nothing is found, and `effort.limit_hit` says so;
    likewise where there are more than 256 largest cliques, of which the others are not looked at, and where networkx
    has gone through 200 000 maximal ones. Raises ValueError as `gcbb` does.
    """
    start, problem = time.perf_counter(), problem_of(scan, landmarks, locality, confidence)
    pairings, edges = _consistent(problem, node_limit)
    cliques, complete = largest_cliques(edges)
    if not complete:
        problem.effort[LIMIT] = 1
    members = np.sort(cliques, axis=1)
    hypotheses = Path(pairings.measurements[members], pairings.features[members])
    gates = location_gates(len(scan), confidence)
    found = decide(_best_of(problem, hypotheses, gates), gates[-1])
    seconds = time.perf_counter() - start
    return relocation(scan, landmarks, found, problem.effort, seconds, confidence=confidence, min_pairings=min_pairings)


def largest_cliques(edges: IntArray) -> tuple[IntArray, bool]:
    """The cliques (k, size) of most vertices in a graph of edges (e, 2), 256 of them at most; whether these are all."""
    if not len(edges):
        return np.empty((0, 0), np.int64), True
    if find_spec("igraph") is not None:
        import igraph

        found, complete = igraph.Graph(edges=edges).largest_cliques(), True
    else:
        found, complete = _longest(nx.find_cliques(nx.Graph(edges.tolist())))
    return np.array(found[:_CLIQUES], np.int64), complete and len(found) <= _CLIQUES


def _longest(cliques: Iterator[list[int]]) -> tuple[list[list[int]], bool]:
    """Those of most vertices among the first `_MAXIMAL` cliques; whether there are no more of them."""
    first = list(itertools.islice(cliques, _MAXIMAL))
    most = max(map(len, first))
    return [clique for clique in first if len(clique) == most], next(cliques, None) is None


@compiled
def _consistent(problem: Problem, node_limit: int) -> tuple[Path, IntArray]:
    """Pairings that pass the unary constraints, and edges (e, 2) between those that agree.

    Without edges where there would be too many nodes.
    """
    scan, where, effort = problem.scan, problem.where, problem.effort
    (m, n), number, nodes = where.allowed.shape, np.full(where.allowed.shape, -1), 0
    effort[UNARY] += m * n
    pairings = Path(np.empty(m * n, np.int64), np.empty(m * n, np.int64))
    for i in range(m):
        for j in range(n):
            if where.allowed[i, j]:
                pairings.measurements[nodes], pairings.features[nodes], number[i, j] = i, j, nodes
                nodes += 1
    effort[NODES] = nodes
    edges, count = np.empty((1024, 2), np.int64), 0
    if nodes > node_limit:
        effort[LIMIT] = 1
        nodes = 0
    for a in range(nodes):
        i, j = pairings.measurements[a], pairings.features[a]
        begin, end = (where.starts[j], where.starts[j + 1]) if len(where.starts) > 0 else (0, n)
        for k in range(i + 1, m):
            for position in range(begin, end):
                l = where.members[position] if len(where.starts) > 0 else position
                if l == j or number[k, l] < 0:
                    continue
                effort[BINARY] += 1
                if not binary_test(scan, problem.mapped, problem.gates, i, j, k, l):
                    continue
                if count == len(edges):
                    edges = np.concatenate((edges, edges))
                edges[count, 0], edges[count, 1] = a, number[k, l]
                count += 1
    return pairings, edges[:count]


@compiled
def _best_of(problem: Problem, hypotheses: Path, gates: Array) -> Best:
    """The best of the hypotheses, one a row of each array; where none holds, of what they shrink to."""
    best, holds = nothing_found(len(problem.where.allowed)), False
    for c in range(len(hypotheses.features)):
        problem.effort[LEAVES] += 1
        path = Path(hypotheses.measurements[c].copy(), hypotheses.features[c].copy())
        holds = offer(best, problem, path, len(path.features), gates) or holds
    for c in range(len(hypotheses.features) if not holds else 0):
        path = Path(hypotheses.measurements[c].copy(), hypotheses.features[c].copy())
        while len(path.features) > 2 and not offer(best, problem, path, len(path.features), gates):
            path = _without_the_worst(problem, path)
        if len(path.features) == 2:
            offer(best, problem, path, 2, gates)
    return best


@compiled
def _without_the_worst(problem: Problem, path: Path) -> Path:
    """The pairings without the one whose absence leaves the least D²."""
    scan, pose, covariance, least = problem.scan, np.empty(3), np.empty((3, 3)), math.inf
    kept = path
    for a in range(len(path.features)):
        problem.effort[JOINT] += 1
        rest, k = Path(np.delete(path.measurements, a), np.delete(path.features, a)), len(path.features) - 1
        distance = locate_pairings(scan.points, scan.noise, problem.mapped, rest, k, pose, covariance)
        if distance < least or a == 0:
            least, kept = min(distance, least), rest
    return kept
