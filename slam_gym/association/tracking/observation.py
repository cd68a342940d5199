"""What a policy that walks the interpretation tree decides on: flat float32 vectors, scaled into [−1, 1].

Values without a bound are squashed: v / (|v| + scale), which is 0 at 0 and ±½ at ±scale.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slam_gym._compile import compiled
from slam_gym.types import Array, BoolArray, IntArray

if TYPE_CHECKING:
    from slam_gym.association.tracking.walk import Walk

Observation = dict[str, NDArray[np.float32]]

MEASUREMENT_FIELDS = ("x", "y", "sigma_x", "correlation", "sigma_y", "size")
"""`measurement`: the one to decide now, in R. An unknown size is 0."""

CANDIDATE_FIELDS = (
    "legal",  # 1 where there is a candidate; where there is none, the row is 0
    "x", "y",  # where the map expected it, in R
    "innovation_x", "innovation_y",  # ν_ij
    "individual",  # D²_ij, by its gate
    "joint",  # D²_H if taken, by its gate
    "size",  # (a_i − a_j)² / (σ_i² + σ_j²), by 1; −1 where a size is unknown
    "covisible",  # share of the features paired so far that it is local to; without locality all are local to all
    "near",  # 1 where it was paired in a recent scan or is local to one that was, or where there is no locality
    "age",  # steps since it was first seen
    "support",  # share of the levels left that could be paired right after it
    "rivals",  # later measurements that it could be paired with instead
)  # fmt: skip
"""`candidates`: K rows of these, by ascending D²_ij."""

PATH_FIELDS = (
    "decided",  # share of the measurements
    "left",  # later levels with a candidate
    "pairings",  # so far
    "paired",  # share of the decided measurements
    "distance",  # D²_H, by its gate
    "compatible",  # individually compatible features of the measurement
    "hidden",  # legal candidates that are not on offer
    "support",  # share of the levels left that could be paired if the measurement is not
)
"""`path`: the decisions so far, and what is ahead."""

PAIRING_FIELDS = ("present", "x", "y", "innovation_x", "innovation_y")
"""`pairings`: rows of the `PAIRINGS` most recent ones, last first: measurement in R and innovation."""

PAIRINGS = 8

POSITION_SCALE, SIGMA_SCALE, INNOVATION_SCALE, SIZE_SCALE = 6.0, 0.1, 0.3, 1.0  # [m]
AGE_SCALE = 50.0  # [steps]
COUNT_SCALE, FEW_SCALE = 10.0, 3.0

_ALL_LOCAL = np.empty((0, 0), np.bool_)


def lengths(candidates: int) -> dict[str, int]:
    """Length of each vector of an observation with K = `candidates`."""
    return {
        "measurement": len(MEASUREMENT_FIELDS),
        "candidates": candidates * len(CANDIDATE_FIELDS),
        "path": len(PATH_FIELDS),
        "pairings": PAIRINGS * len(PAIRING_FIELDS),
    }


def nothing(candidates: int) -> Observation:
    """The observation where there is nothing to decide."""
    return {name: np.zeros(length, np.float32) for name, length in lengths(candidates).items()}


def encode(walk: Walk) -> Observation:
    """The observation of a walk; that of `nothing` where it is done."""
    if walk.done:
        return nothing(walk.K)
    tree, offered, path = walk.tree, walk.offered, walk.path
    scan, prediction, i = tree.scan, tree.prediction, walk.measurement
    support, rivals, without, left = walk.outlook()
    starts, level = walk.candidates.starts, walk.level
    candidates = _candidates(
        walk.K,
        walk.rows,
        tree.slots[offered],
        tree.slots[path],
        prediction.positions,
        walk.candidates.innovations[offered],
        walk.individual_distances,
        walk.joint_distances,
        tree.gates[1],
        tree.gates[walk.pairings + 1],
        scan.sizes[i],
        scan.size_variances[i],
        prediction.sizes,
        prediction.size_variances,
        _ALL_LOCAL if prediction.local is None else walk.local(),
        prediction.near,
        prediction.ages,
        support,
        rivals,
        left,
    )
    compatible = starts[level + 1] - starts[level]
    return {
        "measurement": _measurement(scan.points[i], scan.covariances[i], scan.sizes[i]),
        "candidates": candidates,
        "path": _path(
            level, tree.levels, walk.pairings, walk.distance, tree.gates, compatible, walk.hidden, without, left
        ),
        "pairings": _pairings(scan.points, walk.candidates.measured[path], walk.candidates.innovations[path]),
    }


@compiled
def _squash(value: float, scale: float) -> float:
    return value / (abs(value) + scale)


@compiled
def _path(
    level: int,
    levels: int,
    p: int,
    distance: float,
    gates: Array,
    compatible: int,
    hidden: int,
    without: int,
    left: int,
) -> NDArray[np.float32]:
    """`PATH_FIELDS`."""
    out = np.zeros(8, np.float32)
    out[0], out[1], out[2] = level / levels, left / (left + COUNT_SCALE), p / (p + COUNT_SCALE)
    out[3] = p / max(level, 1)
    out[4] = distance / (distance + gates[p]) if p > 0 else 0.0
    out[5], out[6] = compatible / (compatible + FEW_SCALE), hidden / (hidden + FEW_SCALE)
    out[7] = without / max(left, 1)
    return out


@compiled
def _measurement(point: Array, covariance: Array, size: float) -> NDArray[np.float32]:
    """`MEASUREMENT_FIELDS`."""
    out = np.zeros(6, np.float32)
    sx, sy = math.sqrt(max(covariance[0, 0], 0.0)), math.sqrt(max(covariance[1, 1], 0.0))
    out[0], out[1] = _squash(point[0], POSITION_SCALE), _squash(point[1], POSITION_SCALE)
    out[2], out[4] = _squash(sx, SIGMA_SCALE), _squash(sy, SIGMA_SCALE)
    out[3] = 0.0 if sx * sy == 0.0 else max(-1.0, min(1.0, covariance[0, 1] / (sx * sy)))
    out[5] = 0.0 if math.isnan(size) else _squash(size, SIZE_SCALE)
    return out


@compiled
def _candidates(
    K: int,
    rows: IntArray,
    slots: IntArray,
    path: IntArray,
    positions: Array,
    innovations: Array,
    individual: Array,
    joint: Array,
    gate: float,
    joint_gate: float,
    size: float,
    variance: float,
    sizes: Array,
    variances: Array,
    local: BoolArray,
    near: BoolArray,
    ages: IntArray,
    support: IntArray,
    rivals: IntArray,
    left: int,
) -> NDArray[np.float32]:
    """`CANDIDATE_FIELDS` of k candidates; `path` (p,) are the slots paired so far; empty `local`, `near` mean all."""
    out = np.zeros((K, 13), np.float32)
    for k in range(len(rows)):
        j, row = rows[k], out[k]
        row[0] = 1.0
        row[1], row[2] = _squash(positions[j, 0], POSITION_SCALE), _squash(positions[j, 1], POSITION_SCALE)
        row[3], row[4] = _squash(innovations[k, 0], INNOVATION_SCALE), _squash(innovations[k, 1], INNOVATION_SCALE)
        row[5], row[6] = individual[k] / (individual[k] + gate), joint[k] / (joint[k] + joint_gate)
        difference = size - sizes[j]
        row[7] = _squash(difference * difference / (variance + variances[j]), 1.0)
        if math.isnan(row[7]):
            row[7] = -1.0
        covisible = 0
        for q in range(len(path)):
            covisible += 1 if len(local) == 0 or local[slots[k], path[q]] else 0
        row[8] = covisible / max(len(path), 1)
        row[9] = 1.0 if len(near) == 0 or near[j] else 0.0
        row[10] = 0.0 if len(ages) == 0 else _squash(float(ages[j]), AGE_SCALE)
        row[11], row[12] = support[k] / max(left, 1), _squash(float(rivals[k]), FEW_SCALE)
    return out.ravel()


@compiled
def _pairings(points: Array, measured: IntArray, innovations: Array) -> NDArray[np.float32]:
    """`PAIRING_FIELDS` of the last of the pairings (p,) made so far."""
    out = np.zeros((PAIRINGS, 5), np.float32)
    for q in range(min(PAIRINGS, len(measured))):
        p = len(measured) - 1 - q
        x, y = points[measured[p]]
        out[q, 0] = 1.0
        out[q, 1], out[q, 2] = _squash(x, POSITION_SCALE), _squash(y, POSITION_SCALE)
        out[q, 3], out[q, 4] = (
            _squash(innovations[p, 0], INNOVATION_SCALE),
            _squash(innovations[p, 1], INNOVATION_SCALE),
        )
    return out.ravel()
