"""What the learned log odds of a pairing are computed from: numbers about it, about its rivals, and about the scan.

All of it is in the scan and the prediction. The numbers of one pairing are those of `INPUTS`, in that order; any change
of them, or of how one is computed, is a new `VERSION`, and the weights that ship are refused until they are trained
again.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.compatibility import plain
from slam_gym.association.tree import Pairings, Tree, innovation_of, squared
from slam_gym.types import UNKNOWN_KIND, Array, Experience, IntArray, Prediction

VERSION = 1
INPUTS = (
    "size: log N(a_i − a_j; 0, s²) − log of one in a metre, not below −6; 0 where one is unknown",
    "size: whether both are known",
    "kind: the same",
    "kind: another",
    "place: D²_ij",
    "place: log of √det S_ij [m²]",
    "place: log of √det R_i [m²]",
    "rivals: log of this pairing's part of those of its measurement, by place and size",
    "rivals: log of this pairing's part of those of its feature, by place and size",
    "rivals: log of the pairings of its measurement",
    "rivals: log of the pairings of its feature",
    "measurement: log of 1 + range [m]",
    "measurement: log of the distance to the next one [m]",
    "feature: log of the distance to the next one [m]",
    "feature: probability that it is in view, .5 where nobody can tell",
    "feature: log of 1 + its age [steps]",
    "feature: log of its sightings, 0 where nobody can tell",
    "feature: whether it is near",
    "scan: log of 1 + its measurements",
    "scan: fraction of measurements without a pairing",
    "scan: log of measurements to features in view",
    "scan: whether anybody can tell what is in view",
    "scan: σ of the heading [rad]",
    "scan: log of √det of the predicted features, the mean [m²]",
    "run: log of the density of what is not in the map [1/m²], as far as it is known",
    "run: whether there were scans before",
)
_LEAST_SIZE = -6.0
_NEAREST, _FARTHEST = 1e-2, 30.0  # [m] between neighbours
_UNPAIRED, _AREA = 1.0, 50.0  # [m²] what is taken for known before the first scan


class Known(NamedTuple):
    """What is known of the prediction's features (k,), as far as it is."""

    positions: Array  # (k, 2) [m]
    covariances: Array  # (k, 2, 2) [m²]
    sizes: Array  # (k,) [m]
    size_variances: Array  # (k,) [m²]
    kinds: IntArray  # (k,)
    ages: IntArray  # (k,) [steps]
    sightings: IntArray  # (k,) or (0,)
    visibility: Array  # (k,) or (0,)


class Seen(NamedTuple):
    """The measurements (m,)."""

    points: Array  # (m, 2) [m]
    sizes: Array  # (m,) [m]
    size_variances: Array  # (m,) [m²]
    kinds: IntArray  # (m,)


def inputs_of(tree: Tree, visibility: Array | None) -> Array:
    """(c, inputs) of each pairing of a tree of which none is given; `visibility` (k,) of the prediction's features."""
    scan, prediction = tree.scan, tree.prediction
    seen = Seen(plain(scan.points), plain(scan.sizes), plain(scan.size_variances), plain(scan.kinds))
    near = plain(prediction.near).astype(np.float64)
    return numbers_of(tree.pairings, tree.rows, seen, _known(prediction, visibility), near, _run(prediction))


def _known(prediction: Prediction, visibility: Array | None) -> Known:
    nobody, uncounted = np.empty(0), np.empty(0, np.int64)
    return Known(
        plain(prediction.positions),
        plain(prediction.covariances),
        plain(prediction.sizes),
        plain(prediction.size_variances),
        plain(prediction.kinds),
        plain(prediction.ages),
        uncounted if prediction.sightings is None else plain(prediction.sightings),
        nobody if visibility is None else visibility,
    )


def _run(prediction: Prediction) -> tuple[float, float, float]:
    """σ of the heading, and the two inputs on the run so far."""
    return math.sqrt(max(prediction.heading_variance, 0.0)), *run_so_far(prediction.experience)


def run_so_far(past: Experience | None) -> tuple[float, float]:
    """The two inputs on the run so far."""
    if past is None:
        return math.log(_UNPAIRED / _AREA), 0.0
    return math.log((_UNPAIRED + past.unpaired) / (_AREA + past.area)), 1.0


@compiled
def numbers_of(
    pairings: Pairings, rows: IntArray, seen: Seen, known: Known, near: Array, run: tuple[float, float, float]
) -> Array:
    count, m = len(pairings.slots), len(seen.points)
    out, weight = np.empty((count, 26)), np.empty(count)
    by_measurement, by_feature = np.zeros((m, 2)), np.zeros((len(rows), 2))  # number of pairings, sum of weights
    for c in range(count):
        weight[c] = _of_pairing(pairings, rows, seen, known, c, out[c])
        by_measurement[pairings.measured[c], 0] += 1.0
        by_feature[pairings.slots[c], 0] += 1.0
        by_measurement[pairings.measured[c], 1] += weight[c]
        by_feature[pairings.slots[c], 1] += weight[c]
    apart, neighbours = _nearest(seen.points), _nearest(known.positions)
    scan = _of_scan(by_measurement, known, run)
    for c in range(count):
        i, s = pairings.measured[c], pairings.slots[c]
        j, row = rows[s], out[c]
        row[7] = math.log(weight[c] / by_measurement[i, 1])
        row[8] = math.log(weight[c] / by_feature[s, 1])
        row[9], row[10] = math.log(by_measurement[i, 0]), math.log(by_feature[s, 0])
        row[11] = math.log1p(math.hypot(seen.points[i, 0], seen.points[i, 1]))
        row[12], row[13] = apart[i], neighbours[j]
        row[14] = known.visibility[j] if len(known.visibility) > 0 else 0.5
        row[15] = math.log1p(known.ages[j])
        row[16] = math.log(max(known.sightings[j], 1)) if len(known.sightings) > 0 else 0.0
        row[17] = near[j]
        row[18:] = scan
    return out


@compiled
def _of_pairing(pairings: Pairings, rows: IntArray, seen: Seen, known: Known, c: int, row: Array) -> float:
    """Enter what concerns the pairing alone; its weight among rivals."""
    i, j, e = pairings.measured[c], rows[pairings.slots[c]], innovation_of(pairings, c)
    R, distance = pairings.noise[i], squared(e)
    size, both = 0.0, not (math.isnan(seen.sizes[i]) or math.isnan(known.sizes[j]))
    if both:
        variance, difference = seen.size_variances[i] + known.size_variances[j], seen.sizes[i] - known.sizes[j]
        variance = max(variance, 1e-6)
        size = max(-0.5 * (difference * difference / variance + math.log(2.0 * math.pi * variance)), _LEAST_SIZE)
    told = seen.kinds[i] != UNKNOWN_KIND and known.kinds[j] != UNKNOWN_KIND
    row[0], row[1] = size, 1.0 if both else 0.0
    row[2] = 1.0 if told and seen.kinds[i] == known.kinds[j] else 0.0
    row[3] = 1.0 if told and seen.kinds[i] != known.kinds[j] else 0.0
    area = 0.5 * math.log(max(e.xx * e.yy - e.xy * e.xy, 1e-12))
    row[4], row[5] = distance, area
    row[6] = 0.5 * math.log(max(R[0, 0] * R[1, 1] - R[0, 1] * R[1, 0], 1e-12))
    return math.exp(size - 0.5 * min(distance, 50.0) - area)


@compiled
def _of_scan(by_measurement: Array, known: Known, run: tuple[float, float, float]) -> Array:
    """The inputs that are those of the scan and the run."""
    m, k, strange, expected, spread = len(by_measurement), len(known.positions), 0, 0.0, 0.0
    for i in range(m):
        if by_measurement[i, 0] == 0.0:
            strange += 1
    for j in range(k):
        P = known.covariances[j]
        spread += 0.5 * math.log(max(P[0, 0] * P[1, 1] - P[0, 1] * P[1, 0], 1e-12)) / k
    for j in range(len(known.visibility)):
        expected += known.visibility[j]
    told = len(known.visibility) > 0
    out = np.empty(8)
    out[0], out[1] = math.log1p(m), strange / max(m, 1)
    out[2] = math.log((1.0 + m) / (1.0 + (expected if told else k)))
    out[3] = 1.0 if told else 0.0
    out[4], out[5], out[6], out[7] = run[0], spread, run[1], run[2]
    return out


@compiled
def _nearest(points: Array) -> Array:
    """log of the distance of each point (n,) to the next."""
    out = np.empty(len(points))
    for a in range(len(points)):
        least = _FARTHEST
        for b in range(len(points)):
            if a != b:
                least = min(least, math.hypot(points[a, 0] - points[b, 0], points[a, 1] - points[b, 1]))
        out[a] = math.log(max(least, _NEAREST))
    return out
