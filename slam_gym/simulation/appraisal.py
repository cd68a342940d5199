"""The estimate of an episode held against the truth, in one compiled call each for what a tick and a step ask."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from slam_gym._compile import compiled
from slam_gym.geometry import compose, relative, transform
from slam_gym.mapping import ekf
from slam_gym.mapping.ekf import MapArrays
from slam_gym.metrics.consistency import pose_nees
from slam_gym.metrics.map_quality import coverage, error_of
from slam_gym.metrics.point_assignment import PackedIndex
from slam_gym.types import Array, IntArray


@compiled
def appraise_pose(x: Array, P: Array, base: Array, true: Array, estimate: Array) -> tuple[float, float, float]:
    """NEES of the pose that a map with state x and covariance P has, and by how much [m], [rad] it is off.

    `base` (3,) is the frame B of the map in W, `true` (3,) the pose in W; `estimate` (3,) is told the pose in B.
    """
    for i in range(3):
        estimate[i] = x[i]
    nees = pose_nees(estimate, ekf.symmetric(P, 3), relative(base, true))
    error = relative(true, compose(base, estimate))
    return nees, math.hypot(error[0], error[1]), abs(error[2])


@compiled
def appraise_map(
    arrays: MapArrays,
    n: int,
    confirmations: int,
    base: Array,
    targets: PackedIndex,
    cells: NDArray[np.uint8],
    places: IntArray,
) -> tuple[float, float]:
    """Map error and coverage of a map of n features with its base in W, against true features in W.

    `places` (c,) are those of the reachable cells in the explored grid, as `cells_of` gives them.
    """
    landmarks = transform(base, ekf.confirmed(arrays[0], arrays[2][ekf.SEEN], n, confirmations))
    return error_of(landmarks, targets), coverage(cells, places)
