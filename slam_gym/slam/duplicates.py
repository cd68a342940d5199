"""Features that a joined map holds twice, found by JCBB under its full covariance.

The hypothesis "newer feature i is older feature j" has the innovation ν_ij = F_i − F_j, and two of them the covariance
P_ik − P_il − P_jk + P_jl: everything that the two maps share, and all that the newer features have in common, is in it.
So the interpretation tree has a slot for each pairing here, where a scan's has one for each feature.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.compatibility import chi2_gate, joint_gates
from slam_gym.association.tracking.jcbb import branch_and_bound
from slam_gym.association.tracking.near_first import together
from slam_gym.association.tree import Pairings
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.slam.places.verification import attributes_agree
from slam_gym.types import UNPAIRED, Array, BoolArray, Effort, IntArray

_SEARCHES = 64


@dataclass(frozen=True, slots=True)
class Duplicates:
    """Pairs of features that are jointly compatible with being the same."""

    pairs: IntArray  # (k, 2) older and newer feature, by index; no feature in two pairs
    joint_distance: float  # D² of all pairs together
    dof: int  # 2 per pair
    effort: Effort


def find_duplicates(
    m: StochasticMap,
    older: IntArray,
    newer: IntArray,
    *,
    confidence: float = 0.99,
    individual_confidence: float = 0.9999,
    node_limit: int = 20_000,
) -> Duplicates:
    """The most pairs of an older (a,) and a newer feature (b,) of the map that may be the same, then of least D².

    Individually compatible, agreeing in size and kind, jointly compatible in every prefix, and one-to-one. JCBB does
    not know the last over these slots: where it gives one older feature to two newer ones, the search is repeated
    without the one pairing and without the other, and the better is kept. After 64 searches, or at the node limit of
    one, the best so far is returned and `effort.limit_hit` says so.

    What the relation between two maps is off by is off in every pair, so that one draw decides on all of them: the
    individual gate is wide, and it is the joint one that discerns. Raises ValueError where a feature does not exist or
    is given twice, and for a confidence that is none.
    """
    older, newer = np.sort(np.asarray(older, np.int64)), np.sort(np.asarray(newer, np.int64))
    features = np.concatenate([older, newer])
    if len(np.unique(features)) < len(features) or np.any((features < 0) | (features >= m.n)):
        raise ValueError(f"older, newer: not distinct features of a map of {m.n}")
    positions, P = m.positions[features], m.covariance_of(features)
    eligible = attributes_agree(m, older, newer)
    first, second = np.arange(len(older)), len(older) + np.arange(len(newer))  # among those together
    pairs, distances = _compatible(positions, P, first, second, eligible, chi2_gate(2, individual_confidence))
    chosen, distance, spent = _one_to_one(positions, P, pairs, distances, confidence, node_limit)
    effort = replace(spent, individual_tests=int(eligible.sum()), unary_tests=eligible.size)
    return Duplicates(features[pairs[chosen]], distance, 2 * len(chosen), effort)


def _one_to_one(
    positions: Array, P: Array, pairs: IntArray, distances: Array, confidence: float, node_limit: int
) -> tuple[IntArray, float, Effort]:
    """Which of the pairs (c, 2) to take, their D², and the effort: branch and bound over the pairings to do without.

    A search that ignores the rule bounds from above what can be had under it.
    """
    best, best_distance, effort = np.empty(0, np.int64), 0.0, Effort()
    todo, searches = [np.arange(len(pairs))], 0
    while todo:
        left = todo.pop()
        if not len(left):
            continue
        if searches == _SEARCHES:
            effort = replace(effort, limit_hit=True)
            break
        searches += 1
        pairings = _pairings(positions, P, pairs[left])
        rows, slots = np.full(len(pairings.noise), UNPAIRED), pairings.slots
        spent = branch_and_bound(pairings, slots, joint_gates(len(rows), confidence), node_limit, rows)
        chosen, distance = left[rows[rows != UNPAIRED]], spent.distance
        effort = together(effort, Effort(spent.nodes, 0, spent.tests, spent.limit_hit))
        if len(chosen) < len(best) or (len(chosen) == len(best) and not distance < best_distance):
            continue
        rivals = _claimed_twice(pairs[chosen, 0], distances[chosen])
        if rivals is None:
            best, best_distance = chosen, distance
        else:
            todo += [left[left != chosen[rival]] for rival in rivals]
    return best, best_distance, effort


def _claimed_twice(older: IntArray, distances: Array) -> tuple[int, int] | None:
    """Two of the pairings that claim the same older feature, that with less D²_ij first; None where there are none."""
    first: dict[int, int] = {}
    for position, feature in enumerate(older.tolist()):
        rival = first.setdefault(feature, position)
        if rival != position:
            return (rival, position) if distances[rival] < distances[position] else (position, rival)
    return None


def _pairings(positions: Array, P: Array, pairs: IntArray) -> Pairings:
    """The tree over the pairs (c, 2), ordered by their newer features: those are its levels."""
    newer, older = pairs[:, 1], pairs[:, 0]
    _, level = np.unique(newer, return_inverse=True)
    noise = np.zeros((int(level.max()) + 1, 2, 2))
    innovations = positions[newer] - positions[older]
    everything_is_local = np.empty((0, 0), np.bool_)
    covariance = _pair_covariance(P, pairs)
    return Pairings(np.arange(len(pairs)), level, innovations, noise, covariance, everything_is_local, 0)


@compiled
def _compatible(
    positions: Array, P: Array, older: IntArray, newer: IntArray, eligible: BoolArray, gate: float
) -> tuple[IntArray, Array]:
    """Individually compatible pairs (c, 2) of an older and a newer feature, and D²_ij (c,): by newer, then by D²."""
    room = 0
    for i in range(len(newer)):
        for j in range(len(older)):
            room += eligible[i, j]
    pairs, distances, count = np.empty((room, 2), np.int64), np.empty(room), 0
    for i in range(len(newer)):
        first, a = count, 2 * newer[i]
        for j in range(len(older)):
            b = 2 * older[j]
            x, y = positions[newer[i], 0] - positions[older[j], 0], positions[newer[i], 1] - positions[older[j], 1]
            xx = P[a, a] + P[b, b] - 2.0 * P[a, b]
            yy = P[a + 1, a + 1] + P[b + 1, b + 1] - 2.0 * P[a + 1, b + 1]
            if not eligible[i, j] or x * x >= gate * xx or y * y >= gate * yy:
                continue
            xy = P[a, a + 1] + P[b, b + 1] - P[a, b + 1] - P[a + 1, b]
            determinant = xx * yy - xy * xy
            if not determinant > 0.0:
                continue
            distance = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / determinant
            if not distance < gate:
                continue
            place = count
            while place > first and distances[place - 1] > distance:
                distances[place] = distances[place - 1]
                pairs[place, 0], pairs[place, 1] = pairs[place - 1, 0], pairs[place - 1, 1]
                place -= 1
            distances[place], pairs[place, 0], pairs[place, 1] = distance, older[j], newer[i]
            count += 1
    return pairs[:count].copy(), distances[:count].copy()


@compiled
def _pair_covariance(P: Array, pairs: IntArray) -> Array:
    """(2c, 2c) of the innovations F_i − F_j of all pairs (j, i) together."""
    c = len(pairs)
    out = np.empty((2 * c, 2 * c))
    for p in range(c):
        j, i = 2 * pairs[p, 0], 2 * pairs[p, 1]
        for q in range(c):
            l, k = 2 * pairs[q, 0], 2 * pairs[q, 1]
            for r in range(2):
                for s in range(2):
                    out[2 * p + r, 2 * q + s] = P[i + r, k + s] - P[i + r, l + s] - P[j + r, k + s] + P[j + r, l + s]
    return out
