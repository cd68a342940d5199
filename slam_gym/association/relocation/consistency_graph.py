"""CCDA: relocation through the graph of consistent pairings (Bailey, 2002), by maximum clique or its relaxation.

Nodes are the pairings that pass the unary constraints, edges join those that satisfy the binary one and are local to
each other. A hypothesis all of whose pairings agree is a clique. Unlike in the tree, *every* pairing must be local to
every other, and the joint test comes after: where no largest clique passes it, mirror images among them, pairings are
dropped one by one until the rest does.
"""

from __future__ import annotations

import math
import time
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.linalg import eigsh

from slam_gym._compile import compiled
from slam_gym.association.relocation.answer import (
    Found,
    decide,
    location_gates,
    nothing_found,
    offer,
    relocation,
)
from slam_gym.association.relocation.cliques import largest_cliques
from slam_gym.association.relocation.constraints import Path, binary_test, difference_covariance, far_apart
from slam_gym.association.relocation.location import locate_pairings
from slam_gym.association.relocation.tree import BINARY, JOINT, LEAVES, LIMIT, NODES, UNARY, Problem, problem_of
from slam_gym.types import Array, IntArray, Landmarks, Locality, Relocation, Scan

_CLIQUES = 256  # largest cliques looked at
_BRANCHES = 1_000_000  # of the search for cliques
_LEAST_WEIGHT = 1e-100  # of some edge, without which no vector leads: squares of less vanish


class _Graph(NamedTuple):
    """The graph of consistent pairings."""

    measurements: IntArray  # (v,) of each node
    features: IntArray  # (v,)
    edges: IntArray  # (e, 2) nodes, the lesser first
    weights: Array  # (e,) exp(−D²/2) of the two distances' difference


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

    Where the graph has more than `node_limit` nodes it is not built: nothing is found, and `effort.limit_hit` says so;
    likewise where there are more than 256 largest cliques, of which the others are not looked at, and where the search
    for them takes a million branches. Raises ValueError as `gcbb` does.
    """
    start, problem = time.perf_counter(), problem_of(scan, landmarks, locality, confidence)
    graph = _consistent(problem, node_limit)
    cliques = largest_cliques(graph.edges, len(graph.features), len(scan), _CLIQUES, _BRANCHES)
    if not cliques.complete:
        problem.effort[LIMIT] = 1
    found = _decide(problem, graph, cliques.members, confidence)
    seconds = time.perf_counter() - start
    return relocation(scan, landmarks, found, problem.effort, seconds, confidence=confidence, min_pairings=min_pairings)


def spectral(
    scan: Scan,
    landmarks: Landmarks,
    locality: Locality | None = None,
    *,
    confidence: float = 0.99,
    min_pairings: int | None = None,
    node_limit: int = 20_000,
) -> Relocation:
    """The cluster of most consistent pairings: a spectral relaxation of the maximum clique.

    As in SCGP (Olson et al., RSS 2005) and Leordeanu and Hebert (ICCV 2005): the leading eigenvector of the affinities
    exp(−D²/2), D² the squared difference of two distances over its variance, says how much each pairing agrees with the
    others. Pairings are taken from its largest entry down as long as they agree with all taken before. One hypothesis
    is found, so nothing is known of ties. Limits and errors as in `max_clique`.
    """
    start, problem = time.perf_counter(), problem_of(scan, landmarks, locality, confidence)
    graph = _consistent(problem, node_limit)
    found = _decide(problem, graph, _leading_cluster(graph), confidence)
    seconds = time.perf_counter() - start
    return relocation(scan, landmarks, found, problem.effort, seconds, confidence=confidence, min_pairings=min_pairings)


def _leading_cluster(graph: _Graph) -> IntArray:
    """One hypothesis from the leading eigenvector (1, k), or none (0, 0)."""
    v, (a, b) = len(graph.features), graph.edges.T
    if graph.weights.max(initial=0.0) < _LEAST_WEIGHT:
        return np.empty((0, 0), np.int64)
    affinity: csr_array = coo_array((graph.weights, (a, b)), shape=(v, v)).tocsr()
    affinity = affinity + affinity.T
    agreement = np.abs(eigsh(affinity, k=1, which="LA", v0=np.ones(v))[1][:, 0]) if v > 2 else np.ones(v)
    alive, cluster = agreement > 0.0, []
    while alive.any():
        node = int(np.argmax(np.where(alive, agreement, -1.0)))
        cluster.append(node)
        neighbours = np.zeros(v, np.bool_)
        neighbours[affinity.indices[affinity.indptr[node] : affinity.indptr[node + 1]]] = True
        alive &= neighbours
    return np.array([cluster])


def _decide(problem: Problem, graph: _Graph, cliques: IntArray, confidence: float) -> Found:
    """The best of the cliques (c, k) that are jointly compatible, or of what is left of them."""
    members = np.sort(cliques, axis=1)
    pairings = Path(graph.measurements[members], graph.features[members])
    return _best_of(problem, pairings, location_gates(len(problem.where.allowed), confidence))


@compiled
def _consistent(problem: Problem, node_limit: int) -> _Graph:
    """The graph; without edges where there would be too many nodes."""
    scan, mapped, allowed, effort = problem.scan, problem.mapped, problem.where.allowed, problem.effort
    (m, n), number = allowed.shape, np.full(allowed.shape, -1)
    effort[UNARY] += m * n
    measurements, features, nodes = np.empty(m * n, np.int64), np.empty(m * n, np.int64), 0
    for i in range(m):
        for j in range(n):
            if allowed[i, j]:
                measurements[nodes], features[nodes], number[i, j] = i, j, nodes
                nodes += 1
    effort[NODES] = nodes
    edges, weights, count = np.empty((1024, 2), np.int64), np.empty(1024), 0
    if nodes > node_limit:
        effort[LIMIT] = 1
        nodes = 0
    positions, traces, starts, members = (
        mapped.positions,
        problem.where.traces,
        problem.where.starts,
        problem.where.members,
    )
    for a in range(nodes):
        i, j = measurements[a], features[a]
        begin, end = (starts[j], starts[j + 1]) if len(starts) > 0 else (0, n)
        for k in range(i + 1, m):
            distance, spread = scan.distances[i, k], scan.spreads[i, k]
            for position in range(begin, end):
                l = members[position] if len(starts) > 0 else position
                if l == j or number[k, l] < 0:
                    continue
                effort[BINARY] += 1
                x, y = positions[l, 0] - positions[j, 0], positions[l, 1] - positions[j, 1]
                error = distance - math.sqrt(x * x + y * y)
                if far_apart(error, spread, traces[j], traces[l], problem.gates.two):
                    continue
                if not binary_test(scan, mapped, problem.gates, i, j, k, l):
                    continue
                if count == len(weights):
                    edges, weights = np.concatenate((edges, edges)), np.concatenate((weights, weights))
                edges[count, 0], edges[count, 1] = a, number[k, l]
                xx, xy, yy = difference_covariance(mapped, j, l)
                along = (x * x * xx + 2.0 * x * y * xy + y * y * yy) / max(x * x + y * y, 1e-300)
                variance = scan.variances[i, k] + max(along, 0.0) + 1e-12
                weights[count] = math.exp(-0.5 * error * error / variance)
                count += 1
    return _Graph(measurements[:nodes], features[:nodes], edges[:count], weights[:count])


@compiled
def _best_of(problem: Problem, pairings: Path, gates: Array) -> Found:
    """The best of the hypotheses, one a row of `pairings`; where none holds, of what they shrink to."""
    best, holds = nothing_found(len(problem.where.allowed)), False
    for c in range(len(pairings.features)):
        problem.effort[LEAVES] += 1
        path = Path(pairings.measurements[c].copy(), pairings.features[c].copy())
        holds = offer(best, problem, path, len(path.features), gates) or holds
    for c in range(len(pairings.features) if not holds else 0):
        path = Path(pairings.measurements[c].copy(), pairings.features[c].copy())
        while len(path.features) > 2 and not offer(best, problem, path, len(path.features), gates):
            path = _without_the_worst(problem, path)
        if len(path.features) == 2:
            offer(best, problem, path, 2, gates)
    return decide(best, gates[len(gates) - 1])


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
