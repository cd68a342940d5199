"""Associators that judge each pairing alone: nearest neighbour, singles, and global nearest neighbour."""

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.compatibility import chi2_gate, gate_pairings
from slam_gym.association.prediction import Expected, Prediction, PredictionArrays
from slam_gym.association.tracking.near_first import Decided, Offer, Spent, decided, joint_distance_of, near_first
from slam_gym.types import UNPAIRED, BoolArray, Effort, Hypothesis, IntArray, Scan, ScanArrays

_FORBIDDEN = 1e9  # cost of an incompatible pairing: more than any assignment of compatible ones


def nearest_neighbour(scan: Scan, prediction: Prediction) -> Hypothesis:
    """ICNN: each measurement is paired with its individually compatible feature of least D²_ij.

    Measurements are decided independently, so a feature may be paired more than once. Raises ValueError as
    `individual`.
    """
    gate = chi2_gate(2, prediction.confidence)
    return _decide(scan.arrays, prediction.arrays, gate, False).hypothesis(exclusive=False)


def singles(scan: Scan, prediction: Prediction) -> Hypothesis:
    """SINGLES: a pairing is made where each of the two is the only individually compatible one for the other.

    Raises ValueError as `individual`.
    """
    gate = chi2_gate(2, prediction.confidence)
    return _decide(scan.arrays, prediction.arrays, gate, True).hypothesis(exclusive=False)


def global_nearest_neighbour(scan: Scan, prediction: Prediction) -> Hypothesis:
    """GNN: minimises Σ (D²_ij + log det S_ij) over the pairings plus a cost for every measurement left unpaired.

    Pairings are individually compatible, and each feature is paired at most once (Blackman and Popoli, "Design and
    Analysis of Modern Tracking Systems", 1999, §6.4). Leaving measurement i unpaired costs the gate χ²_{2,conf} plus
    the largest log det S_ij among its candidates. So any compatible pairing is better than none, unless it takes a
    feature from another measurement for which it saves more. Correlations of the pairings through the robot's pose are
    ignored. The problem is solved exactly, by scipy's linear assignment.

    Localities of the prediction are used as in `jcbb`, except that pairings of the second search, which are made all at
    once, do not restrict each other. Raises ValueError as `individual`.
    """
    from scipy.optimize import linear_sum_assignment  # its import takes as long as all others together

    gate = chi2_gate(2, prediction.confidence)

    def search(offer: Offer, rows: IntArray) -> Effort:
        pairings, fixed = offer.pairings, offer.pairings.fixed
        slots, each, nu = pairings.slots[fixed:], pairings.measured[fixed:], pairings.innovations[fixed:]
        (measured, level), columns = np.unique(each, return_inverse=True), len(offer.rows)
        S = prediction.covariances[offer.rows[slots]] + scan.covariances[each]
        size = np.log(S[:, 0, 0] * S[:, 1, 1] - S[:, 0, 1] ** 2)
        distances = np.einsum("ci,cij,cj->c", nu, np.linalg.inv(S), nu)
        costs = np.full((len(measured), columns + len(measured)), _FORBIDDEN)
        costs[level, slots] = distances + size
        largest = np.full(len(measured), -np.inf)
        np.maximum.at(largest, level, size)
        costs[np.arange(len(measured)), columns + np.arange(len(measured))] = gate + largest
        _, chosen = linear_sum_assignment(costs)
        paired: BoolArray = chosen < columns
        rows[measured[paired]] = offer.rows[chosen[paired]]
        return Effort(nodes=len(offer.starts) - 1)

    return near_first(scan, prediction, search)


@compiled
def _decide(scan: ScanArrays, prediction: PredictionArrays, gate: float, mutual: bool) -> Decided:
    """Pair each measurement with its nearest candidate; if `mutual`, only where each is the other's only candidate."""
    expected = Expected(*prediction)
    m, k, every_row = len(scan[0]), len(expected.features), expected.near[:0]
    rows, features = np.full(m, UNPAIRED), (expected.positions, expected.covariances)
    candidates = gate_pairings(scan[:2], features, np.arange(m), every_row, gate, k)
    starts, slots = candidates.starts, candidates.slots
    claims = np.zeros(len(candidates.rows), np.int64)
    for slot in slots:
        claims[slot] += 1
    for i in range(m):
        if starts[i] == starts[i + 1]:
            continue
        if not mutual or (starts[i] + 1 == starts[i + 1] and claims[slots[starts[i]]] == 1):
            rows[i] = candidates.rows[slots[starts[i]]]
    return decided(expected, rows, joint_distance_of(scan, expected, rows), Spent(m, candidates.tests, 0, False))
