"""Place recognition: the recent part of the active map is searched for among other features, without a prior.

A robot that was carried away maps known ground again, and so does one that drifted farther than its covariance admits.
A single scan cannot distinguish such ground from new ground; a dozen features can. They take the place of a scan
(`as_scan`), and one of the searches of relocation pairs them with features of an inactive map, or of the rest of the
active one. The pairs found are then verified geometrically (`slam.places.verification`). Loops, for which the map is a
prior, are found in `slam.places.loops`.

The errors of a group of features are correlated, but the searches assume the measurements of a scan to be independent.
Any motion of the group as a whole is projected out first, which loses nothing because its place is unknown: with G the
directions of a rigid motion and J = I − G(GᵀG)⁻¹Gᵀ, P_g = J P Jᵀ. The blocks on its diagonal are then multiplied by κ,
the largest eigenvalue of P_g relative to its block diagonal D. As P_g ≤ κ D, distances, areas and D² are never judged
by less than their true covariance: the search is conservative.

A wrong pairing ruins the map; a missed pairing can be made later. So there must be enough pairs, and several more than
the number expected by chance, which is the number that the same search finds for the mirror image of the recent part.
The more places a building has, the more alike are some of them: a search among many features must find more pairs.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag, eigh

from slam_gym.association import indexed
from slam_gym.association.acceptance import min_pairings as required_pairings
from slam_gym.association.compatibility import chi2_gate
from slam_gym.association.relocation.location import VARIANCE_FLOOR
from slam_gym.mapping.covisibility import CovisibilityGraph, mark_local
from slam_gym.mapping.covisibility import among as seen_together
from slam_gym.mapping.locality import linked
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.types import Array, IntArray, Relocation, Scan
from slam_gym.validation import Checked

_FEW = 100  # features; each doubling beyond requires one more pair


@dataclass(frozen=True)
class RecognitionSpec(Checked):
    """Settings of place recognition: what is searched for while the robot is tracked, and when a match is accepted."""

    every: int = 10  # [scans] between searches
    group: int = 20  # most features of the recent part: those seen last
    recent: int = 30  # [scans] features seen in the last so many are recent, all others are older
    confidence: float = 0.999  # of the tests of pairs, shape and motion
    inflation: float = 3.0  # of the standard deviations of the motion between the two parts
    min_fraction: float = 0.5  # least fraction of the features in the overlap of both parts that is paired
    margin: int = 3  # least number of pairs above those of the mirror image, or of any set without common pairs
    # loops, with the map as the prior
    min_loop_pairs: int = 5
    max_accidental_loops: float = 0.01  # expected number of accidental sets of as many pairs, in one search
    # maps and missed loops, without a prior
    node_limit: int = 50_000  # poses that a search examines before it gives up: clutter can make it examine all of them
    min_pairs: int = 8  # with six, half of the loops that were closed without a prior were wrong

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("min_loop_pairs", "min_pairs"):
            if getattr(self, name) > self.group:
                raise ValueError(f"{name}: {getattr(self, name)} is more than group, {self.group}")


class Parts(NamedTuple):
    """The features that place recognition searches for, and those that it searches among."""

    recent: IntArray  # (g,) features to search for, ascending
    older: IntArray  # (a,) features to search among, ascending


def recent_part(m: StochasticMap, graph: CovisibilityGraph, spec: RecognitionSpec) -> IntArray:
    """The confirmed features (g,) that were seen last, ascending.

    They are those of the recent scans, and features up to two links of the covisibility graph away from them.
    """
    last, established = m.last_seen, ~m.provisional
    linked_to = np.flatnonzero(mark_local(graph.counts, m.n, np.flatnonzero(last >= m.step - spec.recent)))
    part = np.flatnonzero(established & mark_local(graph.counts, m.n, linked_to))
    return np.sort(part[np.argsort(last[part], kind="stable")[-spec.group :]])


def parts_of(m: StochasticMap, graph: CovisibilityGraph, spec: RecognitionSpec, least: int) -> Parts | None:
    """The recent part of a map and the older features it may match, or None if fewer than `least` of either may match.

    Each older feature is individually compatible with one of the recent part under the inflated covariance.
    """
    recent, is_older = recent_part(m, graph, spec), ~m.provisional & (m.last_seen < m.step - spec.recent)
    is_older[recent] = False
    older = np.flatnonzero(is_older)
    if min(len(recent), len(older)) < least:
        return None
    gate = spec.inflation**2 * chi2_gate(2, spec.confidence)
    near = np.isfinite(m.distances_between(recent, older, gate))
    if min(near.any(axis=0).sum(), near.any(axis=1).sum()) < least:
        return None
    return Parts(recent, older[near.any(axis=0)])


def recognise(
    m: StochasticMap,
    recent: IntArray,
    of: StochasticMap,
    graph: CovisibilityGraph,
    among: IntArray,
    spec: RecognitionSpec,
) -> Relocation | None:
    """Find features `recent` (g,) of map `m` among the features `among` (a,) of map `of`, another one or the same.

    `graph` is the covisibility of `of`. The pose found is that of the base of `m` in the base of `of`. Returns None if
    too few features are paired, if as many are paired at another pose, or if their mirror image pairs nearly as many.
    """
    scan, landmarks = as_scan(m, recent), of.landmarks(among)
    first, second = np.nonzero(seen_together(graph.counts, among))
    locality = linked(len(among), np.column_stack([first, second])[first < second], hops=2)
    needed = max(least_pairs(len(among), spec), required_pairings(scan, landmarks))
    found = indexed(scan, landmarks, locality, min_pairings=max(needed, 3), node_limit=spec.node_limit)
    if found.pairings < needed or found.ambiguous or found.effort.limit_hit:
        return None
    least = found.pairings - spec.margin + 1
    mirror = indexed(mirrored(scan), landmarks, locality, min_pairings=max(least, 3), node_limit=spec.node_limit)
    return found if mirror.pairings < least else None


def least_pairs(among: int, spec: RecognitionSpec) -> int:
    """The least number of pairs that tell a place from all others, where `among` features are searched."""
    return spec.min_pairs + max(math.ceil(math.log2(max(among, 1) / _FEW)), 0)


def as_scan(m: StochasticMap, group: IntArray) -> Scan:
    """Features `group` (g,), g ≥ 3, of a map as if they were measured from its base, with conservative covariances.

    The docstring of this module derives the covariances.
    """
    points = m.positions[group]
    G = rigid_motions(points)
    J = np.eye(len(G)) - G @ np.linalg.pinv(G)
    shape = J @ m.covariance_of(group) @ J.T
    g = np.arange(len(group))
    blocks = shape.reshape(len(group), 2, len(group), 2)[g, :, g, :] + VARIANCE_FLOOR * np.eye(2)
    kappa = max(1.0, float(eigh(0.5 * (shape + shape.T), block_diag(*blocks), eigvals_only=True)[-1]))
    covariances = kappa * 0.5 * (blocks + blocks.transpose(0, 2, 1))
    return Scan(points, covariances, m.sizes[group], m.size_variances[group], m.kinds[group])


def rigid_motions(points: Array) -> Array:
    """G (2g, 3): how points (g, 2) move with a shift in x, in y, and a turn about their centre."""
    x, y = (points - points.mean(axis=0)).T
    G = np.zeros((2 * len(points), 3))
    G[0::2, 0] = G[1::2, 1] = 1.0
    G[0::2, 2], G[1::2, 2] = -y, x
    return G


def mirrored(scan: Scan) -> Scan:
    """The mirror image of the scan: y becomes −y.

    Except in symmetric rooms, a map does not contain its mirror image: the pairs that a search finds are accidental.
    """
    flip = np.diag([1.0, -1.0])
    return Scan(scan.points @ flip, flip @ scan.covariances @ flip, scan.sizes, scan.size_variances, scan.kinds)
