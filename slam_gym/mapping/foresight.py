"""What the map expects of a scan, in one compiled call: the robot moves, and features come into reach."""

from __future__ import annotations

import numpy as np

from slam_gym._jit import compiled
from slam_gym.mapping import ekf, measurement
from slam_gym.mapping.covisibility import mark_local
from slam_gym.mapping.ekf import MapArrays
from slam_gym.types import Array, BoolArray, IntArray

RowArrays = tuple[IntArray, Array, BoolArray, Array, Array, Array]
"""Rows of (4, n): features, kinds, ages, sightings; of (2, n): sizes, variances; near (n,), positions (n, 2),
covariances (n, 2, 2) and those with the heading (n, 2). The first k of each are filled in."""

Locality = tuple[IntArray, IntArray, IntArray]
"""Neighbours and degrees of the covisibility graph, empty where all features are near; (r,) features that recent scans
paired, or UNPAIRED."""


def rows_for(n: int) -> RowArrays:
    """Room for what is known of n features."""
    return (
        np.empty((4, n), np.int64), np.empty((2, n)), np.empty(n, np.bool_), np.empty((n, 2)), np.empty((n, 2, 2)),
        np.empty((n, 2)),
    )  # fmt: skip


@compiled
def foresee(
    arrays: MapArrays,
    counts: tuple[int, int],
    odometry: tuple[bool, Array, Array],
    reach: float,
    second_order: bool,
    locality: Locality,
    pose: Array,
    out: RowArrays,
) -> int:
    """`ekf.predict` where the robot moves, then the k features in reach with what is known of them; −1: refused.

    Arguments:
        arrays: of a map.
        counts: its features n, and the steps that have ended in it.
        odometry: whether the robot moves; by what (3,), and the covariance (3, 3) of that.
        pose: (4,) receives the predicted pose and the variance of its heading.
        out: receives the features.
    """
    (x, P, counted, sized), (n, step), (moves, motion, Q) = arrays, counts, odometry
    (known, sizes, near, positions, covariances, across), (neighbours, degrees, recent) = out, locality
    if moves and not ekf.predict(x, P, 3 + 2 * n, motion, Q):
        return -1
    pose[0], pose[1], pose[2], pose[3] = x[0], x[1], x[2], P[2, 2]
    features, kinds, ages, sightings = known[0], known[1], known[2], known[3]
    k = measurement.features_in_reach(x, P, n, reach, second_order, (features, positions, covariances, across))
    local = mark_local(neighbours, degrees, n, recent)
    for row in range(k):
        j = features[row]
        kinds[row], ages[row] = counted[ekf.KINDS, j], step - counted[ekf.FIRST_SEEN, j]
        sightings[row] = counted[ekf.SEEN, j]
        sizes[0, row], sizes[1, row] = sized[ekf.SIZES, j], sized[ekf.VARIANCES, j]
        near[row] = local[j]
    return k


@compiled
def keep_rows(out: RowArrays, kept: IntArray) -> None:
    """Move the rows `kept` (j,), ascending, to the front."""
    known, sizes, near, positions, covariances, across = out
    for row in range(len(kept)):
        was = kept[row]  # entry by entry: slices take two seconds to compile
        near[row] = near[was]
        for k in range(2):
            sizes[k, row], positions[row, k], across[row, k] = sizes[k, was], positions[was, k], across[was, k]
            covariances[row, k, 0], covariances[row, k, 1] = covariances[was, k, 0], covariances[was, k, 1]
        for k in range(4):
            known[k, row] = known[k, was]
