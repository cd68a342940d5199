"""The two associators that look at one pairing at a time."""

from __future__ import annotations

import numpy as np

from slam_gym.association.compatibility import individual, joint_distance
from slam_gym.association.tree import as_hypothesis
from slam_gym.types import UNPAIRED, Effort, Hypothesis, IntArray, Prediction, Scan


def nearest_neighbour(scan: Scan, prediction: Prediction) -> Hypothesis:
    """ICNN: each measurement is paired with its individually compatible feature of least D²_ij.

    Measurements are decided independently and never reconsidered, so a feature may be paired more than once.
    Raises ValueError as `individual` does.
    """
    candidates = individual(scan, prediction)
    rows = np.full(len(scan.points), UNPAIRED)
    some = candidates.starts[1:] > candidates.starts[:-1]
    rows[some] = candidates.rows[candidates.slots[candidates.starts[:-1][some]]]
    return _answer(scan, prediction, rows, candidates.tests)


def singles(scan: Scan, prediction: Prediction) -> Hypothesis:
    """SINGLES: measurement and feature are paired only where each is the other's only individually compatible one.

    Raises ValueError as `individual` does.
    """
    candidates = individual(scan, prediction)
    rows = np.full(len(scan.points), UNPAIRED)
    alone = np.flatnonzero(np.diff(candidates.starts) == 1)
    slots = candidates.slots[candidates.starts[alone]]
    wanted_once = np.bincount(candidates.slots, minlength=len(candidates.rows))[slots] == 1
    rows[alone[wanted_once]] = candidates.rows[slots[wanted_once]]
    return _answer(scan, prediction, rows, candidates.tests)


def _answer(scan: Scan, prediction: Prediction, rows: IntArray, tests: int) -> Hypothesis:
    distance = joint_distance(scan, prediction, rows).squared
    effort = Effort(nodes=len(rows), individual_tests=tests)
    return as_hypothesis(prediction, rows, distance, effort, exclusive=False)
