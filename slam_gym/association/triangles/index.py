"""Relocation below linear: an index over the map from which seeds come by their binary relations.

`FeatureIndex` holds the triangles of near features by the lengths of their sides. Three measurements are looked up by
theirs; the triangles that agree imply poses, each of which is held against the whole scan. The work is n times a small
number (the chance that a triangle of the map looks like one of the scan), not the number of pairs of pairings.
"""

from __future__ import annotations

import math
import time

import numpy as np
from numpy.typing import ArrayLike

from slam_gym.association.compatibility import chi2_gate
from slam_gym.association.relocation.acceptance import min_pairings as least_by_rule
from slam_gym.association.relocation.acceptance import with_margin
from slam_gym.association.relocation.location import locate
from slam_gym.association.triangles.arguments import (
    attributes_of,
    check_features,
    effort_of,
    kinds_as_numbers,
    pose_of,
    search_gates,
)
from slam_gym.association.triangles.map import (
    chance_tubes,
    crowding,
    least_pairings,
    relative_covariances,
    usual_reach,
)
from slam_gym.association.triangles.pose import StoreArrays
from slam_gym.association.triangles.search import search
from slam_gym.association.triangles.store import (
    BUDGET,
    CODES,
    FEATURES,
    POWER,
    RADIUS,
    REACH,
    SIDE,
    SIZE,
    TABLE,
    WIDEST,
    enter_grid,
    enter_triangles,
    keep_triangles,
    largest_spread,
    move_pool,
    number_of_cells,
    paint_features,
    sigma_table,
)
from slam_gym.types import UNPAIRED, IntArray, Landmarks, Locality, Relocation, Scan
from slam_gym.validation import check_scan

_GONE = -1  # new number of a feature that is dropped
_EMPTY = -1  # head of a grid cell without features
_POSES, _POSES_EACH = 20_000, 3  # of the default node limit: in any map, and for each feature
_DECISIVE = 0.002  # probability of pairings by chance so small that no rival of the same number is looked for
_FLOOR = 1e-10  # [m²] added to every variance of a feature, so that maps without errors have gates too
_NO_LOCALITY = (np.empty(0, np.int64), np.empty(0, np.int64))


class FeatureIndex:
    """An index over the features of a map, for relocation.

    Arguments:
        landmarks: map to start with; None for an empty one.
        reach: [m] longest side of the triangles indexed. Scans are looked up by triples of measurements that are nearer
            to each other than this; for others all pairs of near features are gone through. Default: what gives each
            feature some 23 within reach, or 11 m for an empty map.
        noise: [m] standard deviation of a measured feature about its mapped place, roughly. It sets the resolution of
            the tables, and so the speed; results do not depend on it.
        triangles: most that are indexed per feature, on average; 16 bytes each, and room to grow.

    Raises ValueError where an argument is not positive and finite, and as `add` does.
    """

    def __init__(
        self,
        landmarks: Landmarks | None = None,
        *,
        reach: float | None = None,
        noise: float | None = None,
        triangles: float = 64.0,
    ) -> None:
        covariances = relative_covariances(landmarks) if landmarks is not None else np.empty((0, 2, 2))
        positions = landmarks.positions if landmarks is not None else np.empty((0, 2))
        self._fitted = len(positions) if reach is None else 0  # features that together keep to `triangles`
        if reach is None:
            reach = usual_reach(positions, triangles)
        if noise is None:
            widest = 0.5 * np.trace(covariances, axis1=1, axis2=2)
            noise = math.sqrt(2.0 * float(np.median(widest)) + 1e-6) if len(widest) else 0.07
        for name, value in (("reach", reach), ("noise", noise), ("triangles", triangles)):
            if not 0.0 < value < math.inf:
                raise ValueError(f"{name}: {value} is not positive and finite")
        noise = max(noise, reach / 400.0)
        quantum = max(5.0 * noise, reach / 32.0)
        self.n = 0  # features
        self._spread = 0.0  # [m²] sum of the traces of their covariances
        self._settings = np.zeros(TABLE + CODES)
        self._settings[: WIDEST + 1] = [reach / 3.0, reach, quantum, triangles, 3.6 * noise, 5.0 * noise, _FLOOR]
        self._settings[TABLE:] = sigma_table()
        self._cells = np.zeros((number_of_cells(reach, quantum), 4), np.int32)
        self._pool = np.empty((4096, 4), np.int32)
        self._progress = np.zeros(5, np.int64)  # as in `enter_triangles`
        self._positions, self._details = np.empty((0, 2)), np.empty((0, 6))
        self._starts, self._crowding_of = np.zeros(64), -1
        self._make_room(64)
        if landmarks is not None:
            self.add(positions, covariances, landmarks.sizes, landmarks.size_variances, landmarks.kinds)

    @property
    def reach(self) -> float:
        """[m] longest side of the triangles indexed."""
        return float(self._settings[REACH])

    @property
    def triangles(self) -> int:
        """Triangles indexed."""
        return int(self._progress[2])

    @property
    def truncated(self) -> int:
        """Features that crowd so much that only the nearest part of their triangles was indexed."""
        return int(self._progress[3])

    @property
    def nbytes(self) -> int:
        """Memory of all arrays [bytes]."""
        return sum(array.nbytes for array in self._store())

    def add(
        self,
        positions: ArrayLike,
        covariances: ArrayLike,
        sizes: ArrayLike | None = None,
        size_variances: ArrayLike | None = None,
        kinds: ArrayLike | None = None,
    ) -> IntArray:
        """Add features at `positions` (a, 2) [m]; returns their numbers (a,), which follow those there are.

        `covariances` (a, 2, 2) [m²] are those relative to the features around (`relative_covariances`): the marginals
        of a map without drift. Sizes (a,) [m], their variances [m²] and kinds are optional. Raises ValueError, the
        index unchanged, where a shape is wrong, a position not finite or a covariance none.
        """
        at = np.ascontiguousarray(positions, np.float64).reshape(-1, 2) if np.size(positions) else np.empty((0, 2))
        P = np.ascontiguousarray(covariances, np.float64)
        count, first = len(at), self.n
        check_features(at, P)
        self._make_room(first + count)
        self._positions[first : first + count] = at
        details = self._details[first : first + count]
        details[:, 0], details[:, 1], details[:, 2] = P[:, 0, 0] + _FLOOR, P[:, 0, 1], P[:, 1, 1] + _FLOOR
        details[:, 3] = math.nan if sizes is None else np.asarray(sizes)
        details[:, 4] = math.nan if size_variances is None else np.asarray(size_variances)
        details[:, 5] = kinds_as_numbers(kinds)
        self.n = first + count
        self._spread += float(details[:, 0].sum() + details[:, 2].sum())
        self._enter(first)
        return np.arange(first, self.n)

    def keep(self, kept: IntArray) -> None:
        """Drop all features but `kept` (k,), ascending, which are renumbered 0 … k − 1, as `StochasticMap.remove` does.

        Raises ValueError where one does not exist, or they are not ascending.
        """
        kept = np.asarray(kept, np.int64)
        if np.any(kept < 0) or np.any(kept >= self.n) or np.any(np.diff(kept) <= 0):
            raise ValueError(f"kept: not ascending numbers of {self.n} features")
        renumbered = np.full(self.n, _GONE)
        renumbered[kept] = np.arange(len(kept))
        self._progress[2] = keep_triangles(self._cells, self._pool, renumbered)
        for array in (self._positions, self._details):
            array[: len(kept)] = array[kept]
        self.n = self._progress[0] = len(kept)
        self._spread = float(self._details[: self.n, [0, 2]].sum())
        self._rebuild_tables(len(self._positions))

    def relocate(
        self,
        scan: Scan,
        landmarks: Landmarks | None = None,
        locality: Locality | None = None,
        *,
        confidence: float = 0.99,
        min_pairings: int | None = None,
        exhaustive: bool = False,
        node_limit: int | None = None,
    ) -> Relocation:
        """The pose that explains most measurements, if it explains enough and no other explains as many.

        With `landmarks`, rows as in this index, the answer is located in them with all their cross-covariances; with
        `locality`, the other features are local to the first one paired. `min_pairings` defaults to the rule
        (`usual_pairings`); one pairing less is reported as ambiguous, and what explains less than that is not looked
        for. The search ends once no pose is unseen that explains as many measurements as the best. Unless `exhaustive`,
        it also ends with one pairing more than needed, or with so many as chance brings once in 500 maps by the
        rule, and no other place found that looks alike: none that explains all but k/3 − 1 of the same k measurements.

        `node_limit` bounds the work, as so many poses verified: fits, and features gone through where the index does
        not reach, count as several. Default: 20 000 and 3 for each feature, some three times what it takes to refuse a
        scan of 20 measurements from elsewhere. Where it is met, `effort.limit_hit` says so, and the answer is what was
        found until then.

        Raises ValueError for a bad scan, a confidence outside (0, 1), fewer than 3 `min_pairings`, or landmarks or
        locality of another number of features.
        """
        start = time.perf_counter()
        check_scan(scan)
        decisive = len(scan) + 1
        if min_pairings is None:
            min_pairings = self.usual_pairings(scan, confidence)
            decisive = self.usual_pairings(scan, confidence, _DECISIVE)
        if min_pairings < 3:
            raise ValueError(f"min_pairings: {min_pairings}; two pairings fit everywhere, so at least 3")
        for name, other in (("landmarks", landmarks), ("locality", locality)):
            if other is not None and len(other) != self.n:
                raise ValueError(f"{name}: of {len(other)} features, the index of {self.n}")
        places = _NO_LOCALITY if locality is None else (locality.starts, locality.members)
        pairings, features, fits, squares, spent = search(
            (np.ascontiguousarray(scan.points), np.ascontiguousarray(scan.covariances), attributes_of(scan)),
            places,
            self._store(),
            search_gates(len(scan), confidence),
            min_pairings,
            len(scan) + 1 if exhaustive else min(decisive, min_pairings + 1),
            _POSES + _POSES_EACH * self.n if node_limit is None else node_limit,
        )
        best = int(np.argmin(squares)) if pairings else 0
        decisions = features[best] if pairings else np.full(len(scan), UNPAIRED)
        pose, covariance = pose_of(fits[best]) if pairings else (np.full(3, math.nan), np.full((3, 3), math.nan))
        distance = float(squares[best]) if pairings else 0.0
        if landmarks is not None and pairings:
            located = locate(scan, landmarks, decisions)
            pose, covariance, distance = located.pose, located.covariance, located.joint_distance
        ties = max(len(squares) - 1, 0)
        return Relocation(
            decisions,
            pose,
            covariance,
            distance,
            max(2 * pairings - 3, 0),
            min_pairings,
            bool(ties or 0 < pairings < min_pairings),
            ties,
            effort_of(spent, self.truncated > 0, time.perf_counter() - start),
        )

    def usual_pairings(self, scan: Scan, confidence: float = 0.99, probability: float = 0.02) -> int:
        """`min_pairings` of this map (see `acceptance`), its densities looked at anew whenever it has grown by a tenth.

        Sizes and kinds are not considered: with them, fewer pairings would do.
        """
        if not 0.9 * self.n <= self._crowding_of <= self.n:
            self._starts, self._crowding_of = crowding(self._positions[: self.n], 1.5 * self.reach), self.n
        variance = 0.5 * self._spread / max(self.n, 1)
        tubes = chance_tubes(len(scan), confidence)
        least = least_pairings(scan.points, scan.covariances, self._starts, tubes, variance, probability)
        return with_margin(least, len(scan))

    def _store(self) -> StoreArrays:
        return (
            self._positions, self._details, self._heads, self._following, self._cells, self._pool, self._bits,
            self._settings,
        )  # fmt: skip

    def _make_room(self, features: int) -> None:
        """Twice the room, and tables anew, until so many features fit."""
        capacity = len(self._positions)
        if features <= capacity:
            return
        room = max(64, features if capacity == 0 or features > 2 * capacity else 2 * capacity)
        for name in ("_positions", "_details"):
            array = getattr(self, name)
            larger = np.full((room, array.shape[1]), math.nan)
            larger[: self.n] = array[: self.n]
            setattr(self, name, larger)
        self._rebuild_tables(room)

    def _rebuild_tables(self, room: int) -> None:
        """Grid and bitmaps for so many features, with those there are."""
        power = max(math.ceil(0.5 * math.log2(room)), 3)
        self._heads = np.full((1 << power, 1 << power), _EMPTY, np.int32)
        self._following = np.empty(room, np.int32)
        self._bits = np.zeros(5 << (2 * power + 1), np.uint32)
        self._settings[POWER] = power + 4
        enter_grid(self._heads, self._following, self._settings[SIDE], self._positions, 0, self.n)
        self._settings[WIDEST] = _FLOOR
        self._paint(0)

    def _paint(self, first: int) -> None:
        size, radius, power = self._settings[SIZE], self._settings[RADIUS], int(self._settings[POWER])
        gate, behind = chi2_gate(2, 0.99), 1 << (2 * power - 5)
        for level, bits in enumerate((self._bits[:behind], self._bits[behind:])):
            scale = 1.0 + level
            paint_features(
                bits, power - level, scale * size, scale * radius, gate, self._positions, self._details, first, self.n
            )
        self._settings[WIDEST] = max(self._settings[WIDEST], largest_spread(self._details, first, self.n))

    def _enter(self, first: int) -> None:
        """Triangles, grid and bitmaps of the features from `first` on."""
        self._settings[FEATURES] = self.n
        self._paint(first)
        while True:
            enter_triangles(
                self._cells, self._pool, self._heads, self._following, self._positions, self._details, self._settings,
                self._progress, self.n, self._fitted,
            )  # fmt: skip
            if self._progress[0] == self.n:
                return
            ready, triangles = max(int(self._progress[0]), 1), int(self._progress[2])
            expected = 1.3 * triangles * self.n / ready if ready > 50 else 0.0  # of the features still to be entered
            most = min(8.0 * triangles, self._settings[BUDGET] * self.n)
            larger = np.empty((int(max(1.5 * triangles, min(expected, most))) + 4096, 4), np.int32)
            self._progress[4] = move_pool(self._cells, self._pool, larger)
            self._pool = larger


def indexed(
    scan: Scan,
    landmarks: Landmarks,
    locality: Locality | None = None,
    *,
    confidence: float = 0.99,
    min_pairings: int | None = None,
    node_limit: int | None = None,
) -> Relocation:
    """`FeatureIndex.relocate` in an index built for the occasion: for maps that are small, or looked up once."""
    index = FeatureIndex(landmarks)
    if min_pairings is None:
        min_pairings = least_by_rule(scan, landmarks, confidence=confidence)
    return index.relocate(
        scan, landmarks, locality, confidence=confidence, min_pairings=min_pairings, node_limit=node_limit
    )
