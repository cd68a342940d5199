"""What a step of SLAM does before association, in one compiled call: check, move, predict the features in reach."""

from __future__ import annotations

import math

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.acceptance import unambiguous_rows
from slam_gym.mapping.ekf import MapArrays
from slam_gym.mapping.measurement import Locality, RowArrays, foresee, keep_rows
from slam_gym.types import Array
from slam_gym.validation import first_bad_measurement

BAD_ODOMETRY, BAD_SCAN = -1, -2  # returned by `predict` in place of a number of rows

Rule = tuple[float, bool, float, float]
"""Reach [m]; whether predictions are to second order; χ² gate of a pairing; number of accidental matches expected in
the gate of an old feature above which it is not offered."""


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
