"""The two associators that look at one pairing at a time."""

from __future__ import annotations

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.compatibility import individual, joint_distance
from slam_gym.association.tree import as_hypothesis
from slam_gym.types import UNPAIRED, Effort, Hypothesis, IntArray, Prediction, Scan


def nearest_neighbour(scan: Scan, prediction: Prediction) -> Hypothesis:
    """ICNN: each measurement is paired with its individually compatible feature of least D²_ij.

    Measurements are decided independently and never reconsidered, so a feature may be paired more than once.
    Raises ValueError as `individual` does.
    """
    candidates = individual(scan, prediction)
    rows = nearest(len(scan.points), candidates.starts, candidates.slots, candidates.rows)
    return _answer(scan, prediction, rows, candidates.tests)


def singles(scan: Scan, prediction: Prediction) -> Hypothesis:
    """SINGLES: measurement and feature are paired only where each is the other's only individually compatible one.

    Raises ValueError as `individual` does.
    """
    candidates = individual(scan, prediction)
    rows = mutual(len(scan.points), candidates.starts, candidates.slots, candidates.rows)
    return _answer(scan, prediction, rows, candidates.tests)


@compiled
def nearest(m: int, starts: IntArray, slots: IntArray, rows: IntArray) -> IntArray:
    """(m,) row of the first candidate of each measurement."""
    out = np.full(m, UNPAIRED)
    for i in range(m):
        if starts[i] < starts[i + 1]:
            out[i] = rows[slots[starts[i]]]
    return out


@compiled
def mutual(m: int, starts: IntArray, slots: IntArray, rows: IntArray) -> IntArray:
    """(m,) row of the only candidate of each measurement, where that is nobody else's."""
    out, wanted = np.full(m, UNPAIRED), np.zeros(len(rows), np.int64)
    for slot in slots:
        wanted[slot] += 1
    for i in range(m):
        if starts[i] + 1 == starts[i + 1] and wanted[slots[starts[i]]] == 1:
            out[i] = rows[slots[starts[i]]]
    return out


def _answer(scan: Scan, prediction: Prediction, rows: IntArray, tests: int) -> Hypothesis:
    distance = joint_distance(scan, prediction, rows).squared
    effort = Effort(nodes=len(rows), individual_tests=tests)
    return as_hypothesis(prediction, rows, distance, effort, exclusive=False)
