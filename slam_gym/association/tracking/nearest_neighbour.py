"""The two associators that look at one pairing at a time: nearest neighbour and singles."""

from __future__ import annotations

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.compatibility import chi2_gate, gate_pairings
from slam_gym.association.prediction import Prediction, PredictionArrays, expected_of
from slam_gym.association.tracking.near_first import Decided, Spent, decided, joint_distance_of
from slam_gym.types import UNPAIRED, Hypothesis, Scan, ScanArrays


def nearest_neighbour(scan: Scan, prediction: Prediction) -> Hypothesis:
    """ICNN: each measurement is paired with its individually compatible feature of least D²_ij.

    Measurements are decided independently and never reconsidered, so a feature may be paired more than once.
    Raises ValueError as `check_fault`.
    """
    return _decide(scan.arrays, prediction.arrays, _gate(prediction), False).hypothesis(exclusive=False)


def singles(scan: Scan, prediction: Prediction) -> Hypothesis:
    """SINGLES: measurement and feature are paired only where each is the other's only individually compatible one.

    Raises ValueError as `check_fault`.
    """
    return _decide(scan.arrays, prediction.arrays, _gate(prediction), True).hypothesis(exclusive=False)


def _gate(prediction: Prediction) -> float:
    return chi2_gate(2, prediction.confidence)


@compiled
def _decide(scan: ScanArrays, prediction: PredictionArrays, gate: float, mutual: bool) -> Decided:
    """Pair each measurement with its first candidate, by ascending D²_ij; `mutual`: with its only one, if that is
    nobody else's."""
    expected = expected_of(prediction[0], prediction[1], prediction[2])
    m = len(scan[0])
    rows, everywhere = np.full(m, UNPAIRED), expected.near[:0]
    fault, entry, starts, _, slots, _, _, offered, tests = gate_pairings(
        scan[0], scan[1], expected.positions, expected.covariances, np.arange(m), everywhere, gate
    )
    if fault == 0:
        wanted = np.zeros(len(offered), np.int64)
        for slot in slots:
            wanted[slot] += 1
        for i in range(m):
            if starts[i] == starts[i + 1]:
                continue
            if not mutual or (starts[i] + 1 == starts[i + 1] and wanted[slots[starts[i]]] == 1):
                rows[i] = offered[slots[starts[i]]]
    distance = joint_distance_of(scan, expected, rows)
    return decided(expected, rows, distance, Spent(m, tests, 0, False), fault, entry)
