"""The compiled call of a step of SLAM that follows the associator's answer: update, add, maintain."""

from __future__ import annotations

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.compatibility import gate_pairings
from slam_gym.mapping import ekf
from slam_gym.mapping.covisibility import count_pairs, keep_nodes
from slam_gym.mapping.ekf import MapArrays
from slam_gym.mapping.update import update
from slam_gym.types import NO_ID, UNPAIRED, Array, BoolArray, IntArray, ScanArrays

GraphArrays = tuple[IntArray, IntArray, IntArray]  # neighbours, counts, degrees
Settings = tuple[int, float, bool, float, int, int]
"""Iterations; σ that settles them; right-invariant; χ² gate of a new feature; sightings that confirm; step before which
a feature must have been confirmed."""


@compiled
def learn(
    arrays: MapArrays,
    numbers: tuple[int, int, int],
    graph: GraphArrays,
    recent: IntArray,
    scan: ScanArrays,
    decisions: tuple[IntArray, BoolArray, bool, IntArray],
    expected: tuple[Array, Array],
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
        expected: positions (k, 2) and covariances (k, 2, 2) of the features expected.

    Returns the number of features added, the number of those due to be removed, and 0; or, with nothing changed, zeros
    and the width that the graph needs. Raises ValueError, with the map unchanged, as `fit_nothing`, `update` and
    `ekf.add`.
    """
    (x, P, counted, _), (neighbours, counts, degrees), (n, step, next_id) = arrays, graph, numbers
    (points, covariances, _, _, _), (features, new, is_decided, ids) = scan, decisions
    (iterations, settled, invariant, gate, confirmations, before), m, added, s = settings, len(features), 0, 0
    width = m  # the most neighbours that a feature may have once those of the scan are recorded as seen together
    for feature in features:
        if feature != UNPAIRED:
            width = max(width, degrees[feature] + m)
    if width > neighbours.shape[1]:
        return 0, 0, width
    if not is_decided:
        fit_nothing(points, covariances, features, expected, gate, new)
    for i in range(m):  # before anything is changed
        if new[i]:
            ekf.check_measurement(points, covariances, i)
    # update
    update(x, P, n, (points, covariances), features, (iterations, settled), invariant)
    ekf.record(arrays, step, scan, features)
    # add
    for i in range(m):
        feature = features[i]
        if new[i]:
            feature = n + added
            ekf.add(arrays, feature, step, next_id + added, scan, i)
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
    return added, due, 0


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
) -> None:
    """Enter in `new` (m,) the unpaired measurements compatible with nothing. Raises ValueError where S is singular."""
    unpaired, every_row = np.flatnonzero(features == UNPAIRED), np.empty(0, np.bool_)
    candidates = gate_pairings((points, noise), expected, unpaired, every_row, gate, 1)
    new[:] = False
    new[unpaired] = candidates.starts[1:] == candidates.starts[:-1]
