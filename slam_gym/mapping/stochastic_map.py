"""The stochastic map: robot pose and point features with one full covariance, kept by an EKF.

All quantities are in B, the base frame of the map. Features are addressed by index 0 … n−1, which shifts when features
are removed, and identified by an id that is never given twice.
"""

from __future__ import annotations

import copy
import importlib
import json
import operator
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from slam_gym._files import array_of, json_of, replacing, zip_members
from slam_gym.geometry import wrap_angle
from slam_gym.mapping import ekf
from slam_gym.mapping.ekf import MapArrays
from slam_gym.mapping.linear_algebra import aligned_zeros, is_covariance, padded
from slam_gym.mapping.update import update
from slam_gym.types import LARGEST, UNKNOWN_KIND, UNPAIRED, Array, BoolArray, IntArray, Landmarks, Odometry, Scan
from slam_gym.validation import Checked, indices

_LARGEST_FILE = 1 << 30  # [bytes] of a map
_ROUNDING = 1e-6  # of a correlation
_SLACK = 1e-9  # of eigenvalues below 0, relative to the trace
_VAGUEST = 1e6  # [m, rad] σ of a pose that is placed: an update of a vaguer one would lose its digits
_MOST = 1 << 53  # steps and ids
_LARGE = 512  # [features] capacity from which memory grows by a quarter instead of doubling


class Estimate:
    """A flag, shared by a map and the predictions made from it, that says whether the estimate is still current."""

    __slots__ = ("stands",)

    def __init__(self) -> None:
        self.stands = True


@dataclass(frozen=True)
class MapSpec(Checked):
    """Settings of the estimator."""

    confidence: float = 0.99  # of the χ² gates in data association
    iterations: int = 10  # most iterations of an update, which mostly takes one to three; 1: linearise at the prior
    right_invariant: bool = True  # use the right-invariant error (see `mapping.update`); False: the error of x itself
    second_order: bool = True  # predict to second order in the error of the heading (see `mapping.measurement`)
    confirmations: int = 2  # sightings that confirm a feature; until then it is provisional
    unconfirmed_age: int | None = 2  # [steps] age above which a provisional feature is removed; None: never
    settled: ClassVar[float] = 0.1  # [σ of the state] iterations end when the next would move the state by less


@dataclass(frozen=True, slots=True)
class MapState:
    """The complete contents of a `StochasticMap`, except for its settings."""

    mean: Array  # (3 + 2n,) robot [m, m, rad], features [m], in B
    covariance: Array  # (3 + 2n, 3 + 2n)
    counted: IntArray  # (6, n) rows IDS to DIRECTIONS, see `mapping.ekf`
    sized: Array  # (2, n) rows SIZES [m] and VARIANCES [m²], NaN where unknown
    step: int  # number of steps ended so far
    next_id: int  # id of the next feature


class StochasticMap:
    """EKF-SLAM over point features.

    A SLAM step moves the robot and predicts the scan (`association.prediction.predict`), then calls `update`, `add`,
    `remove` and `end_of_step`. `Slam` does the middle part in one compiled call, `slam.step.learn`.

    Arguments:
        spec: settings.
        pose: (3,) [m, m, rad] initial pose of the robot in B; the origin by default.
        pose_covariance: (3, 3) [m², m·rad, rad²] of that pose; zero by default.
        capacity: initial capacity [features], which grows as needed.

    Raises ValueError where an argument has the wrong shape, is not finite or is no covariance.
    """

    def __init__(
        self,
        spec: MapSpec | None = None,
        pose: ArrayLike | None = None,
        pose_covariance: ArrayLike | None = None,
        capacity: int = 64,
    ) -> None:
        start, covariance = checked_pose(
            np.zeros(3) if pose is None else pose, np.zeros((3, 3)) if pose_covariance is None else pose_covariance
        )
        if capacity < 1:
            raise ValueError(f"capacity: {capacity} is less than 1")
        self.spec = spec or MapSpec()
        self.n = 0  # number of features
        self.step = 0  # number of steps ended so far
        self.next_id = 0  # id of the next feature; all ids given so far are smaller
        self.estimate = Estimate()  # shared with predictions, which refuse to be used once it has changed
        side = padded(3 + 2 * capacity)
        self._x, self._P = np.zeros(side), aligned_zeros(side, side)  # only the upper triangle of P is used
        self._counted, self._sized = np.zeros((6, capacity), np.int64), np.zeros((2, capacity))
        self._x[:3] = start
        self._P[:3, :3] = covariance

    # the estimate, as copies

    @property
    def pose(self) -> Array:
        """(3,) [m, m, rad] pose of the robot in B."""
        return self._x[:3].copy()

    @property
    def pose_covariance(self) -> Array:
        """(3, 3) [m², m·rad, rad²] covariance of the pose."""
        return ekf.symmetric(self._P, 3)

    @property
    def positions(self) -> Array:
        """(n, 2) [m] positions of the features in B."""
        return self._x[3 : self._d].reshape(-1, 2).copy()

    @property
    def covariances(self) -> Array:
        """(n, 2, 2) [m²] marginal covariance of each feature in B."""
        x = np.arange(3, self._d, 2)
        P, y = self._P, x + 1
        return np.stack([P[x, x], P[x, y], P[x, y], P[y, y]], axis=1).reshape(-1, 2, 2)

    @property
    def heading_covariances(self) -> Array:
        """(n, 2) [m·rad] covariances of the robot's heading with the coordinates of each feature."""
        return self._P[2, 3 : self._d].reshape(-1, 2).copy()

    @property
    def mean(self) -> Array:
        """(3 + 2n,) state: robot, then features."""
        return self._x[: self._d].copy()

    @property
    def covariance(self) -> Array:
        """(3 + 2n, 3 + 2n) covariance of the state, symmetric to the last bit."""
        return ekf.symmetric(self._P, self._d)

    def covariance_of(self, features: IntArray) -> Array:
        """(2k, 2k) [m²] joint covariance of `features` (k,) in B, without copying that of the whole map.

        Raises ValueError where a feature does not exist.
        """
        entries = (3 + 2 * indices("features", features, self.n)[:, None] + np.arange(2)).ravel()
        of_both: Array = self._P[np.minimum.outer(entries, entries), np.maximum.outer(entries, entries)]
        return of_both

    def distances_between(self, first: IntArray, second: IntArray, gate: float) -> Array:
        """(a, b) D² of F_i − F_j for features i of `first` (a,) and j of `second` (b,); inf where it exceeds `gate`.

        Raises ValueError where a feature does not exist.
        """
        return ekf.distances_between(
            self._x, self._P, indices("features", first, self.n), indices("features", second, self.n), gate
        )

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
        return self._x[3 : self._d].reshape(-1, 2)[~self.provisional]

    @property
    def provisional(self) -> BoolArray:
        """(n,) whether each feature was seen in fewer than `confirmations` steps: by default, in one only."""
        return np.less(self._counted[ekf.SEEN, : self.n], self.spec.confirmations)

    # the filter

    def predict(self, odometry: Odometry) -> None:
        """x_R ← x_R ⊕ u, and its covariance. Raises ValueError where the odometry or its covariance is invalid."""
        ekf.predict(self._x, self._P, self._d, *odometry.arrays)
        self.moved()

    def landmarks(self, features: IntArray | None = None) -> Landmarks:
        """A copy of `features` (k,), by default of all, with full covariance (2k, 2k), for searches without a prior on
        the pose."""
        covariance = self.covariance[3:, 3:] if features is None else self.covariance_of(features)
        chosen = slice(None) if features is None else features
        landmarks = Landmarks.from_points(self.positions[chosen], covariance=covariance)
        attributes = {name: getattr(self, name)[chosen] for name in ("sizes", "size_variances", "kinds")}
        return replace(landmarks, **attributes)

    def place(self, pose: ArrayLike, covariance: ArrayLike) -> None:
        """Put the robot at `pose` (3,) with `covariance` (3, 3), without correlation with the features.

        For relocation: place the robot with an uninformative covariance, then `update` with the pairings found.
        Raises ValueError, before the map is changed, where the pose is not finite or beyond 1e9 m, or the covariance is
        invalid.
        """
        x, P = checked_pose(pose, covariance)
        self.moved()
        self._x[:3] = x
        self._P[:3, : self._d] = 0.0
        self._P[:3, :3] = P

    def update(self, scan: Scan, features: IntArray) -> None:
        """Joint EKF update with every pairing (i, features[i]); features (m,) are map indices, or UNPAIRED.

        Raises ValueError, before the map is changed, where a feature does not exist, where a paired measurement is not
        finite or has an invalid covariance, and where the covariance of the innovations is singular.
        """
        features = indices("features", features, self.n, UNPAIRED)
        if len(features) != len(scan):
            raise ValueError(f"features: {len(features)} decisions for {len(scan)} measurements")
        measured, passes = (scan.points, scan.covariances), (self.spec.iterations, self.spec.settled)
        update(self._x, self._P, self.n, measured, features, passes, self.spec.right_invariant)
        self.moved()
        ekf.record(self.arrays, self.step, scan.arrays, features)

    def add(self, scan: Scan, measurements: IntArray) -> IntArray:
        """Start a feature from each of `measurements` (a,) of the scan; returns their indices (a,) in the map.

        Raises ValueError, before anything is added, where a measurement does not exist; and at the first one that is
        not finite or has an invalid covariance: those before it have then been added.
        """
        first, measured = self.n, scan.arrays
        for i in indices("measurements", measurements, len(scan)):
            self.make_room(1)
            ekf.add(self.arrays, self.n, self.step, self.next_id, measured, int(i))
            self.learned(1)
        return np.arange(first, self.n)

    def remove(self, features: IntArray) -> IntArray:
        """Marginalise `features` (r,) out of the map; returns the old indices (n',) of the others, ascending.

        Raises ValueError where a feature does not exist.
        """
        staying = np.ones(self.n, dtype=bool)
        staying[indices("features", features, self.n)] = False
        kept = np.flatnonzero(staying)
        ekf.keep(self.arrays, kept)
        self.learned(0, self.n - len(kept))
        return kept

    def end_of_step(self) -> None:
        """Advance the step number."""
        self.step += 1

    def __len__(self) -> int:
        return self.n

    def __repr__(self) -> str:
        x, y, heading = self._x[:3]
        return f"StochasticMap of {self.n} features, robot at ({x:.2f} m, {y:.2f} m, {np.degrees(heading):.1f}°)"

    # the map as a whole

    @property
    def state(self) -> MapState:
        """The complete contents of the map, as copies."""
        counted, sized = self._counted[:, : self.n].copy(), self._sized[:, : self.n].copy()
        return MapState(self.mean, self.covariance, counted, sized, self.step, self.next_id)

    @classmethod
    def of_state(cls, spec: MapSpec, state: MapState) -> StochasticMap:
        """The map with the settings `spec` and the contents `state`.

        Raises ValueError where lengths do not agree, numbers are not finite, directions do not exist, or the robot's
        covariance is invalid.
        """
        n = state.counted.shape[1]
        d = 3 + 2 * n
        if state.counted.shape != (6, n) or state.counted.dtype.kind != "i" or state.sized.shape != (2, n):
            raise ValueError(
                f"counted, sized: {state.counted.dtype} of shape {state.counted.shape}, {state.sized.shape}"
            )
        if (state.counted[ekf.DIRECTIONS].astype(np.int64) >> ekf.SECTORS).any():
            raise ValueError("counted: directions that do not exist")
        if state.mean.shape != (d,) or state.covariance.shape != (d, d):
            raise ValueError(f"mean, covariance: shapes {state.mean.shape}, {state.covariance.shape} for {n} features")
        if not (np.isfinite(state.mean).all() and np.isfinite(state.covariance).all()):
            raise ValueError("mean, covariance: not finite")
        m = cls(spec, state.mean[:3], state.covariance[:3, :3], capacity=max(n, 1))
        m._x[3:d], m._P[:d, :d] = state.mean[3:], state.covariance
        m._counted[:, :n], m._sized[:, :n] = state.counted, state.sized
        m.n, m.step, m.next_id = n, state.step, state.next_id
        return m

    def reordered(self, order: IntArray) -> StochasticMap:
        """The map with its features in another `order` (n,)."""
        state, rows = self.state, np.concatenate([np.arange(3), (3 + 2 * order[:, None] + np.arange(2)).ravel()])
        mean, covariance = state.mean[rows], state.covariance[np.ix_(rows, rows)]
        counted, sized = state.counted[:, order], state.sized[:, order]
        return StochasticMap.of_state(self.spec, MapState(mean, covariance, counted, sized, state.step, state.next_id))

    def save(self, path: str | Path) -> None:
        """Write the contents of the map and its settings into an .npz file. Raises ValueError for a map of more than
        1 GB, some 5 800 features."""
        state = self.state
        parts = {field.name: getattr(state, field.name) for field in fields(MapState)}
        if state.covariance.nbytes > _LARGEST_FILE - (1 << 20):  # which leaves room for the rest
            raise ValueError(f"{path}: a map of {self.n} features is too large for a file")
        with replacing(Path(path)) as file:
            np.savez_compressed(file, spec=json.dumps(asdict(self.spec)), **parts)

    @classmethod
    def load(cls, path: str | Path) -> StochasticMap:
        """Read a map that `save` wrote.

        Raises OSError for a file that cannot be read, ValueError for one that is damaged or does not contain a map.
        """
        try:
            members = zip_members(Path(path), _LARGEST_FILE)
            names = [field.name for field in fields(MapState)]
            state: dict[str, Any] = {name: array_of(members[name], "fi", _LARGEST_FILE) for name in names}
            state |= {name: operator.index(state[name].item()) for name in ("step", "next_id")}
            spec = MapSpec(**json_of(str(array_of(members["spec"], "U"))))
            m = cls.of_state(spec, MapState(**state))
            check_contents(m, state["covariance"])
            return m
        except (ValueError, KeyError, TypeError, IndexError) as error:
            raise ValueError(f"{path}: no map that can be read ({error})") from error

    def plot(self, ax: Any = None) -> Any:
        """Draw the map into the matplotlib axes `ax`, as `slam_gym.rendering.plot.plot_map` does; returns the axes."""
        plot = importlib.import_module("slam_gym.rendering.plot")  # at run time: mapping does not depend on rendering
        return plot.plot_map(self, ax)

    def successor(self) -> StochasticMap:
        """An empty map whose base is the current pose of the robot; ids and steps continue those of this map."""
        fresh = StochasticMap(self.spec)
        fresh.step, fresh.next_id = self.step, self.next_id
        return fresh

    def copy(self) -> StochasticMap:
        """An independent copy."""
        return copy.deepcopy(self)

    # access for compiled steps

    def make_room(self, more: int) -> None:
        """Make room for `more` features: double the capacity, or add a quarter where the map is large."""
        capacity = self._counted.shape[1]
        while self.n + more > capacity:
            capacity = 2 * capacity if capacity < _LARGE else capacity + capacity // 4
        if capacity == self._counted.shape[1]:
            return
        d, side = self._d, padded(3 + 2 * capacity)
        x, P = np.zeros(side), aligned_zeros(side, side)
        x[:d] = self._x[:d]
        for row in range(d):  # memory below the diagonal is never touched, so the system never allocates it
            P[row, row:d] = self._P[row, row:d]
        self._x, self._P = x, P
        counted, sized = np.zeros((6, capacity), np.int64), np.zeros((2, capacity))
        counted[:, : self.n], sized[:, : self.n] = self._counted[:, : self.n], self._sized[:, : self.n]
        self._counted, self._sized = counted, sized

    @property
    def arrays(self) -> MapArrays:
        """The arrays that compiled functions work on, not copied: after writing to them, call `moved` or `learned`."""
        return self._x, self._P, self._counted, self._sized

    def moved(self) -> None:
        """Register that the estimate has changed: predictions made from it before are out of date."""
        self.estimate.stands = False
        self.estimate = Estimate()

    def learned(self, created: int, removed: int = 0) -> None:
        """Register that `created` features were added to the arrays, and then `removed` ones removed."""
        self.moved()
        self.n += created - removed
        self.next_id += created

    @property
    def _d(self) -> int:
        return 3 + 2 * self.n


# validation


def check_contents(m: StochasticMap, covariance: Array) -> None:
    """Raise ValueError where ids are not unique and below the next one, steps or sightings are impossible, a coordinate
    is too large, a size is infinite or its variance negative, or the covariance that was read is not symmetric, has
    |P_ij| > σ_i σ_j or is indefinite."""
    ids, variances, diagonal, first, last = m.ids, m.size_variances, covariance.diagonal(), m.first_seen, m.last_seen
    counts = 0 <= m.step < _MOST and m.next_id < _MOST and len(np.unique(ids)) == m.n
    if not (counts and ((ids >= 0) & (ids < m.next_id)).all()):
        raise ValueError("counted, step, next_id: not those of a map")
    if not ((m.seen >= 1) & (first >= 0) & (first <= last) & (last <= m.step) & (m.kinds >= UNKNOWN_KIND)).all():
        raise ValueError("counted: not that of a map")
    if not (np.abs(m.mean) <= LARGEST).all() or np.isinf(m.sizes).any():
        raise ValueError("mean, sized: a coordinate is above 1e9 m, or a size is infinite")
    sigmas = np.sqrt(np.maximum(diagonal, 0.0))
    greatest = (1.0 + _ROUNDING) * np.outer(sigmas, sigmas) + _ROUNDING * diagonal.max()
    if (diagonal < 0.0).any() or not np.allclose(covariance, covariance.T) or (np.abs(covariance) > greatest).any():
        raise ValueError("covariance: is none")
    slack = _SLACK * diagonal.sum() + 1e-300  # of a robot that has not moved all is zero
    try:
        np.linalg.cholesky(covariance + slack * np.eye(len(covariance)))
    except np.linalg.LinAlgError:
        raise ValueError("covariance: is indefinite") from None
    if (variances < 0.0).any():
        raise ValueError("sized: a variance is negative")


def checked_pose(pose: ArrayLike, covariance: ArrayLike) -> tuple[Array, Array]:
    """Copies of the pose (3,), its heading wrapped, and the covariance (3, 3). Raises ValueError for invalid ones."""
    x, P = np.array(pose, dtype=np.float64), np.array(covariance, dtype=np.float64)
    if x.shape != (3,) or not (np.abs(x) <= LARGEST).all():
        raise ValueError(f"pose: expected 3 finite numbers up to {LARGEST:.0e}, got {x.tolist()}")
    if P.shape != (3, 3) or not is_covariance(P):
        raise ValueError(f"pose_covariance: not a 3 x 3 covariance: {P.tolist()}")
    if P.max() > _VAGUEST**2:
        raise ValueError(f"pose_covariance: a σ above {_VAGUEST:g}: {P.tolist()}")
    x[2] = wrap_angle(x[2])
    return x, P
