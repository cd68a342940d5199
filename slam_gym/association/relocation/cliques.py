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

import networkx as nx
import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.acceptance import min_pairings as by_rule
from slam_gym.association.relocation.answer import Best, answer_of, nothing_found, offer
from slam_gym.association.relocation.constraints import Path, binary_test
from slam_gym.association.relocation.location import locate_pairings
from slam_gym.association.relocation.tree import BINARY, JOINT, LEAVES, LIMIT, NODES, UNARY, Problem, problem_of
from slam_gym.types import IntArray, Landmarks, Locality, Relocation, Scan

_CLIQUES = 256  # largest cliques looked at
_MAXIMAL = 20_000  # maximal cliques gone through: their number may grow exponentially with the nodes
_EDGES = 1_000_000


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

    A graph of more than `node_limit` nodes or a million edges is not built, and nothing is found. Of the maximal
    cliques 20 000 are gone through, and of the largest among these 256 are tested. `effort.limit_hit` says where one
    of these limits was met. Raises ValueError as `gcbb` does.
    """
    began, problem = time.perf_counter(), problem_of(scan, landmarks, locality, confidence)
    pairings, edges = _consistent(problem, node_limit)
    cliques, complete = largest_cliques(edges)
    if not complete:
        problem.effort[LIMIT] = 1
    members = np.sort(cliques, axis=1)
    best = _best_of(problem, Path(pairings.measurements[members], pairings.features[members]))
    if min_pairings is None:
        min_pairings = by_rule(scan, landmarks, confidence=confidence)
    return answer_of(best, problem, min_pairings, time.perf_counter() - began)


def largest_cliques(edges: IntArray) -> tuple[IntArray, bool]:
    """The cliques (k, size) of most vertices in a graph of edges (e, 2), as far as looked at; whether these are all."""
    if not len(edges):
        return np.empty((0, 0), np.int64), True
    maximal = nx.find_cliques(nx.Graph(edges.tolist()))
    first = list(itertools.islice(maximal, _MAXIMAL))
    complete = next(maximal, None) is None
    most = max(map(len, first))
    found = [clique for clique in first if len(clique) == most]
    return np.array(found[:_CLIQUES], np.int64), complete and len(found) <= _CLIQUES


@compiled
def _consistent(problem: Problem, node_limit: int) -> tuple[Path, IntArray]:
    """Pairings that pass the unary constraints, and edges (e, 2) between those that agree.

    Without edges where there would be too many nodes or edges.
    """
    scan, mapped, effort = problem.scan, problem.mapped, problem.effort
    allowed, starts, of_each = problem.allowed, problem.starts, problem.members
    measurements, features = np.nonzero(allowed)
    nodes, (m, n), number = len(features), allowed.shape, np.full(allowed.shape, -1)
    effort[UNARY], effort[NODES] = m * n, nodes
    edges, count = np.empty((1024, 2), np.int64), 0
    if nodes > node_limit:
        effort[LIMIT] = 1
        nodes = 0
    for a in range(nodes):
        number[measurements[a], features[a]] = a
    for a in range(nodes):
        i, j = measurements[a], features[a]
        begin, end = (starts[j], starts[j + 1]) if len(starts) > 0 else (0, n)
        for k in range(i + 1, m):
            for position in range(begin, end):
                l = of_each[position] if len(starts) > 0 else position
                if l == j or number[k, l] < 0:
                    continue
                effort[BINARY] += 1
                if not binary_test(scan, mapped, i, j, k, l):
                    continue
                if count == _EDGES:
                    effort[LIMIT] = 1
                    return Path(measurements, features), edges[:0]
                if count == len(edges):
                    edges = np.concatenate((edges, edges))
                edges[count, 0], edges[count, 1] = a, number[k, l]
                count += 1
    return Path(measurements, features), edges[:count]


@compiled
def _best_of(problem: Problem, hypotheses: Path) -> Best:
    """The best of the hypotheses, one a row of each array; where none holds, of what they shrink to."""
    best, holds = nothing_found(len(problem.allowed)), False
    for c in range(len(hypotheses.features)):
        problem.effort[LEAVES] += 1
        path = Path(hypotheses.measurements[c].copy(), hypotheses.features[c].copy())
        holds = offer(best, problem, path, len(path.features)) or holds
    for c in range(len(hypotheses.features) if not holds else 0):
        path = Path(hypotheses.measurements[c].copy(), hypotheses.features[c].copy())
        while len(path.features) > 2 and not offer(best, problem, path, len(path.features)):
            path = _without_the_worst(problem, path)
        if len(path.features) == 2:
            offer(best, problem, path, 2)
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
