"""Which features of a map are local to each other, as compressed rows: the three definitions of Neira, Tardós and
Castellanos (2003).

A search without a prior on the pose takes the features for its later pairings from the locality of the first paired
feature, so that its effort is linear in the size of the map. Every `Locality` here is symmetric and reflexive. None
means that all features are local to each other, and the search is complete.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.types import Array, IntArray, Locality


def covisible(graph: CovisibilityGraph, hops: int = 1) -> Locality:
    """The locality of features seen together in a scan, or linked by up to `hops` such pairs.

    One hop is their choice. It misses pairs that lie side by side but were never seen in one scan; two hops find
    pairs that were both seen with a third feature, but make localities several times as large. Raises ValueError for
    fewer than one hop.
    """
    return linked(graph.n, graph.edges().pairs, hops)


def linked(n: int, pairs: IntArray, hops: int = 1) -> Locality:
    """The locality of n features in which those linked by up to `hops` of the `pairs` (e, 2), all different, are local.

    Raises ValueError for fewer than one hop, and for a pair that is not of two different features.
    """
    pairs = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    if hops < 1:
        raise ValueError(f"hops: {hops} is less than 1")
    bad = (pairs < 0).any(axis=1) | (pairs >= n).any(axis=1) | (pairs[:, 0] == pairs[:, 1])
    if bad.any():
        raise ValueError(f"pairs[{int(bad.argmax())}]: {pairs[bad.argmax()].tolist()} are not two of {n} features")
    one_hop = reached = _relation(n, pairs)
    for _ in range(hops - 1):
        reached = reached @ one_hop
    return _locality_of(reached)


def within(positions: Array, distance: float) -> Locality:
    """The locality of features at `positions` (n, 2) [m] that are at most `distance` [m] apart, by a k-d tree.

    Two features of one scan may be apart by twice the range of the sensor, which is the distance to choose. Walls are
    ignored: features that can never be seen together count as local too. Raises ValueError for positions that are not
    finite points, or a distance that is negative or not finite.
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
    return _locality_of(_relation(len(points), pairs.reshape(-1, 2)))


def same_local_map(map_of: ArrayLike) -> Locality:
    """The locality of features of the same local map; `map_of` (n,) is the index of each feature's map.

    Where two maps meet, the features of one scan belong to both: each map contains only half the scan, and neither may
    contain enough of it. Raises ValueError where an index is negative.
    """
    numbers = np.array(map_of, dtype=np.int64).reshape(-1)
    if (numbers < 0).any():
        raise ValueError(f"map_of[{int((numbers < 0).argmax())}]: {numbers.min()} is no local map")
    maps, compact = np.unique(numbers, return_inverse=True)
    n = len(numbers)
    member = csr_array((np.ones(n, np.bool_), (np.arange(n), compact.reshape(-1))), shape=(n, len(maps)))
    return _locality_of(member @ member.T)


def restricted(locality: Locality | None, features: IntArray) -> Locality | None:
    """The locality among some `features` (k,), ascending, which it numbers 0 … k−1."""
    if locality is None:
        return None
    entries = np.ones(len(locality.members), np.bool_), locality.members, locality.starts
    return _locality_of(csr_array(entries, shape=(len(locality), len(locality)))[features][:, features])


def locality_sizes(locality: Locality | None, n: int) -> IntArray:
    """(n,) size |L(j)| of the locality of each feature, itself included; c of eq. 9.22 is their maximum.

    Raises ValueError where the locality is of another number of features than n.
    """
    if locality is None:
        return np.full(n, n)
    if len(locality) != n:
        raise ValueError(f"locality: of {len(locality)} features, for a map of {n}")
    return np.diff(locality.starts)


def hypothesis_count(sizes: IntArray, m: int) -> float:
    """The number of hypotheses of the unpruned tree of m measurements, for localities of `sizes` (n,), each at least 1.

    N_h = 1 + Σ_j ((|L(j)| + 1)^m − 1) / |L(j)|: later pairings take their features from the locality of the first
    feature, which is in it; a feature may be paired with two measurements.
    """
    c = np.asarray(sizes, dtype=np.float64)
    return float(1.0 + (((c + 1.0) ** m - 1.0) / c).sum())


def hypothesis_bound(n: int, m: int, c: float) -> float:
    """Eq. 9.22 for n features, m measurements and localities of c ≥ 1 features: N_h ≤ n ((c + 1)^m − 1) / c + 1.

    Exact where all localities have one size, a bound where c is the largest size, and below N_h for the mean size.
    """
    return float(n * ((c + 1.0) ** m - 1.0) / c + 1.0)


def _relation(n: int, pairs: IntArray) -> Any:
    """(n, n) sparse matrix of the symmetric, reflexive relation of n features given by `pairs` (e, 2), i ≠ j."""
    every = np.arange(n)
    rows, columns = np.concatenate([every, pairs[:, 0], pairs[:, 1]]), np.concatenate([every, pairs[:, 1], pairs[:, 0]])
    return csr_array((np.ones(len(rows), np.bool_), (rows, columns)), shape=(n, n))


def _locality_of(relation: Any) -> Locality:
    relation.sort_indices()
    return Locality(relation.indptr.astype(np.int64), relation.indices.astype(np.int64))
