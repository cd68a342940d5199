"""What a policy that walks the interpretation tree decides on: flat float32 vectors, scaled into [−1, 1].

Values without a bound are squashed: v / (|v| + scale), which is 0 at 0 and ±½ at ±scale.
"""

import math
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.prediction import PredictionArrays, expected_of
from slam_gym.association.tree import (
    Innovation,
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
from slam_gym.association.walks import (
    MEASURED_FIELDS,
    POSITION_SCALE,
    Float32Array,
    Observation,
    measurement_shown,
    squash,
)
from slam_gym.types import Array, BoolArray, IntArray, ScanArrays

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
    "sightings",  # scans that updated or started it; 0 if the prediction is not made from a map
    "confirmed",  # 1 where it has as many sightings as confirm a feature
    "rivals",  # later measurements that it could be paired with instead
    "spread",  # √det S_ij, given the path
    "evidence",  # log N(e; 0, S) given the path, over the density of measurements of nothing in the map
    "outlook",  # what taking it adds to the evidence of the levels left, each by its best pairing
    "odds",  # evidence and outlook together
    "margin",  # by which they exceed the best odds among the others on offer, `*` (0) included
)  # fmt: skip
"""`candidates`: K rows of these, by ascending D²_ij. All innovations of a scan share the error of the predicted pose,
most of all that of its heading: `outlook` tells whether the other measurements fall into place once a pairing has
corrected it."""

PATH_FIELDS = (
    "decided",  # fraction of the measurements
    "left",  # later levels with a candidate
    "pairings",  # so far
    "paired",  # fraction of the decided measurements
    "distance",  # D²_H, by its gate
    "compatible",  # individually compatible features of the measurement
    "hidden",  # legal candidates that are not on offer
    "heading",  # σ of the predicted heading
)
"""`path`: the decisions so far, and what is ahead."""

INNOVATION_SCALE = 0.3  # [m]
AGE_SCALE = 50.0  # [steps]
SPREAD_SCALE, HEADING_SCALE = 0.05, 0.05  # [m²], [rad]
ODDS_SCALE = 5.0
COUNT_SCALE, FEW_SCALE = 10.0, 3.0
CLUTTER_DENSITY = 0.02  # [1/m²] of measurements of nothing in the map, for `evidence`

_SEEN = -1  # in place of a level
_squash = compiled(squash)


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
    """What lies beyond the level at hand, by pairing on offer."""

    rivals: IntArray  # (k,) later pairings with the same feature
    evidence: Array  # (k,)
    outlook: Array  # (k,)
    left: int  # levels that have a candidate


def lengths(candidates: int) -> dict[str, int]:
    """Length of each vector of an observation with K = `candidates`."""
    return {
        "measurement": len(MEASUREMENT_FIELDS),
        "candidates": candidates * len(CANDIDATE_FIELDS),
        "path": len(PATH_FIELDS),
    }


def nothing(candidates: int) -> Observation:
    """The observation where there is nothing to decide."""
    return {name: np.zeros(length, np.float32) for name, length in lengths(candidates).items()}


def encode(tree: Tree, node: Node, local: BoolArray, choice: Choice) -> Observation:
    """The observation at a node with a choice, where `local` (u, u) tells which features are local to each other."""
    scan, prediction = tree.scan, tree.prediction
    measurement = np.array(measurement_shown(scan, int(tree.pairings.measured[choice.offered[0]])), np.float32)
    mapped = prediction.arrays, tree.rows, prediction.confirmations, local
    candidates, path = _encode(tree.pairings, node, tree.candidates.distances, tree.gates, scan.arrays, mapped, choice)
    return {"measurement": measurement, "candidates": candidates, "path": path}


@compiled
def _encode(
    pairings: Pairings,
    node: Node,
    individual: Array,
    gates: Array,
    scan: ScanArrays,
    mapped: tuple[PredictionArrays, IntArray, int, BoolArray],
    choice: Choice,
) -> tuple[Float32Array, Float32Array]:
    """`CANDIDATE_FIELDS` and `PATH_FIELDS`.

    `individual` (c,) are D²_ij of all pairings. `mapped`: the prediction, its row for each slot (u,), the sightings
    that confirm a feature, and which features are local to each other, by slot.
    """
    ahead, p, path = _outlook(pairings, node, choice), len(node.path), np.zeros(len(PATH_FIELDS), np.float32)
    (prediction, rows, confirmations, local), odds = mapped, ahead.evidence + ahead.outlook
    expected = expected_of(prediction[0], prediction[1], prediction[2])
    candidates, sizes, variances = np.zeros((choice.candidates, len(CANDIDATE_FIELDS)), np.float32), scan[2], scan[3]
    for k in range(len(choice.offered)):
        c, row = choice.offered[k], candidates[k]
        i, slot, joint = pairings.measured[c], pairings.slots[c], node.distance + node.added[c]
        j = rows[slot]
        row[0] = 1.0
        row[1] = _squash(expected.positions[j, 0], POSITION_SCALE)
        row[2] = _squash(expected.positions[j, 1], POSITION_SCALE)
        row[3] = _squash(pairings.innovations[c, 0], INNOVATION_SCALE)
        row[4] = _squash(pairings.innovations[c, 1], INNOVATION_SCALE)
        row[5], row[6] = individual[c] / (individual[c] + gates[1]), joint / (joint + gates[p + 1])
        difference = sizes[i] - expected.sizes[j]
        row[7] = _squash(difference * difference / (variances[i] + expected.size_variances[j]), 1.0)
        if math.isnan(row[7]):
            row[7] = -1.0
        covisible = 0
        for d in node.path:
            covisible += is_local(local, slot, pairings.slots[d])
        row[8] = covisible / max(p, 1)
        row[9], row[10] = 1.0 if expected.near[j] else 0.0, _squash(float(expected.ages[j]), AGE_SCALE)
        row[11] = _squash(float(expected.sightings[j]), COUNT_SCALE)
        row[12] = 1.0 if expected.sightings[j] >= confirmations else 0.0
        row[13], e, best = _squash(float(ahead.rivals[k]), FEW_SCALE), read(node.innovations, c), 0.0
        for other in range(len(odds)):
            if other != k:
                best = max(best, odds[other])
        row[14] = _squash(math.sqrt(max(e.xx * e.yy - e.xy * e.xy, 0.0)), SPREAD_SCALE)
        row[15], row[16] = _squash(ahead.evidence[k], ODDS_SCALE), _squash(ahead.outlook[k], ODDS_SCALE)
        row[17], row[18] = _squash(odds[k], ODDS_SCALE), _squash(odds[k] - best, ODDS_SCALE)
    path[0], path[1] = choice.level / choice.levels, _squash(float(ahead.left), COUNT_SCALE)
    path[2], path[3] = _squash(float(p), COUNT_SCALE), p / max(choice.level, 1)
    path[4] = node.distance / (node.distance + gates[p]) if p > 0 else 0.0
    path[5], path[6] = _squash(float(choice.compatible), FEW_SCALE), _squash(float(choice.hidden), FEW_SCALE)
    path[7] = _squash(math.sqrt(max(expected.pose[3], 0.0)), HEADING_SCALE)
    return candidates.ravel(), path


@compiled
def _outlook(pairings: Pairings, node: Node, choice: Choice) -> _Outlook:
    """Each pairing on offer conditions those of later levels; a feature that is taken adds nothing to them."""
    slots, measured, p, count = pairings.slots, pairings.measured, len(node.path), len(pairings.slots)
    free, without, best, left, level = np.empty(count, np.bool_), 0.0, 0.0, 0, _SEEN
    for c in range(choice.later, count):
        if measured[c] != level:
            left, level, without, best = left + 1, measured[c], without + best, 0.0
        free[c] = may_follow(pairings, node.path, p, c)
        if free[c]:
            best = max(best, _evidence(read(node.innovations, c)))
    without += best
    offered = choice.offered
    rivals, evidence, outlook = np.zeros(len(offered), np.int64), np.empty(len(offered)), np.empty(len(offered))
    for k in range(len(offered)):
        a, e = offered[k], read(node.innovations, offered[k])
        pivot, total, best, level = pivot_of(slots[a], e), 0.0, 0.0, _SEEN
        for c in range(choice.later, count):
            rivals[k] += slots[c] == slots[a]
            if measured[c] != level:
                level, total, best = measured[c], total + best, 0.0
            if free[c] and slots[c] != slots[a]:
                given = condition(pairings.covariance, node.w, pivot, a, p, c, slots[c], read(node.innovations, c))
                best = max(best, _evidence(given))
        evidence[k], outlook[k] = _evidence(e), total + best - without
    return _Outlook(rivals, evidence, outlook, left)


@compiled
def _evidence(e: Innovation) -> float:
    """log N(e; 0, S) − log λ, λ the density of measurements of nothing in the map; −inf where S is not positive."""
    determinant = e.xx * e.yy - e.xy * e.xy
    if not determinant > 0.0:
        return -math.inf
    return -0.5 * squared(e) - 0.5 * math.log(determinant) - math.log(2.0 * math.pi * CLUTTER_DENSITY)
