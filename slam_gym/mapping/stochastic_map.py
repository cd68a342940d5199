"""The stochastic map: robot pose and point features with one full covariance, kept by an EKF.

Everything lives in B, the base frame of the map. Features are addressed by index 0 … n−1, which shifts when features
are removed, and known by an id that is never given twice.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from slam_gym.geometry import wrap_angle
from slam_gym.mapping import ekf, measurement
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.ekf import MapArrays
from slam_gym.mapping.foresight import Room, foresee, room_for
from slam_gym.mapping.linear_algebra import aligned_zeros, is_covariance, padded, read_only
from slam_gym.mapping.update import ACCEPTED, NO_SUCH_FEATURE, update
from slam_gym.types import (
    Array,
    BoolArray,
    IntArray,
    Landmarks,
    Odometry,
    Prediction,
    Scan,
    View,
)

Error = Literal["ordinary", "right-invariant"]


@dataclass(frozen=True)
class MapSpec:
    """Settings of the estimator."""

    confidence: float = 0.99  # of the χ² gates in data association: every prediction carries it
    first_estimate_jacobians: bool = False  # evaluate Jacobians at first estimates (Huang et al. 2010)
    iterations: int | None = None  # of an update, at most: 1 linearises at the prior; None: 3, with first estimates 1
    settled: float = 0.1  # [σ of the state] a pass that would move it by less than that is spared
    error: Error | None = None  # that the filter is linear in (see `mapping.update`); None: right-invariant, with
    # first estimates ordinary
    second_order: bool = True  # predictions allow for what a poorly known heading bends (see `mapping.measurement`)
    confirmations: int = 2  # sightings that confirm a feature; until then it is provisional
    unconfirmed_age: int | None = 2  # [steps] a provisional feature is dropped when older; None: never

    def __post_init__(self) -> None:
        if not 0.0 < self.confidence < 1.0:
            raise ValueError(f"MapSpec.confidence: {self.confidence} is not between 0 and 1")
        if self.iterations is not None and self.iterations < 1:
            raise ValueError(f"MapSpec.iterations: {self.iterations} is less than 1")
        if not 0.0 <= self.settled < math.inf:
            raise ValueError(f"MapSpec.settled: {self.settled} is not finite or negative")
        if self.passes > 1 and self.first_estimate_jacobians:
            raise ValueError("MapSpec.iterations: with Jacobians at first estimates there is nothing to iterate")
        if self.error not in (None, "ordinary", "right-invariant"):
            raise ValueError(f"MapSpec.error: {self.error!r} is neither 'ordinary' nor 'right-invariant'")
        if self.error == "right-invariant" and self.first_estimate_jacobians:
            raise ValueError("MapSpec.error: Jacobians are taken at first estimates of an ordinary error only")
        if self.confirmations < 1:
            raise ValueError(f"MapSpec.confirmations: {self.confirmations} is less than 1")
        if self.unconfirmed_age is not None and self.unconfirmed_age < 0:
            raise ValueError(f"MapSpec.unconfirmed_age: {self.unconfirmed_age} is negative")

    @property
    def passes(self) -> int:
        """Iterations of an update, at most."""
        if self.iterations is not None:
            return self.iterations
        return 1 if self.first_estimate_jacobians else 3

    @property
    def right_invariant(self) -> bool:
        """The error is the right-invariant one."""
        return not self.first_estimate_jacobians if self.error is None else self.error == "right-invariant"


_NONE, _NOBODY = np.empty(0, np.int64), np.empty((0, 0), np.int64)
_LARGE = 512  # features
_STILL, _CERTAIN = np.zeros(3), np.zeros((3, 3))


class StochasticMap:
    """EKF-SLAM over point features. A SLAM step calls predict, prediction, update, add and end_of_step, in this order.

    Arguments:
        spec: settings.
        pose: (3,) [m, m, rad] of the robot at the start, in B; the origin by default.
        pose_covariance: (3, 3) of that pose; zero by default.
        capacity: features to make room for at first; grows as needed.

    Raises ValueError where an argument has the wrong shape, is not finite or is no covariance.
    """

    def __init__(
        self,
        spec: MapSpec | None = None,
        pose: ArrayLike | None = None,
        pose_covariance: ArrayLike | None = None,
        capacity: int = 64,
    ) -> None:
        start, covariance = _checked_pose(
            np.zeros(3) if pose is None else pose, np.zeros((3, 3)) if pose_covariance is None else pose_covariance
        )
        if capacity < 1:
            raise ValueError(f"capacity: {capacity} is less than 1")
        self.spec = spec or MapSpec()
        self._passes, self._invariant = self.spec.passes, self.spec.right_invariant
        self.n = 0  # features
        self.step = 0  # steps ended so far
        self._next_id = 0
        self._shown: tuple[Array, Array] | None = None  # read-only `_at` and `_P`, once they were asked for
        self._estimate = _Estimate()  # as it stands now: what is predicted from it notices when it no longer does
        side = padded(3 + 2 * capacity)
        self._x, self._P = np.zeros(side), aligned_zeros(side, side)  # of P, the upper triangle
        self._at = np.zeros(side) if self.spec.first_estimate_jacobians else self._x
        self._counted, self._sized = np.zeros((5, capacity), np.int64), np.zeros((2, capacity))
        self._x[:3] = self._at[:3] = start
        self._P[:3, :3] = covariance

    # what is estimated: fresh arrays, safe to keep and to change

    @property
    def pose(self) -> Array:
        """(3,) [m, m, rad] of the robot in B."""
        return self._x[:3].copy()

    @property
    def pose_covariance(self) -> Array:
        """(3, 3) [m², m·rad, rad²]."""
        return ekf.symmetric(self._P, 3)

    @property
    def positions(self) -> Array:
        """(n, 2) [m] of the features in B."""
        return self._x[3 : self._d].reshape(-1, 2).copy()

    @property
    def covariances(self) -> Array:
        """(n, 2, 2) [m²] marginal covariance of each feature in B."""
        return ekf.feature_covariances(self._P, self.n)

    @property
    def mean(self) -> Array:
        """(3 + 2n,) state: robot, then features."""
        return self._x[: self._d].copy()

    @property
    def covariance(self) -> Array:
        """(3 + 2n, 3 + 2n) of the state, symmetric to the last bit."""
        return ekf.symmetric(self._P, self._d)

    def covariance_of(self, features: IntArray) -> Array:
        """(2k, 2k) [m²] joint covariance of `features` (k,) in B, without that of the whole map.

        Raises ValueError where one does not exist.
        """
        return ekf.covariance_of(self._P, self._existing(features))

    def distances_between(self, first: IntArray, second: IntArray, gate: float) -> Array:
        """(a, b) D² of F_i − F_j for features i of `first` (a,) and j of `second` (b,); inf where it exceeds `gate`.

        Raises ValueError where a feature does not exist.
        """
        return ekf.distances_between(self._x, self._P, self._existing(first), self._existing(second), gate)

    @property
    def ids(self) -> IntArray:
        """(n,) id of each feature, never given twice."""
        return self._counted[ekf.IDS, : self.n].copy()

    @property
    def seen(self) -> IntArray:
        """(n,) number of steps in which each feature was measured, the first included."""
        return self._counted[ekf.SEEN, : self.n].copy()

    @property
    def first_seen(self) -> IntArray:
        """(n,) step in which each feature was added."""
        return self._counted[ekf.FIRST_SEEN, : self.n].copy()

    @property
    def last_seen(self) -> IntArray:
        """(n,) last step in which each feature was measured."""
        return self._counted[ekf.LAST_SEEN, : self.n].copy()

    @property
    def sizes(self) -> Array:
        """(n,) [m] intrinsic attribute, NaN where unknown."""
        return self._sized[ekf.SIZES, : self.n].copy()

    @property
    def size_variances(self) -> Array:
        """(n,) [m²], NaN where unknown."""
        return self._sized[ekf.VARIANCES, : self.n].copy()

    @property
    def kinds(self) -> IntArray:
        """(n,) class that the detector reported, UNKNOWN_KIND where it never did."""
        return self._counted[ekf.KINDS, : self.n].copy()

    @property
    def confirmed(self) -> Array:
        """(e, 2) [m] positions in B of the features that are not provisional."""
        return ekf.confirmed(self._x, self._counted[ekf.SEEN], self.n, self.spec.confirmations)

    @property
    def provisional(self) -> BoolArray:
        """(n,) seen in fewer steps than confirm a feature: by default, in one only."""
        return np.less(self._counted[ekf.SEEN, : self.n], self.spec.confirmations)

    def established(self, features: IntArray) -> BoolArray:
        """(k,) which of `features` (k,) are not provisional."""
        often: BoolArray = self._counted[ekf.SEEN][features] >= self.spec.confirmations
        return often

    # the filter

    def predict(self, odometry: Odometry) -> None:
        """x_R ← x_R ⊕ u and its covariance. Raises ValueError where the odometry is not finite or has no covariance."""
        self._estimate_changes()
        if not ekf.predict(self._x, self._at, self._P, self._d, odometry.motion, odometry.covariance):
            raise ValueError(f"odometry: not finite, or its covariance is none: {odometry}")

    def prediction(
        self,
        reach: float,
        graph: CovisibilityGraph | None = None,
        recent: IntArray = _NONE,
        view_from: Callable[[Array], View] | None = None,
        odometry: Odometry | None = None,
    ) -> Prediction:
        """Features within `reach` [m] + 3σ of the robot, as it would measure them; valid until the map next changes.

        Localities are those of `graph`; without it, all features are local to all. `recent` (r,) are the features that
        recent scans paired, or UNPAIRED: near are these and what is local to them. `view_from`
        tells what the sensor would have in view from a pose (3,) in B. With `odometry`, the robot first moves as
        `predict` has it; raises as that does.
        """
        motion, Q = (_STILL, _CERTAIN) if odometry is None else (odometry.motion, odometry.covariance)
        if odometry is not None:
            self._estimate_changes()
        n, neighbours, degrees, room = self.n, _NOBODY, _NONE, room_for(self.n)
        if graph is not None:
            neighbours, _, degrees = graph.arrays
        k = foresee(
            self.arrays, n, self.step, odometry is not None, motion, Q, float(reach), self.spec.second_order,
            neighbours, degrees, recent, room,
        )  # fmt: skip
        if k < 0:
            raise ValueError(f"odometry: not finite, or its covariance is none: {odometry}")
        return self.foreseen(room, k, self._P.item(2, 2), graph, None if view_from is None else view_from(self.pose))

    def foreseen(
        self,
        room: Room,
        k: int,
        heading_variance: float,
        graph: CovisibilityGraph | None,
        view: View | None,
        stands: bool = True,
    ) -> Prediction:
        """The prediction of the k features that `foresee` has entered in `room`; where it no longer `stands`, since the
        map has changed by now, nothing is looked up there any more."""
        known, sized, near, positions, covariances, across = room
        features, sightings = known[0, :k], known[3, :k]
        return Prediction(
            features,
            positions[:k],
            covariances[:k],
            sized[ekf.SIZES, :k],
            sized[ekf.VARIANCES, :k],
            known[1, :k],
            known[2, :k],
            near[:k],
            heading_variance,
            across[:k],
            self.spec.confidence,
            self._joint_covariance(features) if stands else _out_of_date,
            None if graph is None else graph.among_rows(features),
            view,
            sightings=sightings,
            provisional=np.less(sightings, self.spec.confirmations),
        )

    def landmarks(self) -> Landmarks:
        """The features with their full covariance, (2n, 2n), for searches without a prior on the pose. A copy."""
        landmarks = Landmarks.from_points(self.positions, covariance=self.covariance[3:, 3:])
        return replace(landmarks, sizes=self.sizes, size_variances=self.size_variances, kinds=self.kinds)

    def place(self, pose: ArrayLike, covariance: ArrayLike) -> None:
        """Put the robot at `pose` (3,) with `covariance` (3, 3), independent of the features: all it knew is forgotten.

        For relocation: place with a covariance that says nothing, then `update` with the pairings that were found.
        Raises ValueError, the map unchanged, where the pose is not finite or the covariance is none.
        """
        at, P = _checked_pose(pose, covariance)
        self._estimate_changes()
        self._x[:3] = self._at[:3] = at
        self._P[:3, : self._d] = 0.0
        self._P[:3, :3] = P

    def update(self, scan: Scan, features: IntArray) -> None:
        """Joint EKF update with every pairing (i, features[i]); features (m,) are map indices, or UNPAIRED.

        Raises ValueError, the map unchanged, where a feature does not exist or a paired measurement is not finite or
        has no covariance.
        """
        features = np.ascontiguousarray(features, dtype=np.int64)
        if len(features) != len(scan):
            raise ValueError(f"features: {len(features)} decisions for {len(scan)} measurements")
        self._estimate_changes()
        measured, passes = (scan.points, scan.covariances), (self._passes, self.spec.settled)
        refused = update(self._x, self._at, self._P, self.n, measured, features, passes, self._invariant)
        if refused != ACCEPTED:
            raise self.refusal(scan, features, refused)
        ekf.record(features, self.step, (scan.sizes, scan.size_variances, scan.kinds), self._counted, self._sized)

    def refusal(self, scan: Scan, features: IntArray, refused: int) -> ValueError:
        """Why an update with these pairings was `refused` (see `mapping.update`)."""
        if refused == NO_SUCH_FEATURE:
            return ValueError(f"features: {features.tolist()} for a map of {self.n} features")
        if refused == len(scan):
            return ValueError("the innovation covariance is singular to working precision")
        return bad_measurement(scan, refused)

    def add(self, scan: Scan, measurements: IntArray) -> IntArray:
        """Start a feature from each of `measurements` (a,) of the scan; returns their indices (a,) in the map.

        Raises ValueError at the first measurement that is not finite or has no covariance; those before it are added.
        """
        first = self.n
        for i in measurements:
            self.make_room(1)
            if not ekf.add(self._x, self._at, self._P, self._d, scan.points[i], scan.covariances[i]):
                raise bad_measurement(scan, i)
            known = float(scan.sizes[i]), float(scan.size_variances[i]), int(scan.kinds[i])
            ekf.begin(self._counted, self._sized, self.n, self.step, self._next_id, *known)
            self._next_id += 1
            self._estimate_changes()
            self.n += 1
        return np.arange(first, self.n)

    def remove(self, features: IntArray) -> IntArray:
        """Marginalise `features` (r,) out of the map; returns the old indices (n',) of those that stay, ascending.

        Raises ValueError where one does not exist.
        """
        features = np.asarray(features, dtype=np.int64)
        if np.any((features < 0) | (features >= self.n)):
            raise ValueError(f"features: {features.tolist()} to remove from a map of {self.n} features")
        staying = np.ones(self.n, dtype=bool)
        staying[features] = False
        kept = np.flatnonzero(staying)
        ekf.keep(self._x, self._at, self._P, kept)
        for columns in (self._counted, self._sized):
            columns[:, : len(kept)] = columns[:, kept]
        self.n = len(kept)
        self._estimate_changes()
        return kept

    def unconfirmed(self) -> IntArray:
        """Indices of the features that maintenance drops: provisional, first seen over `unconfirmed_age` steps ago."""
        age = self.spec.unconfirmed_age
        if age is None:
            return np.empty(0, dtype=np.int64)
        return ekf.stale(self._counted, self.n, self.spec.confirmations, self.step - age)

    def end_of_step(self) -> None:
        """Advance the step number."""
        self.step += 1

    def __len__(self) -> int:
        return self.n

    def __repr__(self) -> str:
        x, y, heading = self._x[:3]
        return f"StochasticMap of {self.n} features, robot at ({x:.2f} m, {y:.2f} m, {np.degrees(heading):.1f}°)"

    def __getstate__(self) -> dict[str, object]:
        """A copy shows its own arrays, not copies of those that are shown."""
        return self.__dict__ | {"_shown": None}

    def copy(self) -> StochasticMap:
        """An independent copy."""
        return copy.deepcopy(self)

    def _joint_covariance(self, features: IntArray) -> _JointCovariance:
        if self._shown is None:
            self._shown = read_only(self._at), read_only(self._P)
        return _JointCovariance(*self._shown, features, self.spec.second_order, self._estimate)

    def _estimate_changes(self) -> None:
        """What was predicted from the estimate until now is out of date, and says so when it is asked."""
        self._estimate.stands = False
        self._estimate = _Estimate()

    def _existing(self, features: IntArray) -> IntArray:
        features = np.ascontiguousarray(features, dtype=np.int64)
        if np.any((features < 0) | (features >= self.n)):
            raise ValueError(f"features: {features.tolist()} do not all exist in a map of {self.n} features")
        return features

    @property
    def _d(self) -> int:
        return 3 + 2 * self.n

    def make_room(self, more: int) -> None:
        """Room for so many more features: twice as much, or a quarter more where memory counts."""
        capacity = self._counted.shape[1]
        while self.n + more > capacity:
            capacity = 2 * capacity if capacity < _LARGE else capacity + capacity // 4
        if capacity == self._counted.shape[1]:
            return
        d, side = self._d, padded(3 + 2 * capacity)
        x, at, P = np.zeros(side), np.zeros(side), aligned_zeros(side, side)
        x[:d], at[:d] = self._x[:d], self._at[:d]
        ekf.copy_upper(self._P, d, P)
        self._x, self._at, self._P, self._shown = x, at if self.spec.first_estimate_jacobians else x, P, None
        counted, sized = np.zeros((5, capacity), np.int64), np.zeros((2, capacity))
        counted[:, : self.n], sized[:, : self.n] = self._counted[:, : self.n], self._sized[:, : self.n]
        self._counted, self._sized = counted, sized

    @property
    def arrays(self) -> MapArrays:
        """What compiled functions work on: no copies, so whoever writes to them says so with `learned`."""
        return self._x, self._at, self._P, self._counted, self._sized

    @property
    def next_id(self) -> int:
        """Of the next feature; all ids given so far are smaller."""
        return self._next_id

    def moved(self) -> None:
        """Take over that a compiled step has moved the robot."""
        self._estimate_changes()

    def learned(self, created: int) -> None:
        """Take over what a compiled step has made of the arrays: so many features were added, or removed where < 0."""
        self._estimate_changes()
        self.n += created
        self._next_id += max(created, 0)


class _Estimate:
    """Whether an estimate still stands: shared by the map and whatever was predicted from it."""

    __slots__ = ("stands",)

    def __init__(self) -> None:
        self.stands = True


@dataclass(frozen=True, slots=True)
class _JointCovariance:
    """`Prediction.joint`: H P Hᵀ from read-only arrays of the map that predicted, as long as that has not changed."""

    at: Array  # (d,) state that Jacobians are evaluated at
    P: Array  # (d, d) upper triangle
    features: IntArray  # (k,) map index of each row
    second_order: bool
    estimate: _Estimate

    def __call__(self, rows: IntArray) -> Array:
        if not self.estimate.stands:
            return _out_of_date(rows)
        return measurement.joint_covariance(self.at, self.P, self.features[rows], self.second_order)


def _out_of_date(rows: IntArray) -> Array:
    """`Prediction.joint` of a map that has changed."""
    raise RuntimeError("the map has changed since this prediction was made")


def _checked_pose(pose: ArrayLike, covariance: ArrayLike) -> tuple[Array, Array]:
    """Fresh arrays (3,), its heading wrapped, and (3, 3)."""
    at, P = np.array(pose, dtype=np.float64), np.array(covariance, dtype=np.float64)
    if at.shape != (3,) or not np.all(np.isfinite(at)):
        raise ValueError(f"pose: expected 3 finite numbers, got {at.tolist()}")
    if P.shape != (3, 3) or not is_covariance(P):
        raise ValueError(f"pose_covariance: not a 3 x 3 covariance: {P.tolist()}")
    at[2] = wrap_angle(at[2])
    return at, P


def bad_measurement(scan: Scan, i: int) -> ValueError:
    """That measurement i can neither update nor start a feature."""
    return ValueError(
        f"scan: measurement {i} is not finite, or its covariance is none: "
        f"point {scan.points[i].tolist()}, covariance {scan.covariances[i].tolist()}"
    )
