"""Features that the map holds twice, plainly so: two within a gate of each other that were never seen together.

What closes a loop, or a scan whose right pairing missed its gate, leaves the odd feature twice. Two features are taken
for twins where their difference is small for its covariance, neither has another such, each was seen several times,
several features were seen with either of them, and still no scan saw both. With many such neighbours and sightings the
last says more than a gate does, and the gate is wide: a filter that has turned optimistic is what parted them.

A place that was mapped twice whole, too small for a loop, has no such neighbours. There six pairs or more that stand
together speak for each other: each is alone in its gate, and chance does not bring so many next to one another.
"""

from __future__ import annotations

import numpy as np

from slam_gym.association.compatibility import chi2_gate
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.slam.duplicates import agree
from slam_gym.types import IntArray

_CONFIDENCE = 0.99
_INFLATION = 2.0  # of standard deviations, where sightings and neighbours are many
_SEEN, _COMMON = 3, 3  # scans that saw each of two twins, and features seen with either, at least
_MANY_SEEN, _MANY_COMMON = 8, 8
_DOUBLED = 5  # candidates among the neighbours of both, at least, before they speak for each other


def find_twins(m: StochasticMap, graph: CovisibilityGraph, recent: int) -> IntArray:
    """Pairs (k, 2) of an older and a newer feature that are the same, one of which was seen in `recent` scans."""
    sure = m.seen >= max(_SEEN, m.spec.confirmations)
    lately, known = np.flatnonzero(sure & (m.last_seen >= m.step - recent)), np.flatnonzero(sure)
    gate = chi2_gate(2, _CONFIDENCE)
    D = m.distances_between(lately, known, _INFLATION**2 * gate)
    alike: dict[tuple[int, int], bool] = {}  # whether they are compatible in the narrow gate, too
    for row in np.flatnonzero(np.isfinite(D).sum(axis=1) == 1).tolist():
        column = int(D[row].argmin())
        one, other = int(lately[row]), int(known[column])
        if other not in graph.neighbours(one) and agree(m, np.array([one]), np.array([other])).all():
            alike[min(one, other), max(one, other)] = bool(D[row, column] < gate)
    candidates = _one_to_one(np.array(list(alike), np.int64).reshape(-1, 2))
    pairs = [pair for pair in candidates.tolist() if _are_twins(m, graph, pair, candidates, alike[tuple(pair)])]
    return np.array(pairs, np.int64).reshape(-1, 2)


def _are_twins(
    m: StochasticMap, graph: CovisibilityGraph, pair: list[int], candidates: IntArray, compatible: bool
) -> bool:
    """What sightings say of the features of a `pair`, `compatible` or so in the wide gate only.

    A feature seen with either of them speaks for it, and so do two that may be twins themselves, where one was seen
    with the first and the other with the second.
    """
    first, second = (graph.neighbours(feature) for feature in pair)
    common = len(np.intersect1d(first, second, assume_unique=True))
    doubled = int((np.isin(candidates[:, 0], first) & np.isin(candidates[:, 1], second)).sum())
    seen = int(m.seen[pair].min())
    total = common + (doubled if doubled >= _DOUBLED else 0)
    return total >= _COMMON if compatible else total >= _MANY_COMMON and seen >= _MANY_SEEN


def _one_to_one(pairs: IntArray) -> IntArray:
    """Those of the pairs (k, 2) whose features are in no other."""
    features, times = np.unique(pairs, return_counts=True)
    alone: IntArray = pairs[~np.isin(pairs, features[times > 1]).any(axis=1)]
    return alone
