"""Two maps without a known relation, matched by a search without a prior, and merged.

A group of features of map B that were seen near one another takes the place of a scan, map A that of the map: the
search (`association.RELOCATORS`) answers with a pose, which is the base of B in A. The maps are joined there with a
relation that says nothing, the pairings found are made equal, and all further duplicates are found by JCBB under the
covariance that this leaves. So every correlation within A, within B and between them is accounted for in the merged
map; only the search itself, which takes the measurements of a scan for independent, is served an approximation:

The errors of a group in B are correlated. Any motion of the group as a whole is taken out of them first, which costs
nothing since its place is unknown anyway: with G the directions of a rigid motion and J = I − G(GᵀG)⁻¹Gᵀ, P_g = J P Jᵀ.
The blocks on its diagonal are then multiplied by κ, the largest eigenvalue of P_g relative to its block diagonal D. As
P_g ≤ κ D, distances, areas and D² are never judged by less than their true covariance: the search is conservative.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from slam_gym.association import resolve_relocator
from slam_gym.geometry import transform
from slam_gym.mapping.map_joining import equate, join_at
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.slam.duplicates import find_duplicates
from slam_gym.types import UNPAIRED, Array, IntArray, Locality, Relocation, Relocator, Scan

_FLOOR = 1e-12  # [m²] minimal variance of a measurement


@dataclass(frozen=True, slots=True)
class Merge:
    """What came of an attempt to merge map B into map A."""

    map: StochasticMap | None  # in the base of A, with the robot of B; None: refused
    relation: Array  # (3,) [m, m, rad] base of B in the base of A; NaN where no group was matched
    pairs: IntArray  # (k, 2) feature of A and feature of B that are the same
    expected: int  # features of B that lie where A has been mapped, and so should be in `pairs`
    groups: int  # groups of features that were searched for
    found: Relocation | None  # the search's answer to the group that the relation comes from


@dataclass(frozen=True)
class MergeSpec:
    """What is searched for, and when the answer is believed."""

    group_size: int = 8  # features in a group, at most
    min_pairs: int = 8  # without which a relation is not believed, whatever the search's own rule
    min_fraction: float = 0.5  # of the features that should be paired, without which it is not believed either
    mapped_within: float = 1.0  # [m] of a feature of A, a feature of B lies where A has been mapped
    confidence: float = 0.99  # of the joint test of duplicates

    def __post_init__(self) -> None:
        if self.group_size < 3 or self.min_pairs < 0:
            raise ValueError(
                f"MergeSpec.group_size, min_pairs: {self.group_size}, {self.min_pairs}: expected ≥ 3 and ≥ 0"
            )
        if not 0.0 <= self.min_fraction <= 1.0:
            raise ValueError(f"MergeSpec.min_fraction: {self.min_fraction} is not between 0 and 1")
        if not 0.0 < self.mapped_within < math.inf:
            raise ValueError(f"MergeSpec.mapped_within: {self.mapped_within} is no length > 0 [m]")
        if not 0.0 < self.confidence < 1.0:
            raise ValueError(f"MergeSpec.confidence: {self.confidence} is not between 0 and 1")


def merge(
    a: StochasticMap,
    b: StochasticMap,
    search: str | Relocator,
    *,
    locality: Locality | None = None,
    grouping: Locality | None = None,
    spec: MergeSpec | None = None,
) -> Merge:
    """Merge map B into map A, or refuse to.

    Arguments:
        a, b: the maps; they stay as they are.
        search: what finds a group of B's features in A, by name or itself.
        locality: of A, for the search; None: all features are local to all.
        grouping: of B: a group is a feature and the nearest of those local to it. None: the nearest of all.
        spec: settings.

    Of all relations that the search accepts, that with most pairs is taken. It is refused with too few of them, and
    where too little of what should have been paired was: a chance match of one group finds little to match around it.
    Ids are those of A, and those of B raised by the number that A has given. Raises ValueError for an unknown search
    and localities of other maps.
    """
    for name, given, mapped in (("locality", locality, a), ("grouping", grouping, b)):
        if given is not None and len(given) != mapped.n:
            raise ValueError(f"{name}: of {len(given)} features, for a map of {mapped.n}")
    settings, find, landmarks = spec or MergeSpec(), resolve_relocator(search), a.landmarks()
    groups = _groups(b, grouping, settings.group_size)
    best = Merge(None, np.full(3, np.nan), np.empty((0, 2), np.int64), 0, len(groups), None)
    tried: list[Array] = []
    for group in groups:
        found = find(as_scan(b, group), landmarks, locality)
        if not found.accepted or any(_same_pose(found.pose, pose) for pose in tried):
            continue
        tried.append(found.pose)
        merged, pairs = _merged(a, b, group, found, settings.confidence)
        expected = _expected(a, b, found.pose, settings.mapped_within)
        enough = len(pairs) >= max(settings.min_pairs, found.min_pairings, settings.min_fraction * expected)
        if len(pairs) > len(best.pairs):
            best = Merge(merged if enough else None, found.pose, pairs, expected, len(groups), found)
    return best


def as_scan(m: StochasticMap, group: IntArray) -> Scan:
    """Features `group` (g,) of a map as if they were measured from its base, with conservative covariances.

    See the head of this file. Raises ValueError for fewer than three features, or ones that do not exist.
    """
    group = np.asarray(group, dtype=np.int64)
    if len(group) < 3 or group.min() < 0 or group.max() >= m.n:
        raise ValueError(f"group: {group.tolist()} are not three or more features of a map of {m.n}")
    points = m.positions[group]
    shape = shape_covariance(points, m.covariance_of(group))
    g = np.arange(len(group))
    blocks = shape.reshape(len(group), 2, len(group), 2)[g, :, g, :] + _FLOOR * np.eye(2)
    roots = np.linalg.cholesky(blocks)
    whitened = np.linalg.solve(roots, shape.reshape(len(group), 2, -1)).reshape(len(shape), -1)
    whitened = np.linalg.solve(roots, whitened.T.reshape(len(group), 2, -1)).reshape(len(shape), -1)
    kappa = max(1.0, float(np.linalg.eigvalsh(0.5 * (whitened + whitened.T))[-1]))
    covariances = kappa * 0.5 * (blocks + blocks.transpose(0, 2, 1))
    return Scan(points, covariances, m.sizes[group], m.size_variances[group], m.kinds[group])


def shape_covariance(points: Array, P: Array) -> Array:
    """J P Jᵀ (2g, 2g): the covariance of points (g, 2), less every motion of all of them together."""
    x, y = (points - points.mean(axis=0)).T
    G = np.zeros((2 * len(points), 3))
    G[0::2, 0] = G[1::2, 1] = 1.0
    G[0::2, 2], G[1::2, 2] = -y, x
    J = np.eye(len(G)) - G @ np.linalg.pinv(G)
    out: Array = J @ P @ J.T
    return out


def _groups(m: StochasticMap, grouping: Locality | None, size: int) -> list[IntArray]:
    """Groups (g,) of confirmed features that cover the map: around each feature that is in none yet."""
    confirmed, positions = ~m.provisional, m.positions
    covered, groups = ~confirmed, []
    for feature in range(m.n):
        if covered[feature]:
            continue
        local = np.arange(m.n) if grouping is None else grouping.of(feature)
        local = local[confirmed[local]]
        away = np.hypot(*(positions[local] - positions[feature]).T)
        group = np.sort(local[np.argsort(away, kind="stable")[:size]])
        covered[group] = True
        covered[feature] = True
        if len(group) >= 3:
            groups.append(group)
    return groups


def _same_pose(one: Array, other: Array) -> bool:
    turn = math.remainder(float(one[2] - other[2]), 2.0 * math.pi)
    return math.hypot(*(one[:2] - other[:2])) < 0.1 and abs(turn) < 0.01


def _merged(
    a: StochasticMap, b: StochasticMap, group: IntArray, found: Relocation, confidence: float
) -> tuple[StochasticMap, IntArray]:
    """The maps joined at the pose found, duplicates removed; and pairs (k, 2) of features of A and B."""
    paired = found.features != UNPAIRED
    first = np.column_stack([found.features[paired], group[paired]])
    joined = equate(join_at(a, b, found.pose, renumber=True), first + np.array([0, a.n]))
    left = np.delete(np.arange(b.n), first[:, 1])  # what the features after A's are in B
    free = np.delete(np.arange(a.n), first[:, 0])
    more = find_duplicates(joined, free, np.arange(a.n, joined.n), confidence=confidence).pairs
    pairs = np.concatenate([first, np.column_stack([more[:, 0], left[more[:, 1] - a.n]])])
    return equate(joined, more), pairs[np.argsort(pairs[:, 0])]


def _expected(a: StochasticMap, b: StochasticMap, relation: Array, near: float) -> int:
    """Confirmed features of B with one of A within `near`."""
    distances, _ = cKDTree(a.confirmed).query(transform(relation, b.confirmed))
    return int((distances <= near).sum())
