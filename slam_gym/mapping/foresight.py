"""What the map expects of a scan, in one compiled call: the robot moves, and features come into reach."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from slam_gym._compile import compiled
from slam_gym.mapping import ekf, measurement
from slam_gym.mapping.covisibility import CovisibilityGraph, mark_local
from slam_gym.mapping.ekf import MapArrays
from slam_gym.mapping.map_spec import MapSpec
from slam_gym.types import Array, BoolArray, Experience, IntArray, Prediction, View

Room = tuple[IntArray, Array, BoolArray, Array, Array, Array]
"""Rows of (4, n): features, kinds, ages, sightings; of (2, n): sizes, variances; near (n,), positions (n, 2),
covariances (n, 2, 2) and those with the heading (n, 2). The first k of each are filled in."""


def room_for(n: int) -> Room:
    """Room for what is known of n features."""
    return (
        np.empty((4, n), np.int64), np.empty((2, n)), np.empty(n, np.bool_), np.empty((n, 2)), np.empty((n, 2, 2)),
        np.empty((n, 2)),
    )  # fmt: skip


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
    out: Room,
) -> int:
    """`ekf.predict` where the robot `moves`, then the k features in reach with what is known of them; −1: refused.

    Arguments:
        arrays: of a map of n features, in which so many steps have ended.
        motion, Q: odometry (3,) and its covariance (3, 3).
        neighbours, degrees: of the covisibility graph; empty: all features are near.
        recent: (r,) features that recent scans paired, or UNPAIRED.
        out: is told the features.
    """
    x, P, counted, sized = arrays
    known, sizes, near, positions, covariances, across = out
    if moves and not ekf.predict(x, P, 3 + 2 * n, motion, Q):
        return -1
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
def keep_rows(out: Room, kept: IntArray) -> None:
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


def prediction_of(
    room: Room,
    k: int,
    heading_variance: float,
    spec: MapSpec,
    joint: Callable[[IntArray], Array],
    local: Callable[[IntArray], BoolArray] | None,
    view: View | None,
    experience: Experience | None,
) -> Prediction:
    """The prediction of the k features that `foresee` has entered in `room`, with what is looked up only when asked."""
    known, sized, near, positions, covariances, across = room
    return Prediction(
        features=known[0, :k],
        positions=positions[:k],
        covariances=covariances[:k],
        sizes=sized[ekf.SIZES, :k],
        size_variances=sized[ekf.VARIANCES, :k],
        kinds=known[1, :k],
        ages=known[2, :k],
        near=near[:k],
        heading_variance=heading_variance,
        heading_covariances=across[:k],
        confidence=spec.confidence,
        joint=joint,
        local=local,
        view=view,
        experience=experience,
        sightings=known[3, :k],
        provisional=np.less(known[3, :k], spec.confirmations),
    )


@dataclass(slots=True)
class Outlook:
    """What a compiled step has expected of its scan. The prediction is put together once somebody asks for it; the map
    has changed by then."""

    room: Room
    k: int  # features
    pose: Array  # (4,) that was predicted, and the variance of its heading
    spec: MapSpec
    graph: CovisibilityGraph | None  # None: all features are local to all
    view_from: Callable[[Array], View] | None
    experience: Experience | None = None
    _made: Prediction | None = None

    @property
    def positions(self) -> Array:
        """As `Prediction.positions`."""
        return self.room[3][: self.k]

    @property
    def covariances(self) -> Array:
        """As `Prediction.covariances`."""
        return self.room[4][: self.k]

    @property
    def sizes(self) -> Array:
        """As `Prediction.sizes`."""
        return self.room[1][ekf.SIZES, : self.k]

    @property
    def prediction(self) -> Prediction:
        """The same one whenever it is asked for."""
        if self._made is None:
            self._made = self.made_by(out_of_date)
        return self._made

    def made_by(self, joint: Callable[[IntArray], Array]) -> Prediction:
        """The prediction of these features that looks joint covariances up with `joint`."""
        local = None if self.graph is None else self.graph.among_rows(self.room[0][0, : self.k])
        view = None if self.view_from is None else self.view_from(self.pose[:3])
        return prediction_of(self.room, self.k, self.pose.item(3), self.spec, joint, local, view, self.experience)


class Estimate:
    """Whether an estimate still stands: shared by the map and whatever was predicted from it."""

    __slots__ = ("stands",)

    def __init__(self) -> None:
        self.stands = True


@dataclass(frozen=True, slots=True)
class JointCovariance:
    """`Prediction.joint`: H P Hᵀ from read-only arrays of the map that predicted, as long as that has not changed."""

    x: Array  # (d,) state
    P: Array  # (d, d) upper triangle
    features: IntArray  # (k,) map index of each row
    second_order: bool
    estimate: Estimate

    def __call__(self, rows: IntArray) -> Array:
        if not self.estimate.stands:
            return out_of_date(rows)
        return measurement.joint_covariance(self.x, self.P, self.features[rows], self.second_order)


def out_of_date(rows: IntArray) -> Array:
    """`Prediction.joint` of a map that has changed."""
    raise RuntimeError("the map has changed since this prediction was made")
