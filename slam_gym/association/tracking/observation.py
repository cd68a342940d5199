"""What a policy that walks the interpretation tree decides on: flat float32 vectors, scaled into [−1, 1].

Values without a bound are squashed: v / (|v| + scale), which is 0 at 0 and ±½ at ±scale.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.compatibility import plain
from slam_gym.association.tree import (
    Node,
    Pairings,
    Tree,
    condition,
    is_local,
    may_follow,
    pivot_of,
    read,
    squared,
)
from slam_gym.association.walks import MEASURED_FIELDS, POSITION_SCALE, Float32Array, Observation, measurement_shown
from slam_gym.types import Array, BoolArray, IntArray

MEASUREMENT_FIELDS = MEASURED_FIELDS
"""`measurement`: the one to decide now."""

CANDIDATE_FIELDS = (
    "legal",  # 1 where there is a candidate; where there is none, the row is 0
    "x", "y",  # where the map expected it, in R
    "innovation_x", "innovation_y",  # ν_ij
    "individual",  # D²_ij, by its gate
    "joint",  # D²_H if taken, by its gate
    "size",  # (a_i − a_j)² / (σ_i² + σ_j²), by 1; −1 where a size is unknown
    "covisible",  # fraction of the features paired so far that it is local to; without locality all are, to all
    "near",  # 1 where it was paired in a recent scan or is local to one that was, or where there is no locality
    "age",  # steps since it was first seen
    "support",  # fraction of the levels left that could be paired right after it
    "rivals",  # later measurements that it could be paired with instead
)  # fmt: skip
"""`candidates`: K rows of these, by ascending D²_ij."""

PATH_FIELDS = (
    "decided",  # fraction of the measurements
    "left",  # later levels with a candidate
    "pairings",  # so far
    "paired",  # fraction of the decided measurements
    "distance",  # D²_H, by its gate
    "compatible",  # individually compatible features of the measurement
    "hidden",  # legal candidates that are not on offer
    "support",  # fraction of the levels left that could be paired if the measurement is not
)
"""`path`: the decisions so far, and what is ahead."""

PAIRING_FIELDS = ("present", "x", "y", "innovation_x", "innovation_y")
"""`pairings`: rows of the `PAIRINGS` most recent ones, last first: measurement in R and innovation."""

PAIRINGS = 8

INNOVATION_SCALE = 0.3  # [m]
AGE_SCALE = 50.0  # [steps]
COUNT_SCALE, FEW_SCALE = 10.0, 3.0

_ALL_LOCAL = np.empty((0, 0), np.bool_)
_SEEN = -1  # in place of a level


class Surroundings(NamedTuple):
    """What is known of a scan's measurements and of the features that they may be paired with."""

    points: Array  # (m, 2) [m] in R
    sizes: Array  # (m,) [m], and their variances (m,) [m²]
    size_variances: Array
    positions: Array  # (u, 2) [m] in R, by slot
    mapped_sizes: Array  # (u,) [m], and their variances (u,) [m²]
    mapped_size_variances: Array
    near: BoolArray  # (u,)
    ages: IntArray  # (u,) [steps]
    local: BoolArray  # (u, u) or (0, 0)


class Choice(NamedTuple):
    """What is on offer at a level."""

    level: int
    levels: int
    candidates: int  # K
    offered: IntArray  # (k,) pairings, k ≤ K
    hidden: int  # legal ones that are not on offer
    compatible: int  # individually compatible ones
    later: int  # where the pairings of later levels begin


class _Outlook(NamedTuple):
    """What lies beyond the level at hand."""

    support: IntArray  # (k,) by pairing on offer: later levels that could be paired right after it
    rivals: IntArray  # (k,) later pairings with the same feature
    without: int  # levels that could be paired next if it is none of them
    left: int  # levels that have a candidate at all


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


def surroundings_of(tree: Tree) -> Surroundings:
    """Of a tree's scan and the features that it may pair."""
    scan, prediction, rows = tree.scan, tree.prediction, tree.rows
    return Surroundings(
        plain(scan.points),
        plain(scan.sizes),
        plain(scan.size_variances),
        prediction.positions[rows],
        prediction.sizes[rows],
        prediction.size_variances[rows],
        prediction.near[rows],
        prediction.ages[rows],
        prediction.local(rows) if prediction.has_localities else _ALL_LOCAL,
    )


def encode(tree: Tree, node: Node, surroundings: Surroundings, choice: Choice) -> Observation:
    """The observation at a node with a choice. Fresh arrays."""
    measurement = np.array(measurement_shown(tree.scan, int(tree.pairings.measured[choice.offered[0]])), np.float32)
    candidates, path, pairings = _encode(
        tree.pairings, node, tree.candidates.distances, tree.gates, surroundings, choice
    )
    return {"measurement": measurement, "candidates": candidates, "path": path, "pairings": pairings}


@compiled
def _encode(
    pairings: Pairings, node: Node, individual: Array, gates: Array, surroundings: Surroundings, choice: Choice
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """`CANDIDATE_FIELDS`, `PATH_FIELDS` and `PAIRING_FIELDS`; `individual` (c,) are D²_ij of all pairings."""
    ahead, p = _outlook(pairings, node, gates, choice), len(node.path)
    candidates = _candidates(pairings, node, individual, gates, surroundings, choice, ahead)
    path, last = np.zeros(8, np.float32), np.zeros((PAIRINGS, 5), np.float32)
    path[0], path[1] = choice.level / choice.levels, ahead.left / (ahead.left + COUNT_SCALE)
    path[2], path[3] = p / (p + COUNT_SCALE), p / max(choice.level, 1)
    path[4] = node.distance / (node.distance + gates[p]) if p > 0 else 0.0
    path[5] = choice.compatible / (choice.compatible + FEW_SCALE)
    path[6], path[7] = choice.hidden / (choice.hidden + FEW_SCALE), ahead.without / max(ahead.left, 1)
    for q in range(min(PAIRINGS, p)):
        c = node.path[p - 1 - q]
        x, y = surroundings.points[pairings.measured[c]]
        last[q, 0] = 1.0
        last[q, 1], last[q, 2] = _squash(x, POSITION_SCALE), _squash(y, POSITION_SCALE)
        last[q, 3] = _squash(pairings.innovations[c, 0], INNOVATION_SCALE)
        last[q, 4] = _squash(pairings.innovations[c, 1], INNOVATION_SCALE)
    return candidates, path, last.ravel()


@compiled
def _squash(value: float, scale: float) -> float:
    return value / (abs(value) + scale)


@compiled
def _outlook(pairings: Pairings, node: Node, gates: Array, choice: Choice) -> _Outlook:
    """A feature that is taken supports nothing, and only what would be jointly compatible does."""
    slots, measured, p, count = pairings.slots, pairings.measured, len(node.path), len(pairings.slots)
    after, without_it = gates[min(p + 2, len(gates) - 1)], gates[min(p + 1, len(gates) - 1)]
    free, without, left, seen, counted = np.empty(count, np.bool_), 0, 0, _SEEN, _SEEN
    for c in range(choice.later, count):
        free[c] = may_follow(pairings, node.path, p, c)
        if measured[c] != seen:
            left, seen = left + 1, measured[c]
        if measured[c] != counted and free[c] and node.distance + node.added[c] < without_it:
            without, counted = without + 1, measured[c]
    support, rivals = np.zeros(len(choice.offered), np.int64), np.zeros(len(choice.offered), np.int64)
    for k in range(len(choice.offered)):
        a = choice.offered[k]
        pivot, counted = pivot_of(slots[a], read(node.innovations, a)), _SEEN
        for c in range(choice.later, count):
            rivals[k] += slots[c] == slots[a]
            if measured[c] == counted or not free[c] or slots[c] == slots[a]:
                continue
            e = condition(pairings.covariance, node.w, pivot, a, p, c, slots[c], read(node.innovations, c))
            if node.distance + node.added[a] + squared(e) < after:
                support[k], counted = support[k] + 1, measured[c]
    return _Outlook(support, rivals, without, left)


@compiled
def _candidates(
    pairings: Pairings,
    node: Node,
    individual: Array,
    gates: Array,
    around: Surroundings,
    choice: Choice,
    ahead: _Outlook,
) -> Float32Array:
    """`CANDIDATE_FIELDS` of what is on offer."""
    out, p = np.zeros((choice.candidates, 13), np.float32), len(node.path)
    for k in range(len(choice.offered)):
        c, row = choice.offered[k], out[k]
        i, j, joint = pairings.measured[c], pairings.slots[c], node.distance + node.added[c]
        row[0] = 1.0
        row[1], row[2] = (
            _squash(around.positions[j, 0], POSITION_SCALE),
            _squash(around.positions[j, 1], POSITION_SCALE),
        )
        row[3] = _squash(pairings.innovations[c, 0], INNOVATION_SCALE)
        row[4] = _squash(pairings.innovations[c, 1], INNOVATION_SCALE)
        row[5], row[6] = individual[c] / (individual[c] + gates[1]), joint / (joint + gates[p + 1])
        difference = around.sizes[i] - around.mapped_sizes[j]
        row[7] = _squash(difference * difference / (around.size_variances[i] + around.mapped_size_variances[j]), 1.0)
        if math.isnan(row[7]):
            row[7] = -1.0
        covisible = 0
        for d in node.path:
            covisible += is_local(around.local, j, pairings.slots[d])
        row[8] = covisible / max(p, 1)
        row[9], row[10] = 1.0 if around.near[j] else 0.0, _squash(float(around.ages[j]), AGE_SCALE)
        row[11], row[12] = ahead.support[k] / max(ahead.left, 1), _squash(float(ahead.rivals[k]), FEW_SCALE)
    return out.ravel()
