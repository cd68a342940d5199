"""Locality in searches with a prior: near features are offered to measurements first, then all others.

The first search offers only features near those paired in recent scans. The second search offers the other features to
the measurements that are still unpaired. It keeps the pairings of the first as fixed, and its own first pairing
restricts the later ones to its locality. Without localities, one search offers all features.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.compatibility import chi2_gate, gate_pairings
from slam_gym.association.prediction import Expected, Prediction, PredictionArrays, joint
from slam_gym.association.tree import Pairings
from slam_gym.mapping.covisibility import among
from slam_gym.mapping.linear_algebra import cholesky, whiten
from slam_gym.types import UNPAIRED, Effort, Hypothesis, IntArray, Scan, ScanArrays


class Offer(NamedTuple):
    """The pairings that one of the two searches may make, preceded by the fixed pairings."""

    pairings: Pairings
    starts: IntArray  # (l + 1,) index of the first candidate of each undecided measurement, not counting fixed pairings
    rows: IntArray  # (u,) row of the prediction of each slot
    tests: int  # pairings tested for individual compatibility


class Spent(NamedTuple):
    """The work done by the searches of a scan: the first fields of `Effort`."""

    nodes: int
    individual_tests: int
    joint_tests: int
    limit_hit: bool


class Decided(NamedTuple):
    """The decision of an associator, as compiled code returns it."""

    features: IntArray  # (m,) map features, or UNPAIRED
    distance: float  # D²_H
    pairings: int
    spent: tuple[int, int, int, bool]  # `Spent`

    def hypothesis(self, **others: Any) -> Hypothesis:
        """The hypothesis; `others` are further fields of it."""
        return Hypothesis(self.features, self.distance, 2 * self.pairings, Effort(*self.spent), **others)


@compiled
def offer(scan: ScanArrays, prediction: PredictionArrays, rows: IntArray, near: bool, gate: float, most: int) -> Offer:
    """The pairings open to measurements that `rows` (m,) leaves UNPAIRED: with features that are `near`, or with the
    others, the `most` nearest of each measurement."""
    expected = Expected(*prediction)
    points, noise = scan[0], scan[1]
    eligible = expected.near if near else ~expected.near
    if len(expected.counts) == 0:
        eligible = eligible[:0]  # all of them
    unpaired, features = np.flatnonzero(rows == UNPAIRED), (expected.positions, expected.covariances)
    candidates = gate_pairings((points, noise), features, unpaired, eligible, gate, most)
    paired = np.flatnonzero(rows != UNPAIRED)
    fixed = rows[paired]
    offered = np.concatenate((fixed, candidates.rows))
    local = np.empty((0, 0), np.bool_)
    if not near:
        local = among(expected.counts, expected.features[offered])
    pairings = Pairings(
        np.concatenate((np.arange(len(fixed)), candidates.slots + len(fixed))),
        np.concatenate((paired, candidates.measured)),
        np.concatenate((points[paired] - expected.positions[fixed], candidates.innovations)),
        noise,
        joint(expected, offered),
        local,
        len(fixed),
    )
    return Offer(pairings, candidates.starts, offered, candidates.tests)


@compiled
def decided(expected: Expected, rows: IntArray, distance: float, spent: Spent) -> Decided:
    """The decision that pairs measurements with `rows` (m,) of the prediction."""
    features, pairings = np.full(len(rows), UNPAIRED), 0
    for i in range(len(rows)):
        if rows[i] != UNPAIRED:
            features[i] = expected.features[rows[i]]
            pairings += 1
    return Decided(features, distance, pairings, spent[:])


@compiled
def joint_distance_of(scan: ScanArrays, expected: Expected, rows: IntArray) -> float:
    """D²_H = νᵀ S⁻¹ ν of the pairings of measurements with `rows` (m,), or UNPAIRED. It is yᵀy with y = L⁻¹ν, S = L Lᵀ;
    NaN where S is not positive definite."""
    points, noise, positions = scan[0], scan[1], expected.positions
    paired = np.flatnonzero(rows != UNPAIRED)
    if len(paired) == 0:
        return 0.0
    S, y, squared = joint(expected, rows[paired]), np.empty(2 * len(paired)), 0.0
    for p in range(len(paired)):
        i = paired[p]
        for a in range(2):
            y[2 * p + a] = points[i, a] - positions[rows[i], a]
            for b in range(2):
                S[2 * p + a, 2 * p + b] += noise[i, a, b]
    if not cholesky(S):
        return math.nan
    whiten(S, np.empty((len(S), 0)), y)
    for a in range(len(y)):
        squared += y[a] * y[a]
    return squared


@compiled
def answer(scan: ScanArrays, prediction: PredictionArrays, rows: IntArray, spent: Spent) -> Decided:
    """`decided` with its D²_H, to be called from Python."""
    expected = Expected(*prediction)
    return decided(expected, rows, joint_distance_of(scan, expected, rows), spent)


def near_first(scan: Scan, prediction: Prediction, search: Callable[[Offer, IntArray], Effort]) -> Hypothesis:
    """The hypothesis of a `search` written in Python, which writes its pairings to `rows` (m,) of the prediction.

    Raises ValueError as `individual`.
    """
    rows, efforts, gate = np.full(len(scan), UNPAIRED), [Effort()], chi2_gate(2, prediction.confidence)
    for near in (True, False):
        offered = offer(scan.arrays, prediction.arrays, rows, near, gate, len(prediction))
        efforts.append(Effort(individual_tests=offered.tests))
        if len(offered.pairings.slots) > offered.pairings.fixed:
            efforts.append(search(offered, rows))
        if not prediction.has_localities or prediction.near.all() or not (rows == UNPAIRED).any():
            break
    counts = {name: sum(getattr(effort, name) for effort in efforts) for name in Effort.__slots__}
    total = Effort(**counts | {"limit_hit": any(effort.limit_hit for effort in efforts)})
    return replace(answer(scan.arrays, prediction.arrays, rows, Spent(0, 0, 0, False)).hypothesis(), effort=total)
