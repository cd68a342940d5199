"""Fusion: features that are the same become one, within the active map or between it and an inactive map.

The pairs of a loop are found in `slam.places.loops`. **Maps** are joined with an uninformative relation (`join`)
once the recent part of one, or a scan, is recognised in the other; there is then no prior to verify with. A **missed
loop** is closed without the prior, too: it failed (`close_missed_loop`).

**Duplicates** are single features that the map holds twice: a loop closure, or a scan whose right pairing missed its
gate, may leave some. Two features are taken for the same if their difference is small for its covariance, neither has
another such candidate, each was seen several times, several features were seen together with both, and still no scan
saw both. With many such neighbours and sightings, that no scan saw both is stronger evidence than a gate, and the gate
is wide: an optimistic filter may have separated them by more than their covariance admits. Where a whole place was
mapped twice, too small for a loop, its features have no such neighbours; there, candidate pairs support each other.
"""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import cdist
from scipy.stats import binom

from slam_gym.association.compatibility import chi2_gate
from slam_gym.geometry import compose, inverse, transform
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.map_joining import equate, join
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.slam.places.recognition import Parts, RecognitionSpec, least_pairs, parts_of, recent_part, recognise
from slam_gym.slam.places.verification import agreeing, attributes_agree, overlap
from slam_gym.types import UNPAIRED, Array, BoolArray, IntArray, Relocation

_NOTHING = np.empty(0, np.int64)

_CONFIDENCE = 0.99
_INFLATION = 2.0  # of standard deviations, where sightings and neighbours are many
_SEEN, _COMMON = 3, 3  # least number of scans that saw each of two duplicates, and of features seen with both
_MANY_SEEN, _MANY_COMMON = 8, 8
_DOUBLED = 5  # least number of candidate pairs among the neighbours of both that count as support
_ANYWHERE = 1000.0  # inflation with which every older feature is searched
_DRIFT = 3.0  # factor on the largest distance of the pairs found, since copies drift apart from there
_WINDOW = 10  # features that are judged together where the second copy of a place begins
_ACCIDENTAL = 0.01  # probability that so many of them lie on older ones by chance, anywhere in the map
_MORE_PAIRS = 1.25  # factor on the least number of pairs where the whole map is searched


class MappedArea(NamedTuple):
    """A map with its covisibility graph."""

    map: StochasticMap
    covisibility: CovisibilityGraph

    def only(self, features: BoolArray) -> MappedArea:
        """A copy with the robot and those features (n,) alone."""
        m, graph = self.map.copy(), copy.deepcopy(self.covisibility)
        graph.keep(m.remove(np.flatnonzero(~features)))
        return MappedArea(m, graph)


class Fusion(NamedTuple):
    """A map in which features were fused."""

    map: StochasticMap
    covisibility: CovisibilityGraph
    ids: IntArray  # (k, 2) ids of the fused features: the id that is kept, and the id that is removed
    became: IntArray  # (n,) new index of each feature of the map before the fusion
    returned: IntArray = _NOTHING  # (r,) ids of the features that came back with an inactive map

    def then(self, later: Fusion) -> Fusion:
        """This fusion followed by a later one, which may remove features that this one kept."""
        kept_later = dict(zip(later.ids[:, 1].tolist(), later.ids[:, 0].tolist()))
        ids = [(kept_later.get(kept, kept), removed) for kept, removed in self.ids.tolist()] + later.ids.tolist()
        returned = np.concatenate([self.returned, later.returned])
        return Fusion(later.map, later.covisibility, np.array(ids, np.int64), later.became[self.became], returned)


def fuse(m: StochasticMap, graph: CovisibilityGraph, pairs: IntArray) -> Fusion:
    """Fuse the features of each pair (k, 2) into the first of them, which gets the older id. `m` and `graph` are not
    changed."""
    became, kept = np.arange(m.n), np.delete(np.arange(m.n), pairs[:, 1])
    became[pairs[:, 1]] = pairs[:, 0]
    fused = graph.fused(pairs[:, 0], pairs[:, 1])
    return Fusion(equate(m, pairs), fused, np.sort(m.ids[pairs], axis=1), np.searchsorted(kept, became))


def close_missed_loop(m: StochasticMap, graph: CovisibilityGraph, spec: RecognitionSpec) -> Fusion | None:
    """Cut a map where a second copy of known ground begins, and join the parts there; None if nothing is recognised.

    The map considers the motion between the copies impossible, because it once trusted a wrong pairing. So the recent
    part is searched for in the whole map, and more pairs are required. The features of the second copy, and all that
    were started later, form a map with the robot. It is joined with the rest by the common ground alone: what the two
    parts knew of each other came from a wrong pose.
    """
    more = min(int(_MORE_PAIRS * spec.min_pairs), spec.group)
    anywhere = replace(spec, inflation=_ANYWHERE, min_pairs=more)
    parts = parts_of(m, graph, anywhere, anywhere.min_pairs)
    found = None if parts is None else recognise(m, parts.recent, m, graph, parts.older, anywhere)
    if parts is None or found is None:
        return None
    area, second = MappedArea(m, graph), m.ids >= _first_of_copy(m, parts, found)
    older, newer = area.only(~second), area.only(second)
    joined = join_recognised(older, newer, recent_part(*newer, spec), anywhere)
    if joined is None:
        return None
    became = np.arange(m.n)  # no feature of the older part is removed
    became[~second], became[second] = np.arange(older.map.n), joined.became
    return joined._replace(became=became)


def _first_of_copy(m: StochasticMap, parts: Parts, found: Relocation) -> int:
    """The id of the first feature of the second copy: the first one, started after the originals of the recent part,
    from which on more features of a window lie on older ones, when moved as the recent part is, than by chance."""
    moved, positions, by_id = transform(found.pose, m.positions), m.positions, np.argsort(m.ids)
    paired = found.features != UNPAIRED
    copies, originals = parts.recent[paired], parts.older[found.features[paired]]
    tolerance = _DRIFT * float(np.hypot(*(moved[copies] - positions[originals]).T).max())
    copied = np.tri(m.n, k=-1, dtype=np.bool_) & (cdist(moved[by_id], positions[by_id]) <= tolerance)
    has_original, ids = copied.any(axis=1), m.ids[by_id]
    between = (m.ids[originals] < m.ids[copies, None]) & (m.ids[copies, None] <= m.ids[copies])
    cut = int(between.sum(axis=1).argmax())  # the copy before which most originals, and few copies, were started
    latest = int(np.searchsorted(ids, m.ids[copies[cut]]))
    earliest = int(np.searchsorted(ids, m.ids[originals[between[cut]]].max(initial=0))) + 1
    by_chance = binom.isf(_ACCIDENTAL / m.n, _WINDOW, has_original[:earliest].mean())
    enough = np.convolve(has_original, np.ones(_WINDOW), "valid") > max(by_chance, 0.5 * _WINDOW)
    begun = np.flatnonzero(enough[earliest:latest])
    return int(ids[earliest + begun[0] if len(begun) else latest])


def join_recognised(inactive: MappedArea, active: MappedArea, recent: IntArray, spec: RecognitionSpec) -> Fusion | None:
    """Join two maps if features `recent` (g,) of the active map are recognised in the inactive one; else None.

    The relation of the maps is determined by the pairs alone: they must have one shape under the covariance of both
    maps, and be most of the features of both maps there. Neither map is changed. See `_joined` for the order of the
    features; `became` is that of the active map.
    """
    among = np.flatnonzero(~inactive.map.provisional)
    enough = min(len(among), len(recent)) >= spec.min_pairs
    found = recognise(active.map, recent, inactive.map, inactive.covisibility, among, spec) if enough else None
    if found is None:
        return None
    paired = found.features != UNPAIRED
    pairs = np.column_stack([among[found.features[paired]], recent[paired]])
    return _joined(inactive, active, found.pose, pairs, spec, Parts(recent, among))


def join_relocated(
    inactive: MappedArea, active: MappedArea, found: Relocation, features: IntArray, spec: RecognitionSpec
) -> Fusion | None:
    """As `join_recognised`, by one scan whose relocation `found` in the inactive map is known.

    `features` (m,) are those of the active map that the scan has updated or started, or UNPAIRED. The next relocation
    can correct a wrong one, but a wrong join is final: as many pairs, of one shape, are required as for a recent part.
    """
    paired = (found.features != UNPAIRED) & (features != UNPAIRED)
    pairs = np.column_stack([found.features[paired], features[paired]])
    pairs = pairs[np.unique(pairs[:, 1], return_index=True)[1]]  # two measurements may have updated one feature
    return _joined(inactive, active, compose(found.pose, inverse(active.map.pose)), pairs, spec)


def _joined(
    inactive: MappedArea,
    active: MappedArea,
    base: Array,
    pairs: IntArray,
    spec: RecognitionSpec,
    parts: Parts | None = None,
) -> Fusion | None:
    """Join two maps, and fuse the `pairs` (k, 2) of an inactive and an active feature that agree, if they are enough,
    and enough of the overlap of the `parts` of the active and of the inactive map, if given; else None.

    The base is that of the map that began first; the base of the active map is at the pose `base` in the other. The
    features are in the order of their ids, the oldest first; the robot is that of the active map.
    """
    a, b = inactive.map, active.map
    if a.ids.min(initial=b.next_id) < b.ids.min(initial=b.next_id):  # older features have smaller ids
        m, graph = join(a, b, base), inactive.covisibility.followed_by(active.covisibility)
    else:
        m, graph = join(b, a, inverse(base), robot_of_a=True), active.covisibility.followed_by(inactive.covisibility)
    order = np.argsort(m.ids)
    ids, m, graph = m.ids[order], m.reordered(order), graph.reordered(order)
    of_inactive, of_active = np.searchsorted(ids, a.ids), np.searchsorted(ids, b.ids)
    pairs = np.column_stack([of_inactive[pairs[:, 0]], of_active[pairs[:, 1]]])
    pairs = agreeing(m, pairs, spec, prior=False)
    if len(pairs) < least_pairs(a.n if parts is None else len(parts.older), spec):
        return None
    if parts is not None:
        there = Parts(of_active[parts.recent], of_inactive[parts.older])
        if overlap(m, there, pairs) < spec.min_fraction:
            return None
    fusion = fuse(m, graph, np.sort(pairs, axis=1))
    return fusion._replace(became=fusion.became[of_active])


def find_duplicates(m: StochasticMap, graph: CovisibilityGraph, recent: int) -> IntArray:
    """Pairs (k, 2) of an older and a newer feature that are the same, one of them seen in the last `recent` scans."""
    sure = m.seen >= max(_SEEN, m.spec.confirmations)
    recently_seen, established = np.flatnonzero(sure & (m.last_seen >= m.step - recent)), np.flatnonzero(sure)
    gate = chi2_gate(2, _CONFIDENCE)
    D = m.distances_between(recently_seen, established, _INFLATION**2 * gate)
    compatible: dict[tuple[int, int], bool] = {}  # by pair: whether it passes the narrow gate, too
    for row in np.flatnonzero(np.isfinite(D).sum(axis=1) == 1).tolist():
        column = int(D[row].argmin())
        one, other = int(recently_seen[row]), int(established[column])
        alike = attributes_agree(m, np.array([one]), np.array([other])).all()
        if other in graph.neighbours(one) or not alike:
            continue
        of_other = m.distances_between(np.array([other]), established, _INFLATION**2 * gate)
        if np.isfinite(of_other).sum() == 1:
            compatible[min(one, other), max(one, other)] = bool(D[row, column] < gate)
    found = np.array(list(compatible), np.int64).reshape(-1, 2)
    features, times = np.unique(found, return_counts=True)
    candidates: IntArray = found[~np.isin(found, features[times > 1]).any(axis=1)]  # whose features are in no other
    pairs = [pair for pair in candidates.tolist() if _are_one(m, graph, pair, candidates, compatible[tuple(pair)])]
    return np.array(pairs, np.int64).reshape(-1, 2)


def _are_one(
    m: StochasticMap, graph: CovisibilityGraph, pair: list[int], candidates: IntArray, compatible: bool
) -> bool:
    """Whether covisibility confirms that the features of a `pair` are the same.

    If not `compatible`, the pair passes only the wide gate, and more evidence is required. Evidence are the features
    seen with both, and candidate pairs of which one feature was seen with the first and the other with the second.
    """
    first, second = (graph.neighbours(feature) for feature in pair)
    common = len(np.intersect1d(first, second, assume_unique=True))
    doubled = int((np.isin(candidates[:, 0], first) & np.isin(candidates[:, 1], second)).sum())
    total = common + (doubled if doubled >= _DOUBLED else 0)
    return total >= _COMMON if compatible else total >= _MANY_COMMON and int(m.seen[pair].min()) >= _MANY_SEEN
