"""What the map expects of a scan, in one compiled call: the robot moves, and features come into reach."""

from __future__ import annotations

from slam_gym._compile import compiled
from slam_gym.mapping import ekf, measurement
from slam_gym.mapping.covisibility import mark_local
from slam_gym.mapping.ekf import MapArrays
from slam_gym.types import Array, BoolArray, IntArray


@compiled
def foresee(
    arrays: MapArrays,
    n: int,
    step: int,
    moves: bool,
    motion: Array,
    Q: Array,
    reach: float,
    second_order: bool,
    neighbours: IntArray,
    degrees: IntArray,
    recent: IntArray,
    out: tuple[IntArray, Array, BoolArray, Array, Array, Array],
) -> int:
    """`ekf.predict` where the robot `moves`, then the k features in reach with what is known of them; −1: refused.

    Arguments:
        arrays: of a map of n features, in which so many steps have ended.
        motion, Q: odometry (3,) and its covariance (3, 3).
        neighbours, degrees: of the covisibility graph; empty: all features are near.
        recent: (r,) features that recent scans paired, or UNPAIRED.
        out: rows of (4, n): features, kinds, ages, sightings; of (2, n): sizes, variances; near (n,), positions (n, 2),
            covariances (n, 2, 2) and those with the heading (n, 2). The first k of each are filled in.
    """
    x, at, P, counted, sized = arrays
    known, sizes, near, positions, covariances, across = out
    if moves and not ekf.predict(x, at, P, 3 + 2 * n, motion, Q):
        return -1
    features, kinds, ages, sightings = known[0], known[1], known[2], known[3]
    k = measurement.features_in_reach(x, at, P, n, reach, second_order, (features, positions, covariances, across))
    local = mark_local(neighbours, degrees, n, recent)
    for row in range(k):
        j = features[row]
        kinds[row], ages[row] = counted[ekf.KINDS, j], step - counted[ekf.FIRST_SEEN, j]
        sightings[row] = counted[ekf.SEEN, j]
        sizes[0, row], sizes[1, row] = sized[ekf.SIZES, j], sized[ekf.VARIANCES, j]
        near[row] = local[j]
    return k
