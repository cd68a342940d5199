"""The network of the learned associator: log odds of each pairing, from features of the pairing and of its rivals.

With x_c the inputs of pairing c, centred, scaled and clipped to ±2.5, and the maximum taken over all pairings of a
measurement, or of a feature,

    h_c = max(0, A x_c + a),   g_c = (h_c, max of h over the rivals of its measurement, over those of its feature),
    log odds_c = wᵀx_c + vᵀ max(0, B g_c + b) + w₀.

So a pairing is judged beside its rivals; no other form of attention was needed. Inputs farther than ±2.5 from the
centre are rare in the training data: each such input halves the log odds, so that the model of `marginal` decides where
the situation is unfamiliar. The network is evaluated by plain loops over plain arrays, without a learning library.

All inputs come from the scan and the prediction. `INPUTS` lists those of one pairing in order. Any change of the list,
or of how an input is computed, requires a new `VERSION`, which refuses the shipped weights until they are trained
again.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_gym._jit import compiled
from slam_gym.association.prediction import Expected
from slam_gym.association.tracking.hypotheses import ScanProblem
from slam_gym.association.tree import Pairings, innovation_of, squared
from slam_gym.types import UNKNOWN_KIND, Array, IntArray, ScanArrays
from slam_gym.weights import cached, load

VERSION = 2
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
    "feature: probability that it is in view and faces the robot, .5 where nobody can tell",
    "feature: probability that it faces the robot, 1 where nobody can tell",
    "feature: log of 1 + its age [steps]",
    "feature: log of its sightings, 0 where nobody can tell",
    "feature: whether it is near",
    "scan: log of 1 + its measurements",
    "scan: fraction of measurements without a pairing",
    "scan: log of measurements to features in view that face the robot",
    "scan: whether anybody can tell what is in view",
    "scan: σ of the heading [rad]",
    "scan: log of √det of the predicted features, the mean [m²]",
    "run: log of the density of what is not in the map [1/m²], as far as it is known",
    "run: whether there were scans before",
)
_LEAST_SIZE = -6.0  # lower bound of the input of sizes
_MIN_GAP, _MAX_GAP = 1e-2, 30.0  # [m] limits of the distance between neighbours
FARTHEST = 2.5  # [scales] bound of an input, from the centre; inputs beyond are clipped and halve the log odds


class Network(NamedTuple):
    """The weights for n inputs and h hidden units. Without hidden units this is a logistic model."""

    centre: Array  # (n,)
    scale: Array  # (n,)
    linear: Array  # (n,) w
    offset: Array  # (1,) w₀
    first: Array  # (h, n) A
    first_offset: Array  # (h,) a
    second: Array  # (h, 3h) B
    second_offset: Array  # (h,) b
    last: Array  # (h,) v


NO_NETWORK = Network(*(np.empty(shape) for shape in (0, 0, 0, 0, (0, 0), 0, (0, 0), 0, 0)))
"""The network that adds no odds."""

SHAPES = {
    "centre": (len(INPUTS),), "scale": (len(INPUTS),), "linear": (len(INPUTS),), "offset": (1,),
    "first": (-1, len(INPUTS)), "first_offset": (-1,), "second": (-1, -1), "second_offset": (-1,), "last": (-1,),
}  # fmt: skip
"""The arrays of weights; −1 stands for any length."""


@cached
def load_network(weights: str | Path) -> Network:
    """The network with shipped weights, or those of a `.npz` file. Raises ValueError as `slam_gym.weights.load` and
    `network_of`."""
    return network_of(load(weights, VERSION, INPUTS, SHAPES).arrays)


def network_of(arrays: Mapping[str, NDArray[Any]]) -> Network:
    """The network of arrays by name. Raises ValueError where their numbers of hidden units differ."""
    network = Network(**{name: np.array(arrays[name], np.float64, order="C") for name in Network._fields})
    h = len(network.last)
    if not len(network.first) == len(network.first_offset) == len(network.second) == len(network.second_offset) == h:
        raise ValueError(f"first, second, last: not {h} hidden units everywhere")
    if network.second.shape[1] != 3 * h:
        raise ValueError(f"second: {network.second.shape[1]} columns, expected {3 * h}")
    if not (network.scale > 0.0).all():
        raise ValueError("scale: not positive")
    return network


@compiled
def log_odds(network: Network, inputs: Array, measured: IntArray, slots: IntArray) -> Array:
    """Log odds (c,) of the pairings of measurements `measured` (c,) with features `slots` (c,)."""
    count, h = len(inputs), len(network.last)
    scaled = (inputs - network.centre) / network.scale
    x = np.minimum(np.maximum(scaled, -FARTHEST), FARTHEST)
    out, trust = np.full(count, network.offset[0]), np.ones(count)
    for c in range(count):
        for n in range(x.shape[1]):
            out[c] += network.linear[n] * x[c, n]
            trust[c] *= 1.0 if x[c, n] == scaled[c, n] else 0.5
    if h == 0 or count == 0:
        out *= trust
        return out
    hidden = np.zeros((count, h))
    of_measurement, of_feature = np.zeros((measured.max() + 1, h)), np.zeros((slots.max() + 1, h))
    for c in range(count):
        for k in range(h):
            total = network.first_offset[k]
            for n in range(x.shape[1]):
                total += network.first[k, n] * x[c, n]
            hidden[c, k] = max(total, 0.0)
            of_measurement[measured[c], k] = max(of_measurement[measured[c], k], hidden[c, k])
            of_feature[slots[c], k] = max(of_feature[slots[c], k], hidden[c, k])
    for c in range(count):
        measurement_max, feature_max = of_measurement[measured[c]], of_feature[slots[c]]
        for k in range(h):
            total = network.second_offset[k]
            for n in range(h):
                total += network.second[k, n] * hidden[c, n]
                total += network.second[k, h + n] * measurement_max[n] + network.second[k, 2 * h + n] * feature_max[n]
            out[c] += network.last[k] * max(total, 0.0)
    out *= trust
    return out


@compiled
def inputs_of(scan: ScanArrays, problem: ScanProblem, expected: Expected, run: tuple[float, float]) -> Array:
    """Inputs (c, inputs) of each pairing in a narrow heading, none of which is fixed.

    `run`: log density of measurements of nothing in the map [1/m²], and whether there were scans before.
    """
    part, pairings, rows, visible = problem.part, problem.offer.pairings, problem.offer.rows, problem.visible
    points, count, m = scan[0], len(pairings.slots), len(scan[0])
    out, weight = np.empty((count, len(INPUTS))), np.empty(count)
    by_measurement, by_feature = np.zeros((m, 2)), np.zeros((len(rows), 2))  # number of pairings, sum of weights
    for c in range(count):
        weight[c] = _of_pairing(scan, pairings, rows, expected, c, out[c])
        by_measurement[pairings.measured[c], 0] += 1.0
        by_feature[pairings.slots[c], 0] += 1.0
        by_measurement[pairings.measured[c], 1] += weight[c]
        by_feature[pairings.slots[c], 1] += weight[c]
    measurement_gaps, feature_gaps = _nearest(points), _nearest(part.positions)
    of_scan, spread, unmatched = np.empty(8), 0.0, 0
    facing_known = len(visible) > 0 and len(expected.visible) == 0
    for i in range(m):
        unmatched += by_measurement[i, 0] == 0.0
    for P in part.covariances:
        spread += 0.5 * math.log(max(P[0, 0] * P[1, 1] - P[0, 1] * P[1, 0], 1e-12)) / len(part.covariances)
    in_view = visible.sum() if len(visible) > 0 else float(len(part.positions))
    # inputs of the scan and the run, the same for all pairings
    of_scan[0], of_scan[1], of_scan[2] = math.log1p(m), unmatched / max(m, 1), math.log((1.0 + m) / (1.0 + in_view))
    of_scan[3], of_scan[4] = 1.0 if len(visible) > 0 else 0.0, math.sqrt(max(part.variance, 0.0))
    of_scan[5], of_scan[6], of_scan[7] = spread, run[0], run[1]
    for c in range(count):
        i, s = pairings.measured[c], pairings.slots[c]
        j, row = rows[s], out[c]
        row[7] = math.log(weight[c] / by_measurement[i, 1])
        row[8] = math.log(weight[c] / by_feature[s, 1])
        row[9], row[10] = math.log(by_measurement[i, 0]), math.log(by_feature[s, 0])
        row[11] = math.log1p(math.hypot(points[i, 0], points[i, 1]))
        row[12], row[13] = measurement_gaps[i], feature_gaps[j]
        row[14] = visible[j] if len(visible) > 0 else 0.5
        row[15] = expected.facing[j] if facing_known else 1.0
        row[16] = math.log1p(expected.ages[j])
        row[17] = math.log(max(expected.sightings[j], 1))
        row[18] = 1.0 if expected.near[j] else 0.0
        row[19:] = of_scan
    return out


@compiled
def _of_pairing(scan: ScanArrays, pairings: Pairings, rows: IntArray, expected: Expected, c: int, row: Array) -> float:
    """Write the inputs that concern the pairing alone. Returns its weight among rivals."""
    i, j, e = pairings.measured[c], rows[pairings.slots[c]], innovation_of(pairings, c)
    _, _, measured_sizes, measured_variances, measured_kinds = scan
    R, distance = pairings.noise[i], squared(e)
    variance, difference = measured_variances[i] + expected.size_variances[j], measured_sizes[i] - expected.sizes[j]
    size, sizes_known = 0.0, not (math.isnan(variance) or math.isnan(difference))
    if sizes_known:
        variance = max(variance, 1e-6)
        size = max(-0.5 * (difference * difference / variance + math.log(2.0 * math.pi * variance)), _LEAST_SIZE)
    kinds_known = measured_kinds[i] != UNKNOWN_KIND and expected.kinds[j] != UNKNOWN_KIND
    row[0], row[1] = size, 1.0 if sizes_known else 0.0
    row[2] = 1.0 if kinds_known and measured_kinds[i] == expected.kinds[j] else 0.0
    row[3] = 1.0 if kinds_known and measured_kinds[i] != expected.kinds[j] else 0.0
    area = 0.5 * math.log(max(e.xx * e.yy - e.xy * e.xy, 1e-12))
    row[4], row[5] = distance, area
    row[6] = 0.5 * math.log(max(R[0, 0] * R[1, 1] - R[0, 1] * R[1, 0], 1e-12))
    return math.exp(size - 0.5 * min(distance, 50.0) - area)


@compiled
def _nearest(points: Array) -> Array:
    """log of the distance (n,) of each point to the nearest other one."""
    out = np.empty(len(points))
    for a in range(len(points)):
        least = _MAX_GAP
        for b in range(len(points)):
            if a != b:
                least = min(least, math.hypot(points[a, 0] - points[b, 0], points[a, 1] - points[b, 1]))
        out[a] = math.log(max(least, _MIN_GAP))
    return out
