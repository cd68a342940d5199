"""The two compiled calls of a step of SLAM.

`predict` comes before association: check, move, predict the features in reach. `learn` follows the associator's answer:
update, add, maintain.
"""

from __future__ import annotations

import math

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.acceptance import unambiguous_rows
from slam_gym.association.compatibility import gate_pairings
from slam_gym.mapping import ekf
from slam_gym.mapping.covisibility import count_pairs, keep_nodes
from slam_gym.mapping.ekf import MapArrays
from slam_gym.mapping.measurement import Locality, RowArrays, foresee, keep_rows
from slam_gym.mapping.update import ACCEPTED, update
from slam_gym.types import NO_ID, UNPAIRED, Array, BoolArray, IntArray, ScanArrays
from slam_gym.validation import first_bad_measurement

BAD_ODOMETRY, BAD_SCAN = -1, -2  # returned by `predict` in place of a number of rows

Rule = tuple[float, bool, float, float]
"""Reach [m]; whether predictions are to second order; χ² gate of a pairing; number of accidental matches expected in
the gate of an old feature above which it is not offered."""

DONE, NARROW, REFUSED, SINGULAR, NOT_ADDED = range(5)  # outcomes of `learn`

GraphArrays = tuple[IntArray, IntArray, IntArray]  # neighbours, counts, degrees
Settings = tuple[int, float, bool, float, int, int]
"""Iterations; σ that settles them; right-invariant; χ² gate of a new feature; sightings that confirm; step before which
a feature must have been confirmed."""


@compiled
def predict(
    arrays: MapArrays,
    counts: tuple[int, int],
    odometry: tuple[Array, Array],
    scan: tuple[Array, Array],
    rule: Rule,
    locality: Locality,
    pose: Array,
    out: RowArrays,
) -> int:
    """Move the robot, and enter in `out` the features in reach that are not ambiguous.

    Returns their number k; or BAD_SCAN or BAD_ODOMETRY, and the robot does not move.

    Arguments:
        arrays: arrays of the map, in which the robot is moved.
        counts: number of its features, and number of steps that have ended in it.
        odometry: motion (3,) and its covariance (3, 3).
        scan: points (m, 2) and covariances (m, 2, 2), which are only checked.
        pose: (4,) receives the predicted pose and the variance of its heading.
    """
    (motion, Q), (points, noise), (reach, second_order, gate, most) = odometry, scan, rule
    if first_bad_measurement(points, noise)[1]:
        return BAD_SCAN
    moves = True
    k = foresee(arrays, counts, (moves, motion, Q), reach, second_order, locality, pose, out)
    if k < 0:
        return BAD_ODOMETRY
    if k > 0 and most < math.inf:
        known, _, near, positions, covariances, _ = out
        rows = known[0, :k], near[:k], positions[:k], covariances[:k], known[3, :k]
        kept = np.empty(k, np.int64)
        n_kept = unambiguous_rows(rows, arrays[1], k * gate / (reach * reach), most, kept)
        if n_kept < k:
            keep_rows(out, kept[:n_kept])
            k = n_kept
    return k


@compiled
def learn(
    arrays: MapArrays,
    numbers: tuple[int, int, int],
    graph: GraphArrays,
    recent: IntArray,
    scan: ScanArrays,
    decisions: tuple[IntArray, BoolArray, bool, IntArray],
    expected: tuple[Array, Array, int],
    settings: Settings,
) -> tuple[int, int, int]:
    """Update the map with the pairings of a scan, add new features, and record which features were seen together.

    The map and the graph must have room for as many more features as the scan has measurements.

    Arguments:
        arrays: arrays of the map.
        numbers: number of its features, number of its steps, next id.
        graph: neighbours and counts (≥ n, width) and degrees (≥ n,) of its covisibility, changed in place.
        recent: (≥ m,) receives the features that the scan has updated or started, and UNPAIRED.
        decisions: the map feature (m,) paired with each measurement; which measurements (m,) start a feature; whether
            the latter are decided already, otherwise measurements that are unpaired and compatible with no expected
            feature are entered there; and an array (m,) that receives the id of each measurement's feature, or NO_ID.
        expected: positions (≥ k, 2) and covariances (≥ k, 2, 2) of the k features expected, and k.

    Returns the outcome, a detail of it, and the number of features added. The details: DONE, the number of features
    that are due to be removed; NARROW, the width that the graph needs (nothing is changed); REFUSED, the answer of
    `update` (nothing is changed); SINGULAR or NOT_ADDED, the measurement from which no feature can be started.
    """
    (x, P, counted, _), (neighbours, counts, degrees), (n, step, next_id) = arrays, graph, numbers
    (points, covariances, _, _, _), (features, new, is_decided, ids) = scan, decisions
    (positions, spreads, k), (iterations, settled, invariant, gate, confirmations, before) = expected, settings
    m, added, s = len(features), 0, 0
    width = m  # the most neighbours that a feature may have once those of the scan are recorded as seen together
    for feature in features:
        if feature != UNPAIRED:
            width = max(width, degrees[feature] + m)
    if width > neighbours.shape[1]:
        return NARROW, width, 0
    # update
    refused = update(x, P, n, (points, covariances), features, (iterations, settled), invariant)
    if refused != ACCEPTED:
        return REFUSED, refused, 0
    ekf.record(arrays, step, scan, features)
    # add
    if not is_decided:
        singular = fit_nothing(points, covariances, features, (positions[:k], spreads[:k]), gate, new)
        if singular != UNPAIRED:
            return SINGULAR, singular, 0
    for i in range(m):
        feature = features[i]
        if new[i]:
            feature = n + added
            if not ekf.add(arrays, feature, step, next_id + added, scan, i):
                return NOT_ADDED, i, added
            degrees[feature] = 0
            added += 1
        ids[i] = NO_ID
        if feature != UNPAIRED:
            recent[s], ids[i] = feature, counted[ekf.IDS, feature]
            s += 1
    # maintain
    count_pairs(neighbours, counts, degrees, n + added, recent[:s])
    recent[s:] = UNPAIRED
    due = 0
    for j in range(n + added):
        due += counted[ekf.SEEN, j] < confirmations and counted[ekf.FIRST_SEEN, j] < before
    return DONE, due, added


@compiled
def forget(
    arrays: MapArrays,
    n: int,
    graph: GraphArrays,
    rule: tuple[int, int],
    became: IntArray,
    removed: IntArray,
) -> None:
    """Marginalise out of the map the features that were not confirmed in time, as counted by `learn`.

    `became` (n,) receives the new index of each feature, or UNPAIRED, and `removed` (r,) the ids of those removed.
    """
    counted, (neighbours, counts, degrees), (confirmations, before) = arrays[2], graph, rule
    kept, n_kept, n_removed = np.empty(n - len(removed), np.int64), 0, 0
    for j in range(n):
        if counted[ekf.SEEN, j] < confirmations and counted[ekf.FIRST_SEEN, j] < before:
            became[j], removed[n_removed] = UNPAIRED, counted[ekf.IDS, j]
            n_removed += 1
        else:
            became[j], kept[n_kept] = n_kept, j
            n_kept += 1
    ekf.keep(arrays, kept)
    keep_nodes(neighbours, counts, degrees, n, kept)


@compiled
def fit_nothing(
    points: Array, noise: Array, features: IntArray, expected: tuple[Array, Array], gate: float, new: BoolArray
) -> int:
    """Enter in `new` (m,) the unpaired measurements compatible with nothing; return one where S is singular, or −1."""
    unpaired, every_row = np.flatnonzero(features == UNPAIRED), np.empty(0, np.bool_)
    fault, candidates = gate_pairings(points, noise, expected[0], expected[1], unpaired, every_row, gate, 1)
    new[:] = False
    new[unpaired] = candidates.starts[1:] == candidates.starts[:-1]
    return fault[1]
