"""CCDA: relocation by the maximum clique of the graph of consistent pairings (Bailey, 2002).

Nodes are the pairings that pass the unary constraints. Edges join pairings that satisfy the binary constraint and are
local to each other. A hypothesis whose pairings all agree is a clique. Two things differ from the tree: *every* pairing
must be local to every other, and the joint test comes last. Where no largest clique passes it, pairings are dropped one
by one until the rest does; mirror images are among the cliques that fail.
"""

import itertools

import networkx as nx
import numpy as np

from slam_gym.association.relocation.constraints import Path
from slam_gym.association.relocation.problem import INDEX, Best, Problem, fewest, keep_largest, searched
from slam_gym.association.relocation.tree import keep_what_follows
from slam_gym.types import IntArray, Landmarks, Locality, Relocation, Scan
from slam_gym.validation import check_count

_CLIQUES = 256  # largest cliques tested
_MAXIMAL = 20_000  # maximal cliques enumerated: their number may grow exponentially with the nodes
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
    """The jointly compatible hypothesis of least D² among the largest cliques of the graph of consistent pairings.

    A graph of more than `node_limit` nodes or a million edges is not built, and nothing is found. At most 20 000
    maximal cliques are enumerated, and at most 256 of the largest of these are tested. After `LOCATION_LIMIT` joint
    tests, no more pairings are dropped. `effort.limit_hit` is set where a limit was reached. `min_pairings` as for
    `gcbb`, which also says what is raised.
    """
    check_count("node_limit", node_limit)

    def search(problem: Problem, best: Best) -> None:
        nodes, edges = _consistent(problem, node_limit)
        cliques, complete = largest_cliques(edges, fewest(best, True))
        if not complete:
            problem.effort[INDEX.limit_hit] = 1
        keep_largest(best, problem, [Path(nodes.measurements[clique], nodes.features[clique]) for clique in cliques])

    return searched(scan, landmarks, locality, confidence, min_pairings, search)


def largest_cliques(edges: IntArray, least: int = 2) -> tuple[IntArray, bool]:
    """The largest cliques (k, size) found in a graph of edges (e, 2), of at least `least` ≥ 2 nodes, and whether these
    are all of them."""
    graph = nx.k_core(nx.Graph(edges.tolist()), least - 1)  # a node of such a clique has as many neighbours
    maximal = nx.find_cliques(graph)
    enumerated = list(itertools.islice(maximal, _MAXIMAL))
    complete = next(maximal, None) is None
    size = max(map(len, enumerated), default=0)
    if size < least:
        return np.empty((0, 0), np.int64), complete
    largest = [clique for clique in enumerated if len(clique) == size]
    return np.array(largest[:_CLIQUES], np.int64), complete and len(largest) <= _CLIQUES


def _consistent(problem: Problem, node_limit: int) -> tuple[Path, IntArray]:
    """The pairings that pass the unary constraints, and the edges (e, 2) between those that agree; none if too many."""
    nodes, effort, no_edges = Path(*np.nonzero(problem.allowed)), problem.effort, np.empty((0, 2), np.int64)
    number, edges, count = np.zeros(problem.allowed.shape, np.int64), [no_edges], 0
    number[nodes] = np.arange(len(nodes.features))
    effort[INDEX.unary_tests], effort[INDEX.nodes] = number.size, len(nodes.features)
    for a, (i, j) in enumerate(zip(*nodes) if len(nodes.features) <= node_limit else ()):
        agreeing = problem.allowed.copy()
        agreeing[: i + 1] = False
        keep_what_follows(problem, agreeing, Path(np.array([i]), np.array([j])))
        edges.append(np.column_stack(np.broadcast_arrays(a, number[agreeing])))
        count += len(edges[-1])
        if count > _EDGES:
            break
    effort[INDEX.limit_hit] = len(nodes.features) > node_limit or count > _EDGES
    return nodes, no_edges if effort[INDEX.limit_hit] else np.concatenate(edges)
