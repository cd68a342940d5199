"""Maps, scans and cliques of `bench associate`."""

from __future__ import annotations

import importlib
import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from slam_gym.geometry import observe
from slam_gym.types import UNKNOWN, Array, IntArray, Landmarks, Scan

SIGMA = 0.05  # [m] of features in the map, and of measurements
DENSITY = 1.0 / 16.0  # [1/m²]
NEAR, TURNED = 0.3, math.radians(3.0)  # a pose is right within these [m, rad]
PEERS = ("igraph", "cliquematch")


@dataclass(frozen=True)
class Query:
    """One scan, and where it was taken; NaN outside the map."""

    scan: Scan
    pose: Array  # (3,) [m, m, rad]


def field(n: int, rng: np.random.Generator) -> tuple[Array, Landmarks]:
    """True positions (n, 2) and the map of them."""
    truth = rng.uniform(0.0, math.sqrt(n / DENSITY), (n, 2))
    return truth, as_landmarks(truth + SIGMA * rng.standard_normal((n, 2)), SIGMA)


def as_landmarks(positions: Array, sigma: float) -> Landmarks:
    """Landmarks with equal, independent errors."""
    n = len(positions)
    unknown, none = np.full(n, np.nan), np.empty(0, np.int64)
    marginals = np.tile(sigma**2 * np.eye(2), (n, 1, 1))
    kinds, blocks = np.full(n, UNKNOWN), np.empty((0, 2, 2))
    return Landmarks(positions, marginals, unknown, unknown, kinds, np.empty((0, 0)), none, none, blocks)


def query(truth: Array, m: int, spurious: float, half: bool, inside: bool, rng: np.random.Generator) -> Query:
    """A scan of m measurements from a random place; outside, of features that the map does not hold."""
    side, seen = math.sqrt(len(truth) / DENSITY), m - round(spurious * m)
    pose = np.array([*rng.uniform(0.15 * side, 0.85 * side, 2), rng.uniform(-math.pi, math.pi)])
    features = truth if inside else rng.uniform(0.0, side, truth.shape)
    distances = np.hypot(*(features - pose[:2]).T)
    near = np.argpartition(distances, 2 * seen)[: 2 * seen]
    near = near[np.argsort(distances[near])][: 2 * seen if half else seen]
    radius = distances[near[-1]] * np.sqrt(rng.random(m - seen))
    angle = rng.uniform(-math.pi, math.pi, m - seen)
    stray = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    points = np.concatenate([observe(pose, features[rng.permutation(near)[:seen]]), stray])[rng.permutation(m)]
    return Query(as_scan(points + SIGMA * rng.standard_normal((m, 2))), pose if inside else np.full(3, math.nan))


def as_scan(points: Array) -> Scan:
    """A scan with equal errors and no sizes."""
    m = len(points)
    unknown = np.full(m, np.nan)
    return Scan(points, np.tile(SIGMA**2 * np.eye(2), (m, 1, 1)), unknown, unknown)


def is_right(found: Array, pose: Array) -> bool:
    """Whether a pose was found within .3 m and 3° of the true one."""
    turn = (found[2] - pose[2] + math.pi) % (2.0 * math.pi) - math.pi
    return bool(np.hypot(*(found[:2] - pose[:2])) < NEAR and abs(turn) < TURNED)


def milliseconds(call: Callable[[], object], repeats: int) -> float:
    """Least of some timings [ms], in time of the processor spent by this thread."""
    best = math.inf
    for _ in range(repeats):
        start = time.thread_time_ns()
        call()
        best = min(best, time.thread_time_ns() - start)
    return best / 1e6


def pairs_by_length(landmarks: Landmarks) -> tuple[Array, IntArray, IntArray]:
    """All ordered pairs of features, by the distance between them: distances [m], first, second. Once per map."""
    F = landmarks.positions
    j, l = np.nonzero(~np.eye(len(F), dtype=bool))
    apart = np.hypot(*(F[j] - F[l]).T)
    order = np.argsort(apart)
    return apart[order], j[order], l[order]


def consistency_edges(scan: Scan, pairs: tuple[Array, IntArray, IntArray], n: int) -> IntArray:
    """Edges (e, 2) between pairings i·n + j that agree in distance within the .99 gate; errors alike for all."""
    z, (apart, j, l) = scan.points, pairs
    gate, edges = math.sqrt(chdtri(1, 0.01) * 4.0 * SIGMA**2), []
    for i in range(len(z)):
        for k in range(i):
            length = np.hypot(*(z[i] - z[k]))
            low, high = np.searchsorted(apart, (length - gate, length + gate))
            edges.append(np.column_stack([i * n + j[low:high], k * n + l[low:high]]))
    return np.concatenate(edges)


def igraph_clique(edges: IntArray, vertices: int) -> tuple[float, list[int]]:
    """Time [ms] of igraph's largest_cliques on a graph already built, and one of them."""
    graph = importlib.import_module("igraph").Graph(vertices, edges)
    start = time.process_time()
    found = graph.largest_cliques()
    return 1e3 * (time.process_time() - start), list(found[0])


def cliquematch_clique(edges: IntArray, vertices: int) -> tuple[float, list[int]]:
    """Time [ms] of cliquematch's get_max_clique on a graph already built, and its answer."""
    edges = np.ascontiguousarray(edges + 1, np.uint64)
    graph = importlib.import_module("cliquematch").Graph.from_edgelist(edges, vertices)
    start = time.process_time()
    found = graph.get_max_clique()
    return 1e3 * (time.process_time() - start), [int(v) - 1 for v in found]


CLIQUES = {"igraph": igraph_clique, "cliquematch": cliquematch_clique}


def installed() -> list[str]:
    """Peers that are there; says how to get the others."""
    found = []
    for name in PEERS:
        try:
            importlib.import_module(name)
            found.append(name)
        except ImportError:
            print(f"{name}: not installed: pip install slam_gym[bench]")
    return found
