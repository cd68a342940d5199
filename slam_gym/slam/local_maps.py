"""SLAM as a sequence of statistically independent local maps: a new one after so many features or on demand.

Map i + 1 has its base where the robot stood at the end of map i, and starts with nothing known but that: no measurement
enters two maps, so their estimates are independent, and the last robot pose of map i, with its covariance and its
correlations, is all that links the two. The new map's first features are as certain as a scan is, what the robot does
not know of its base stays with the map before, and linearisation errors stay small. The maps are joined when the whole
is asked for, all at once by least squares (`mapping.map_joining.join_all`). Which features two of them hold is found
pair by pair, by JCBB in the join of the two alone, the surest relation first. The relation of maps that do not follow
each other is composed of the surest ones found so far (Bosse et al., "Atlas", IJRR 2004) and taken to be independent
of their features: which features are one is decided approximately, and what follows from it is exact.

**Ids** run through all maps and are never given twice. When a map is closed its features leave, and its last `SlamStep`
says so in `removed`: `metrics.association.Identities` therefore judges every decision against the current local map, in
which a feature may rightly begin a second time. A joined map keeps the oldest id of each feature, so
`identities.source_of(joined.ids)` names the true feature behind each joined one.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from slam_gym.association import resolve_associator
from slam_gym.association.compatibility import chi2_gate, joint_gates
from slam_gym.association.prediction import Associator, Prediction, SlamStep
from slam_gym.association.tracking.jcbb import branch_and_bound
from slam_gym.association.tree import Pairings
from slam_gym.geometry import compose, compose_jacobians, inverse, transform
from slam_gym.mapping.locality import linked, same_local_map
from slam_gym.mapping.map_joining import equate, join, join_all, joined_map
from slam_gym.mapping.smoothing import Smoothed, dead_reckoning
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.slam.places.verification import attributes_agree, difference_covariance
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import UNPAIRED, Array, Hypothesis, IntArray, Locality, Odometry, Scan
from slam_gym.validation import check_scan

Match = Callable[[StochasticMap, IntArray, IntArray], IntArray]
"""From the join of two local maps, older features (a,) and newer ones (b,) in it to pairs (k, 2) that are the same."""

_STILL = Odometry(np.zeros(3), np.zeros((3, 3)))
_INDIVIDUAL = 0.9999  # confidence: one draw moves all pairs, so that the joint gate is the one that discerns
_SEARCHES = 64  # of JCBB, after which the best pairs so far are taken
_NODE_LIMIT = 20_000  # of each


class LocalMapSlam:
    """A robot's local maps, and the step that updates the current one: the interface of `Slam`.

    Arguments:
        spec: as for `Slam`, within each local map.
        features_per_map: with so many features a map is closed; None: only on demand. It should be several times what
            a scan holds: with no more than that, every step begins a map.
        match: what finds the features that two maps hold, when they are joined.

    Raises ValueError for fewer than one feature per map.
    """

    def __init__(
        self, spec: SlamSpec | None = None, features_per_map: int | None = 30, match: Match | None = None
    ) -> None:
        if features_per_map is not None and features_per_map < 1:
            raise ValueError(f"features_per_map: {features_per_map} is less than 1")
        self.spec = spec or SlamSpec()
        self.features_per_map = features_per_map
        self.slam = Slam(self.spec)  # of the current local map
        self.maps = [self.slam.map]  # each in its own base; the last one is the current
        self._graphs = [self.slam.covisibility]  # of each local map
        self._first_ids = [0]  # id from which on each local map gives them
        self._correspondences = _Correspondences(
            match or jointly_compatible
        )  # of the closed maps, as far as anybody has asked
        self._names: list[IntArray] = []  # of the features of each map, when the whole was last asked for
        self._is_last_step = False  # of the current map, whether it is full or not
        self._is_closed = False  # the next step begins a new map

    @property
    def map(self) -> StochasticMap:
        """The current local map, in its own base."""
        return self.maps[-1]

    @property
    def bases(self) -> Array:
        """(k, 3) [m, m, rad] base of each map in the base of the first, by composing the last robot poses."""
        return dead_reckoning([closed.pose for closed in self.maps[:-1]])

    @property
    def pose(self) -> Array:
        """(3,) [m, m, rad] of the robot in the base of the first map, before any join."""
        return compose(self.bases[-1], self.map.pose)

    def step(self, odometry: Odometry, scan: Scan, associator: str | Associator = "jcbb") -> SlamStep:
        """Move by `odometry`, then learn from `scan`: in the current local map, or in a new one if that is closed.

        Arguments and errors are those of `Slam.step`.
        """
        associate = resolve_associator(associator)
        prediction = self.predict(odometry, scan)
        return self.learn(scan, prediction, associate(scan, prediction))

    def predict(self, odometry: Odometry, scan: Scan) -> Prediction:
        """As `Slam.predict`."""
        if self._is_closed:
            check_scan(scan)
            self.map.predict(odometry)
            self._begin_map()
            odometry = _STILL
        return self.slam.predict(odometry, scan)

    def learn(self, scan: Scan, prediction: Prediction, hypothesis: Hypothesis) -> SlamStep:
        """As `Slam.learn`; tells as well what leaves with a local map that is full."""
        step = self.slam.learn(scan, prediction, hypothesis)
        is_full = self.features_per_map is not None and self.map.n >= self.features_per_map
        self._is_closed, self._is_last_step = is_full or self._is_last_step, False
        return replace(step, removed=np.concatenate([step.removed, self.map.ids])) if self._is_closed else step

    def close_map(self) -> None:
        """Let the next step be the last of the current local map; its SlamStep tells what leaves with the map."""
        self._is_last_step = True

    def _begin_map(self) -> None:
        self.slam, self._is_closed = Slam(self.spec), False
        self.slam.map = self.map.successor()
        self.maps.append(self.slam.map)
        self._graphs.append(self.slam.covisibility)
        self._first_ids.append(self.map.next_id)

    def joined(self) -> StochasticMap:
        """All maps in the base of the first, features that are the same made one. The maps stay as they are.

        Of features that are the same the oldest id is left. Matches of closed maps are kept, so that only the current
        one is matched again. The full covariance takes time that grows with the cube of the features: see `smoothed`.
        """
        names = self._match_all()
        return joined_map(self.maps, names) if len(self.maps) > 1 else self.map.copy()

    def smoothed(self) -> Smoothed:
        """As `joined`, with the covariance of what is asked for only: seconds for thousands of features.

        The poses are the bases of the maps, then that of the robot.
        """
        return join_all(self.maps, self._match_all())

    def _match_all(self) -> list[IntArray]:
        """The names (n_i,) of the features of each map: the oldest id of all features that are the same."""
        while len(self._correspondences.names) < len(self.maps) - 1:
            self._correspondences.add(self.maps)
        everything = copy.deepcopy(self._correspondences)
        everything.add(self.maps)
        self._names = everything.names
        return self._names

    def map_of(self, m: StochasticMap | Smoothed) -> IntArray:
        """(n,) number of the local map in which each feature of a joined map was first seen."""
        numbers: IntArray = np.searchsorted(self._first_ids, m.ids, side="right") - 1
        return numbers

    def locality(self, m: StochasticMap | Smoothed) -> Locality:
        """Features of a joined map that are of the same local map."""
        return same_local_map(self.map_of(m))

    def covisible(self, m: StochasticMap | Smoothed, hops: int = 1) -> Locality:
        """Features of the map that was joined last that were seen together in any local map; see `covisible`.

        Raises ValueError where m holds other features than that map.
        """
        together = [names[graph.edges().pairs].reshape(-1, 2) for names, graph in zip(self._names, self._graphs)]
        ids = np.concatenate([np.empty((0, 2), np.int64), *together])
        if not np.isin(ids, m.ids).all():
            raise ValueError("m: not the map that was joined last")
        rows = np.sort(np.searchsorted(m.ids, ids), axis=1)
        return linked(len(m.ids), np.unique(rows[rows[:, 0] != rows[:, 1]], axis=0), hops)


_Relation = tuple[Array, Array]
"""Pose (3,) of a local map in the base of another, and its covariance (3, 3)."""


class _Correspondences:
    """Which features of local maps are the same, and where the maps stand to each other, map after map."""

    def __init__(self, match: Match) -> None:
        self.names: list[IntArray] = []  # (n_i,) of each map: the oldest id of all features that are the same
        self._match = match
        self._rows: dict[int, dict[int, int]] = {}  # name → by map, the row of its feature of that name
        self._relations: list[dict[int, _Relation]] = []  # of each map: where others stand in its base

    def add(self, maps: Sequence[StochasticMap]) -> None:
        """Match the next one of the maps with those before it that it may overlap, the surest relation first."""
        b = len(self.names)
        ids, self._extent = maps[b].ids, float(np.hypot(*maps[b].positions.T).max(initial=1.0))
        self.names.append(ids)
        self._rows |= {name: {b: row} for row, name in enumerate(ids.tolist())}
        self._relations.append({b: (np.zeros(3), np.zeros((3, 3)))})
        if b:
            self._relate(b - 1, b, (maps[b - 1].pose, maps[b - 1].pose_covariance))
        left = set(range(b))
        while left:
            a = min(left, key=lambda other: self._variance(self._relations[other][b][1]))
            left.remove(a)
            if (found := self._compared(maps, a, b)) is not None:
                self._relate(a, b, found)

    def _variance(self, P: Array) -> float:
        """[m²] of what is as far from a base of covariance (3, 3) as the features of the newest map are."""
        return float(P[0, 0] + P[1, 1] + P[2, 2] * self._extent**2)

    def _relate(self, a: int, b: int, relation: _Relation) -> None:
        """Note where map b, the newest, stands in the base of map a, and in others where that makes it surer."""
        for other, known in enumerate(self._relations[:b]):
            through = _composed(known[a], relation)
            if b not in known or self._variance(through[1]) < self._variance(known[b][1]):
                known[b], self._relations[b][other] = through, _inverted(through)

    def _compared(self, maps: Sequence[StochasticMap], a: int, b: int) -> _Relation | None:
        """Match map a and newer map b; where b stands in the base of a by that, or None where they share nothing."""
        older, newer, (pose, P) = maps[a], maps[b], self._relations[a][b]
        variances = [m.covariances[:, [0, 1], [0, 1]].sum(axis=1).max(initial=0.0) for m in (older, newer)]
        margin = 4.0 * math.sqrt(self._variance(P) + sum(variances))
        positions, others = older.positions, transform(pose, newer.positions)
        rows_a, rows_b = _near(positions, others, margin), _near(others, positions, margin)
        if not len(rows_a) or not len(rows_b):
            return None
        older, newer = older.copy(), newer.copy()
        older.remove(np.setdiff1d(np.arange(older.n), rows_a))
        newer.remove(np.setdiff1d(np.arange(newer.n), rows_b))
        newer.place(np.zeros(3), np.zeros((3, 3)))  # the robot of the join is then where the newer map has its base
        if a != b - 1:
            older.place(pose, P)
        names_a, names_b = self.names[a][rows_a], self.names[b][rows_b]
        _, one, other = np.intersect1d(names_a, names_b, return_indices=True)
        both = equate(join(older, newer), np.column_stack([one, older.n + other]))
        free_a = np.setdiff1d(np.arange(older.n), one)
        free_b = np.setdiff1d(np.arange(newer.n), other)
        pairs = self._match(both, free_a, older.n + np.arange(len(free_b)))
        kept = [self._unite(int(names_a[j]), int(names_b[free_b[i - older.n]])) for j, i in pairs.tolist()]
        if not any(kept) and not len(one):
            return None
        both = equate(both, pairs[np.array(kept, np.bool_)])
        return both.pose, both.pose_covariance

    def _unite(self, name: int, other: int) -> bool:
        """Give all features of two names the older one; False where a map has both, for they cannot be one then."""
        name, other = min(name, other), max(name, other)
        if self._rows[name].keys() & self._rows[other].keys():
            return False
        for number, row in self._rows[other].items():
            self.names[number][row] = name
        self._rows[name] |= self._rows.pop(other)
        return True


def _composed(first: _Relation, second: _Relation) -> _Relation:
    """The relation of independent ones in a row."""
    (a, P_a), (b, P_b) = first, second
    by_a, by_b = compose_jacobians(a, b)
    return compose(a, b), by_a @ P_a @ by_a.T + by_b @ P_b @ by_b.T


def _inverted(relation: _Relation) -> _Relation:
    """Where the other one stands in the base of this one."""
    pose, P = relation
    back = inverse(pose)
    by_back, by_pose = compose_jacobians(back, pose)  # of ⊖x ⊕ x = 0
    J = np.linalg.solve(by_back, by_pose)
    return back, J @ P @ J.T


def _near(points: Array, others: Array, margin: float) -> IntArray:
    """Rows of the points (k, 2) in the bounding box of others (l, 2), widened by a margin [m]."""
    low, high = others.min(axis=0, initial=np.inf) - margin, others.max(axis=0, initial=-np.inf) + margin
    return np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))


def jointly_compatible(m: StochasticMap, older: IntArray, newer: IntArray) -> IntArray:
    """The most pairs (k, 2) of an older (a,) and a newer feature (b,) that may be the same, then those of least D².

    Individually compatible, agreeing in size and kind, jointly compatible in every prefix at the confidence of the map,
    and one to one. The hypothesis "newer feature i is older feature j" has the innovation ν_ij = F_i − F_j, and two of
    them the covariance P_ik − P_il − P_jk + P_jl: everything that the two maps share is in it. So the interpretation
    tree has a slot for each pairing here, where a scan's has one for each feature. JCBB does not know over these slots
    that pairings are one to one: where it gives an older feature to two newer ones, the search is repeated without the
    one pairing and without the other, and the better is kept.
    """
    D = m.distances_between(newer, older, chi2_gate(2, _INDIVIDUAL))
    D[~attributes_agree(m, older, newer)] = np.inf
    rows, columns = np.nonzero(np.isfinite(D))
    rows, columns = np.array([rows, columns])[:, np.lexsort((D[rows, columns], rows))]
    pairs, distances = np.column_stack([older[columns], newer[rows]]), D[rows, columns]
    best, best_distance, searches, remaining = np.empty(0, np.int64), 0.0, 0, [np.arange(len(pairs))]
    while remaining and searches < _SEARCHES:
        allowed, searches = remaining.pop(), searches + 1
        chosen, distance = _jcbb(m, pairs[allowed])
        chosen = allowed[chosen]
        if (len(chosen), -distance) <= (len(best), -best_distance):
            continue
        rivals = _with_one_older_feature(pairs[chosen], distances[chosen])
        if not len(rivals):
            best, best_distance = chosen, distance
        remaining += [allowed[allowed != chosen[rival]] for rival in rivals]
    return pairs[best]


def _with_one_older_feature(pairs: IntArray, distances: Array) -> IntArray:
    """Two of the pairs (k, 2) with one older feature, that of less D² first; none where there are no such pairs."""
    features, times = np.unique(pairs[:, 0], return_counts=True)
    if not (times > 1).any():
        return np.empty(0, np.int64)
    rivals = np.flatnonzero(pairs[:, 0] == features[times.argmax()])[:2]
    return rivals[np.argsort(distances[rivals], kind="stable")]


def _jcbb(m: StochasticMap, pairs: IntArray) -> tuple[IntArray, float]:
    """Which of the pairs (c, 2), ordered by their newer features, JCBB takes, and D² of those together."""
    if not len(pairs):
        return np.empty(0, np.int64), 0.0
    slots, (older, newer) = np.arange(len(pairs)), m.positions[pairs.T]
    _, level = np.unique(pairs[:, 1], return_inverse=True)
    noise, all_local = np.zeros((level.max() + 1, 2, 2)), np.empty((0, 0), np.bool_)
    pairings = Pairings(slots, level, newer - older, noise, difference_covariance(m, pairs), all_local, 0)
    rows = np.full(len(noise), UNPAIRED)
    best = branch_and_bound(pairings, slots, joint_gates(len(rows), m.spec.confidence), _NODE_LIMIT, rows)
    return rows[rows != UNPAIRED], best.distance
