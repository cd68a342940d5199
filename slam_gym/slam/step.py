"""The compiled call of a step of SLAM that follows the associator's answer: update, add, maintain."""

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.compatibility import gate_pairings
from slam_gym.mapping import ekf
from slam_gym.mapping.covisibility import Counts, count_pairs, keep_nodes
from slam_gym.mapping.ekf import MapArrays
from slam_gym.mapping.update import update
from slam_gym.types import NO_ID, UNPAIRED, Array, BoolArray, IntArray, ScanArrays

Settings = tuple[int, float, bool, float, int, int]
"""Iterations; σ that settles them; right-invariant; χ² gate of a new feature; sightings that confirm; step before which
a feature must have been confirmed."""


@compiled
def learn(
    arrays: MapArrays,
    numbers: tuple[int, int, int],
    counts: Counts,
    scan: ScanArrays,
    decisions: tuple[IntArray, BoolArray, bool, IntArray],
    expected: tuple[Array, Array],
    absent: IntArray,
    settings: Settings,
) -> tuple[int, IntArray, IntArray]:
    """Update the map with the pairings of a scan, add new features, record which features were seen together, and
    marginalise out features that were not confirmed in time or do not exist.

    The map and the graph must have room for as many more features as the scan has measurements.

    Arguments:
        arrays: arrays of the map.
        numbers: number of its features, number of its steps, next id.
        counts: of its covisibility graph, changed in place.
        decisions: the map feature (m,) paired with each measurement; which measurements (m,) start a feature; whether
            the latter are decided already, otherwise measurements that are unpaired and compatible with no expected
            feature are entered there; and an array (m,) that receives the id of each measurement's feature, or NO_ID.
        expected: positions (k, 2) and covariances (k, 2, 2) of the features expected.
        absent: features (r,) that do not exist.

    Returns the number of features added, the ids (r,) of those removed, and the index that each feature then has, or
    UNPAIRED. Raises ValueError, with the map unchanged, as `fit_nothing`, `update` and `ekf.add`.
    """
    (x, P, counted, _), (n, step, next_id) = arrays, numbers
    (points, covariances, _, _, _), (features, new, is_decided, ids) = scan, decisions
    (iterations, settled, invariant, gate, confirmations, before), m, added = settings, len(features), 0
    if not is_decided:
        fit_nothing(points, covariances, features, expected, gate, new)
    for i in range(m):  # before anything is changed
        if new[i]:
            ekf.check_measurement(points, covariances, i)
    # update
    update(x, P, n, (points, covariances), features, (iterations, settled), invariant)
    ekf.record(arrays, step, scan, features)
    # add
    seen = features.copy()
    for i in range(m):
        if new[i]:
            seen[i] = n + added
            ekf.add(arrays, n + added, step, next_id + added, scan, i)
            added += 1
        ids[i] = NO_ID if seen[i] == UNPAIRED else counted[ekf.IDS, seen[i]]
    # maintain
    count_pairs(counts, seen)
    kept, became, left = np.empty(n + added, np.int64), np.full(n + added, UNPAIRED), 0
    exists = np.ones(n + added, np.bool_)
    exists[absent] = False
    for j in range(n + added):
        if exists[j] and (counted[ekf.SEEN, j] >= confirmations or counted[ekf.FIRST_SEEN, j] >= before):
            became[j], kept[left] = left, j
            left += 1
    removed = counted[ekf.IDS, : n + added][became == UNPAIRED]
    if len(removed) > 0:
        ekf.keep(arrays, kept[:left])
        keep_nodes(counts, n + added, kept[:left])
    return added, removed, became


@compiled
def fit_nothing(
    points: Array, noise: Array, features: IntArray, expected: tuple[Array, Array], gate: float, new: BoolArray
) -> None:
    """Enter in `new` (m,) the unpaired measurements compatible with nothing. Raises ValueError where S is singular."""
    unpaired, every_row = np.flatnonzero(features == UNPAIRED), np.empty(0, np.bool_)
    candidates = gate_pairings((points, noise), expected, unpaired, every_row, gate, 1)
    new[:] = False
    new[unpaired] = candidates.starts[1:] == candidates.starts[:-1]
