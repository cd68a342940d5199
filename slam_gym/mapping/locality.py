"""Which features of a map are local to which: the three ways of the source, as compressed rows.

A search without a prior on the pose takes the features for its later pairings from the locality of the first one, so
that its effort is linear in the size of the map (Neira, Tardós and Castellanos 2003). Every `Locality` here is
symmetric and reflexive. None stands for everything, and searches in full.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from slam_gym._compile import compiled
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.types import Array, IntArray, Locality


def covisible(graph: CovisibilityGraph, at_least: int = 1, hops: int = 1) -> Locality:
    """Features seen together in at least so many scans, or linked by up to `hops` such pairs.

    One hop is the source's choice. It misses pairs that lie side by side but never met in one scan; two hops find those
    that were both seen with a third feature, at several times the size. Raises ValueError where either is below 1.
    """
    if at_least < 1:
        raise ValueError(f"at_least: {at_least} is less than 1")
    edges, counts = graph.edges()
    return linked(graph.n, edges[counts >= at_least], hops)


def linked(n: int, pairs: IntArray, hops: int = 1) -> Locality:
    """Of n features, those linked by up to `hops` of these pairs (e, 2); no pair is given twice.

    Raises ValueError for fewer than one hop and for pairs of other than two different features.
    """
    pairs = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    if hops < 1:
        raise ValueError(f"hops: {hops} is less than 1")
    bad = (pairs < 0).any(axis=1) | (pairs >= n).any(axis=1) | (pairs[:, 0] == pairs[:, 1])
    if bad.any():
        raise ValueError(f"pairs[{int(bad.argmax())}]: {pairs[bad.argmax()].tolist()} are not two of {n} features")
    starts, members = _rows(n, pairs)
    further, reached = starts, members
    for _ in range(hops - 1):
        further, reached = _one_hop_more(further, reached, starts, members)
    return Locality(further, reached)


def within(positions: Array, distance: float) -> Locality:
    """Features (n, 2) at most `distance` [m] apart, by a k-d tree.

    Two features of one scan may be twice the sensor's range apart, so that is the distance to ask for. Walls are not
    considered: features that can never be seen together count as local too. Raises ValueError for positions that are
    not finite points or a distance that is negative or not finite.
    """
    points = np.ascontiguousarray(positions, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f"positions: shape {points.shape}, expected (n, 2)")
    bad = ~np.isfinite(points).all(axis=1)
    if bad.any():
        raise ValueError(f"positions[{int(bad.argmax())}]: not finite")
    if not 0.0 <= distance < math.inf:
        raise ValueError(f"distance: expected a finite length >= 0 [m], got {distance}")
    if not len(points):
        return Locality(np.zeros(1, np.int64), np.empty(0, np.int64))
    pairs = cKDTree(points).query_pairs(distance, output_type="ndarray")
    return Locality(*_rows(len(points), np.ascontiguousarray(pairs, dtype=np.int64).reshape(-1, 2)))


def same_local_map(map_of: ArrayLike) -> Locality:
    """Features of the same local map; map_of (n,) is the number of each feature's map.

    Where two maps meet, features seen in one scan belong to different ones: a robot there finds half its scan in either
    and may find too little in both. Raises ValueError where a number is negative.
    """
    numbers = np.array(map_of, dtype=np.int64).reshape(-1)
    if (numbers < 0).any():
        raise ValueError(f"map_of[{int((numbers < 0).argmax())}]: {numbers.min()} is no local map")
    _, compact = np.unique(numbers, return_inverse=True)
    return Locality(*_blocks_of(np.ascontiguousarray(compact, dtype=np.int64).reshape(-1)))


def locality_sizes(locality: Locality | None, n: int) -> IntArray:
    """|L(j)| of each of n features, itself included, (n,); c of eq. 9.22 is their maximum.

    Raises ValueError where the locality is of another number of features.
    """
    if locality is None:
        return np.full(n, n)
    if len(locality) != n:
        raise ValueError(f"locality: of {len(locality)} features, for a map of {n}")
    return np.diff(locality.starts)


@compiled
def _rows(n: int, pairs: IntArray) -> tuple[IntArray, IntArray]:
    """Compressed rows of the symmetric, reflexive relation with these pairs (e, 2), i ≠ j, each given once."""
    starts = np.zeros(n + 1, np.int64)
    for j in range(n):
        starts[j + 1] = 1
    for e in range(len(pairs)):
        starts[pairs[e, 0] + 1] += 1
        starts[pairs[e, 1] + 1] += 1
    for j in range(n):
        starts[j + 1] += starts[j]
    members, filled = np.empty(starts[n], np.int64), starts[:n].copy()
    for j in range(n):
        members[filled[j]] = j
        filled[j] += 1
    for e in range(len(pairs)):
        i, j = pairs[e, 0], pairs[e, 1]
        members[filled[i]], members[filled[j]] = j, i
        filled[i], filled[j] = filled[i] + 1, filled[j] + 1
    for j in range(n):
        members[starts[j] : starts[j + 1]].sort()
    return starts, members


@compiled
def _one_hop_more(
    starts: IntArray, members: IntArray, one_starts: IntArray, one_members: IntArray
) -> tuple[IntArray, IntArray]:
    """Rows of all that is one hop from a member: counted in a first pass, written and sorted in a second."""
    n = len(starts) - 1
    marked = np.full(n, -1)
    further = np.zeros(n + 1, np.int64)
    reached = np.empty(0, np.int64)
    for writing in range(2):
        if writing == 1:
            reached = np.empty(further[n], np.int64)
            marked[:] = -1
        for j in range(n):
            count = 0
            for at in range(starts[j], starts[j + 1]):
                middle = members[at]
                for step in range(one_starts[middle], one_starts[middle + 1]):
                    end = one_members[step]
                    if marked[end] == j:
                        continue
                    marked[end] = j
                    if writing == 1:
                        reached[further[j] + count] = end
                    count += 1
            if writing == 0:
                further[j + 1] = further[j] + count
            else:
                reached[further[j] : further[j + 1]].sort()
    return further, reached


@compiled
def _blocks_of(map_of: IntArray) -> tuple[IntArray, IntArray]:
    """Rows of "same map" for map numbers 0 … k−1 (n,)."""
    n, maps = len(map_of), 0
    for number in map_of:
        maps = max(maps, number + 1)
    first = np.zeros(maps + 1, np.int64)
    for number in map_of:
        first[number + 1] += 1
    for k in range(maps):
        first[k + 1] += first[k]
    features, filled = np.empty(n, np.int64), first[:maps].copy()
    for j in range(n):
        features[filled[map_of[j]]] = j
        filled[map_of[j]] += 1
    starts = np.zeros(n + 1, np.int64)
    for j in range(n):
        starts[j + 1] = starts[j] + first[map_of[j] + 1] - first[map_of[j]]
    members = np.empty(starts[n], np.int64)
    for j in range(n):
        base = first[map_of[j]]
        for k in range(starts[j + 1] - starts[j]):
            members[starts[j] + k] = features[base + k]
    return starts, members
