"""1-point RANSAC: one pairing updates the pose, and the measurements that agree with the updated pose are counted."""

import math

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.compatibility import chi2_gate
from slam_gym.association.prediction import Prediction
from slam_gym.association.tracking.near_first import Offer, near_first
from slam_gym.association.tree import Node, Pairings, add_pairing, is_local, root_of
from slam_gym.types import Effort, Hypothesis, IntArray, Scan
from slam_gym.validation import check_count


def one_point_ransac(
    scan: Scan, prediction: Prediction, *, success: float = 0.99, tries: int = 1000, seed: int = 0
) -> Hypothesis:
    """The pairings that agree with the state after an update with the best single pairing, and the rescued ones.

    Civera, Grasa, Davison and Montiel, "1-point RANSAC for extended Kalman filtering", JFR 27(5), 2010. With a prior,
    one pairing is enough for a hypothesis. Candidates are drawn without replacement. The state is updated with the
    drawn pairing, and each measurement then takes the nearest feature within its individual gate χ²_{2,conf}, nearest
    pairings first, each feature once. The draw with the most pairings wins (of equals, the one with least Σ D²). The
    state is then updated with all of them, and the remaining measurements are rescued by their gates at that state.

    Draws end once the probability of having missed a right candidate is below 1 − `success`, if as many of the c
    candidates are right as the best draw pairs: after log(1 − success) / log(1 − pairings / c) draws, or after `tries`
    (`effort.limit_hit`). Gates are individual: no test covers all pairings together. Localities of the prediction are
    used as in `jcbb`. Raises ValueError as `individual`, for fewer tries than one, and for a `success` outside (0, 1).
    """
    check_count("tries", tries)
    if not 0.0 < success < 1.0:
        raise ValueError(f"success: {success} is not between 0 and 1")
    gate, rng = chi2_gate(2, prediction.confidence), np.random.default_rng(seed)

    def search(offer: Offer, rows: IntArray) -> Effort:
        pairings, fixed = offer.pairings, offer.pairings.fixed
        count = len(pairings.slots) - fixed
        chosen, drawn = _draw(pairings, fixed + rng.permutation(count), gate, success, tries)
        rows[pairings.measured[chosen]] = offer.rows[pairings.slots[chosen]]
        return Effort(drawn, drawn * count, tries=drawn, limit_hit=drawn == tries and tries < count)

    return near_first(scan, prediction, search)


@compiled
def _draw(pairings: Pairings, order: IntArray, gate: float, success: float, tries: int) -> tuple[IntArray, int]:
    """The pairings of the best draw, including rescued ones, and the number of candidates drawn from `order` (c,). The
    fixed pairings are kept."""
    first, count, best, best_sum = root_of(pairings), len(order), order[:0], math.inf
    order = order[first.added[order] < gate]  # of old features, some disagree with the pairings that are fixed
    required, drawn = math.inf, 0
    while drawn < min(required, tries, len(order)):
        anchor, drawn = order[drawn : drawn + 1], drawn + 1
        node, total = add_pairing(pairings, first, anchor[0], pairings.fixed), first.added[anchor[0]]
        others = _nearest_first(pairings, node, anchor, gate)
        for c in others:
            total += node.added[c]
        if 1 + len(others) > len(best) or (1 + len(others) == len(best) and total < best_sum):
            best, best_sum = np.concatenate((anchor, others)), total
            fraction = len(best) / count
            required = math.log(1.0 - success) / math.log(1.0 - fraction) if fraction < 1.0 else 1.0
    node = first
    for c in best:
        node = add_pairing(pairings, node, c, pairings.fixed)
    return np.concatenate((best, _nearest_first(pairings, node, best, gate))), drawn


@compiled
def _nearest_first(pairings: Pairings, node: Node, made: IntArray, gate: float) -> IntArray:
    """Candidates within the gate at a node, which has `made` these pairings after the fixed ones, by ascending
    distance; each measurement and feature once."""
    slots, measured, local = pairings.slots, pairings.measured, pairings.local
    used_slots, used = np.zeros(slots.max() + 1, np.bool_), np.zeros(measured.max() + 1, np.bool_)
    used_slots[slots[made]], used[measured[made]] = True, True
    out, count = np.empty(len(slots), np.int64), 0
    for c in pairings.fixed + np.argsort(node.added[pairings.fixed :], kind="mergesort"):
        if not node.added[c] < gate:
            break
        free = not used[measured[c]] and not used_slots[slots[c]]
        if free and is_local(local, slots[made[0]], slots[c]):
            used_slots[slots[c]], used[measured[c]] = True, True
            out[count] = c
            count += 1
    return out[:count]
