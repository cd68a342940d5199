"""How locality enters a search with a prior: measurements are offered what is near first, then everything else.

The first search sees only the features near those paired in recent scans. The second sees the measurements left over
and the other features; it keeps the pairings of the first, and its own first pairing restricts those after it to its
locality. Where there is no locality, one search sees everything.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.compatibility import check_fault, chi2_gate, distance_of, gate_pairings, paired_rows
from slam_gym.association.prediction import Expected, Prediction, PredictionArrays, expected_of, joint, local
from slam_gym.association.tree import Pairings
from slam_gym.types import UNPAIRED, Effort, Hypothesis, IntArray, Scan, ScanArrays


class Offer(NamedTuple):
    """What one of the two searches may pair, and the pairings that it keeps, which come first."""

    pairings: Pairings
    starts: IntArray  # (l + 1,) where the candidates of each undecided measurement begin among those that are not kept
    rows: IntArray  # (u,) row of the prediction of each slot
    tests: int  # pairings tested for individual compatibility
    fault: int  # of the numbers in scan and prediction, see `check_fault`
    entry: int  # at fault


class Decided(NamedTuple):
    """What an associator has decided, as it comes out of compiled code."""

    features: IntArray  # (m,) map features, or UNPAIRED
    distance: float  # D²_H
    pairings: int
    nodes: int
    individual_tests: int
    joint_tests: int
    limit_hit: bool
    fault: int
    entry: int

    def hypothesis(self, *, exclusive: bool = True) -> Hypothesis:
        """The answer. Raises ValueError as `check_fault`."""
        check_fault(self.fault, self.entry)
        effort = Effort(self.nodes, self.individual_tests, self.joint_tests, self.limit_hit)
        return Hypothesis(self.features, self.distance, 2 * self.pairings, effort, exclusive=exclusive)


class Spent(NamedTuple):
    """What the searches of a scan took."""

    nodes: int
    individual_tests: int
    joint_tests: int
    limit_hit: bool


@compiled
def offer(scan: ScanArrays, expected: Expected, rows: IntArray, near: bool, gate: float) -> Offer:
    """What may be paired with the measurements that `rows` (m,) leaves UNPAIRED: features that are `near`, or not."""
    points, noise = scan[0], scan[1]
    eligible = expected.near if near else ~expected.near
    if len(expected.neighbours) == 0:
        eligible = eligible[:0]  # all of them
    fault, entry, starts, measured, slots, _, innovations, offered, tests = gate_pairings(
        points, noise, expected.positions, expected.covariances, np.flatnonzero(rows == UNPAIRED), eligible, gate
    )
    paired = np.flatnonzero(rows != UNPAIRED)
    kept = rows[paired]
    behind = np.concatenate((kept, offered))
    pairings = Pairings(
        np.concatenate((np.arange(len(kept)), slots + len(kept))),
        np.concatenate((paired, measured)),
        np.concatenate((points[paired] - expected.positions[kept], innovations)),
        noise,
        joint(expected, behind),
        np.empty((0, 0), np.bool_) if near else local(expected, behind),
        len(kept),
    )
    return Offer(pairings, starts, behind, tests, fault, entry)


@compiled
def is_over(expected: Expected, rows: IntArray) -> bool:
    """Whether there is nothing left for a second search."""
    return bool(len(expected.neighbours) == 0 or expected.near.all() or not (rows == UNPAIRED).any())


@compiled
def decided(expected: Expected, rows: IntArray, distance: float, spent: Spent, fault: int, entry: int) -> Decided:
    """The answer that pairs measurements with `rows` (m,) of the prediction."""
    features, pairings = np.full(len(rows), UNPAIRED), 0
    for i in range(len(rows)):
        if rows[i] != UNPAIRED:
            features[i] = expected.features[rows[i]]
            pairings += 1
    return Decided(
        features, distance, pairings, spent.nodes, spent.individual_tests, spent.joint_tests, spent.limit_hit, fault,
        entry,
    )  # fmt: skip


@compiled
def joint_distance_of(scan: ScanArrays, expected: Expected, rows: IntArray) -> float:
    """D²_H of pairing each measurement with `rows` (m,), or UNPAIRED; NaN where S_H is not positive definite."""
    chosen = paired_rows(rows)
    if len(chosen) == 0:
        return 0.0
    return distance_of(scan[0], scan[1], expected.positions, rows, joint(expected, chosen))


@compiled
def answer(scan: ScanArrays, prediction: PredictionArrays, rows: IntArray, spent: Spent) -> Decided:
    """`decided`, with its D²_H."""
    expected = expected_of(prediction[0], prediction[1], prediction[2])
    return decided(expected, rows, joint_distance_of(scan, expected, rows), spent, 0, -1)


@compiled
def offer_to(scan: ScanArrays, prediction: PredictionArrays, rows: IntArray, near: bool, gate: float) -> Offer:
    """`offer`, as Python calls it."""
    return offer(scan, expected_of(prediction[0], prediction[1], prediction[2]), rows, near, gate)


def near_first(
    scan: Scan, prediction: Prediction, search: Callable[[Offer, IntArray], Effort], *, exclusive: bool = True
) -> Hypothesis:
    """The hypothesis of a search written in Python, which enters what it pairs in `rows` (m,) of the prediction.

    Raises ValueError as `check_fault`.
    """
    rows, effort = np.full(len(scan), UNPAIRED), Effort()
    gate = chi2_gate(2, prediction.confidence)
    for near in (True, False):
        found = offer_to(scan.arrays, prediction.arrays, rows, near, gate)
        check_fault(found.fault, found.entry)
        effort = together(effort, Effort(individual_tests=found.tests))
        if len(found.pairings.slots) > found.pairings.given:
            effort = together(effort, search(found, rows))
        if not prediction.has_localities or prediction.near.all() or not (rows == UNPAIRED).any():
            break
    spent = Spent(effort.nodes, effort.individual_tests, effort.joint_tests, effort.limit_hit)
    return replace(answer(scan.arrays, prediction.arrays, rows, spent).hypothesis(exclusive=exclusive), effort=effort)


def together(first: Effort, second: Effort) -> Effort:
    """The effort of two searches: counts and times add up."""
    counts = {name: getattr(first, name) + getattr(second, name) for name in Effort.__slots__}
    return Effort(**counts | {"limit_hit": first.limit_hit or second.limit_hit})
