"""1-point RANSAC: one pairing moves the pose, and whoever agrees with the pose moved is counted."""

from __future__ import annotations

import math

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.compatibility import chi2_gate, joint_distance
from slam_gym.association.tracking.stages import in_stages
from slam_gym.association.tracking.support import Arrays, arrays, distances_given, given
from slam_gym.association.tree import Tree, append_pairing, as_hypothesis
from slam_gym.types import Array, Effort, Hypothesis, IntArray, Prediction, Scan


def one_point_ransac(
    scan: Scan,
    prediction: Prediction,
    *,
    confidence: float = 0.99,
    success: float = 0.99,
    tries: int = 1000,
    seed: int = 0,
    locality: str | None = "covisibility",
) -> Hypothesis:
    """The pairings that agree with the state after an update with the best single pairing, and those rescued by them.

    Civera, Grasa, Davison and Montiel, "1-point RANSAC for extended Kalman filtering", JFR 27(5), 2010. A prior makes
    one pairing enough for a hypothesis. Candidates are drawn without replacement: the state is updated with one, and
    each measurement then takes the nearest feature within its individual gate χ²_{2,conf}, nearest pairings first, each
    feature once. The draw with most pairings wins (of equals, the one with least Σ D²); the state is updated with all
    of them, and the measurements left over are rescued by their gates there.

    Draws end once the chance to have missed a right candidate is below 1 − `success`, taking as many of the c
    candidates for right as the best draw pairs: log(1 − success) / log(1 − pairings / c), or after `tries`
    (`effort.limit_hit`). Gates are individual: nothing tests all pairings together. A locality of the prediction is
    used as in `jcbb`, unless `locality` is None. Raises ValueError as `individual` does, for fewer tries than one, a
    `success` that is no probability below one, and an unknown locality.
    """
    if tries < 1:
        raise ValueError(f"tries: {tries} is less than 1")
    if not 0.0 < success < 1.0:
        raise ValueError(f"success: {success} is not between 0 and 1")
    gate, rng = chi2_gate(2, confidence), np.random.default_rng(seed)

    def search(tree: Tree) -> tuple[IntArray, Effort, None]:
        rows, count = tree.given.copy(), len(tree.slots)
        if not count:
            return rows, Effort(individual_tests=tree.candidates.tests), None
        path, factor, whitened = given(tree, min(tree.levels, count) + 2)
        chosen, drawn = _draw(
            rng.permutation(count), path, factor, whitened, tree.pairings_given, arrays(tree), gate, success, tries
        )
        rows[tree.candidates.measured[chosen]] = tree.rows[tree.slots[chosen]]
        limit_hit = drawn == tries and tries < count
        tests = tree.candidates.tests + drawn * count
        return rows, Effort(nodes=drawn, individual_tests=tests, tries=drawn, limit_hit=limit_hit), None

    rows, effort, _ = in_stages(scan, prediction, search, gate=confidence, confidence=confidence, locality=locality)
    return as_hypothesis(prediction, rows, joint_distance(scan, prediction, rows)[0], effort)


@compiled
def _draw(
    order: IntArray,
    path: IntArray,
    factor: Array,
    whitened: Array,
    p: int,
    candidates: Arrays,
    gate: float,
    success: float,
    tries: int,
) -> tuple[IntArray, int]:
    """Indices of the candidates paired, rescued ones included, and the number of draws. The p given ones are kept."""
    slots, measured, innovations, noise, covariance, _ = candidates
    count = len(slots)
    distances, best, best_sum, needed, drawn = np.empty(count), order[:0], math.inf, math.inf, 0
    for anchor in order:
        if drawn >= min(needed, tries):
            break
        drawn += 1
        distances_given(path, factor, whitened, p, candidates, anchor, distances)
        total, distances[anchor] = distances[anchor], -1.0  # first of all
        inliers = _nearest_first(distances, slots, measured, gate, best[:0])
        for c in inliers[1:]:
            total += distances[c]
        if len(inliers) > len(best) or (len(inliers) == len(best) and total < best_sum):
            best, best_sum = inliers, total
            share = len(best) / count
            needed = math.log(1.0 - success) / math.log(1.0 - share) if share < 1.0 else 1.0
    q = p
    for c in best:
        append_pairing(factor, whitened, path, q, covariance, slots[c], innovations[c], noise[measured[c]])
        path[q] = slots[c]
        q += 1
    distances_given(path, factor, whitened, q, candidates, -1, distances)
    _only_local(best, candidates, distances)
    return np.concatenate((best, _nearest_first(distances, slots, measured, gate, best))), drawn


@compiled
def _only_local(paired: IntArray, candidates: Arrays, distances: Array) -> None:
    """Distances of what is not local to the anchor, the first pairing, become infinite."""
    slots, local = candidates[0], candidates[5]
    if local.size > 0 and len(paired) > 0:
        for c in range(len(slots)):
            if not local[slots[paired[0]], slots[c]]:
                distances[c] = math.inf


@compiled
def _nearest_first(distances: Array, slots: IntArray, measured: IntArray, gate: float, before: IntArray) -> IntArray:
    """Candidates within the gate by ascending distance; each measurement and feature once, none of those `before`."""
    taken_slots, taken = np.zeros(slots.max() + 1, np.bool_), np.zeros(measured.max() + 1, np.bool_)
    for c in before:
        taken_slots[slots[c]], taken[measured[c]] = True, True
    out, count = np.empty(len(slots), np.int64), 0
    for c in np.argsort(distances):
        if not distances[c] < gate:
            break
        if not taken[measured[c]] and not taken_slots[slots[c]]:
            taken_slots[slots[c]], taken[measured[c]] = True, True
            out[count] = c
            count += 1
    return out[:count]
