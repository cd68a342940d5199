"""SLAM as a sequence of statistically independent local maps: a new one after a number of features.

Map i + 1 has its base where the robot stood at the end of map i, and starts empty: no measurement enters two maps, so
their estimates are independent, and the last robot pose of map i, with its covariance and its correlations, is all that
links the two. The first features of the new map are as certain as the scan, the uncertainty of its base stays with the
map before, and linearisation errors stay small. The maps are joined only when the whole map is requested, all at once
by least squares (`mapping.map_joining.join_all`). The features that two maps share are found for one pair of maps at a
time, by JCBB in the join of these two alone, the most certain relation first. The relation of maps that are not
consecutive is composed of the most certain relations found so far (Bosse et al., "Atlas", IJRR 2004) and assumed to be
independent of their features: the correspondences are approximate, and the join that follows from them is exact.

**Ids** are unique over all maps and are never given twice. When a map is closed, the `removed` of its last `SlamStep`
lists all its features: `metrics.association.Identities` therefore judges every decision against the current local map,
in which a feature may rightly start a second time. A joined map keeps the oldest id of each feature, so
`identities.source_of(joined.ids)` names the true feature behind each feature of the joined map.
"""

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
from slam_gym.mapping.map_joining import equate, join, join_all, joined_estimate, joined_map
from slam_gym.mapping.smoothing import Smoothed, dead_reckoning
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.slam.places.verification import attributes_agree, difference_covariance
from slam_gym.slam.slam import STILL, Slam, SlamSpec
from slam_gym.types import UNPAIRED, Array, Hypothesis, IntArray, Locality, Odometry, Scan
from slam_gym.validation import check_inputs, check_scan, indices

Match = Callable[[StochasticMap, IntArray, IntArray], IntArray]
"""Finds features mapped twice: takes the join of two local maps, the rows of its older (a,) and newer features (b,),
and returns pairs (k, 2) of rows."""

_INDIVIDUAL = 0.9999  # confidence: one error moves all pairs, so that the joint gate is the one that discriminates
_NODE_LIMIT = 20_000  # nodes of the search; then the best pairs so far are returned


class LocalMapSlam:
    """A robot's local maps, and the step that updates the current one; with `predict`, `learn` and `step` as in `Slam`.

    Local maps are independent: in each, the associator begins without the experience of the others.

    Arguments:
        spec: as for `Slam`, within each local map.
        features_per_map: number of features at which a map is closed; None: never. It should be several times the
            features of a scan: with no more than those, every step begins a map.
        match: finds the features that two maps share, when the maps are joined; `jointly_compatible` by default.

    Raises ValueError for fewer than one feature per map.
    """

    def __init__(
        self, spec: SlamSpec | None = None, features_per_map: int | None = 30, match: Match | None = None
    ) -> None:
        if features_per_map is not None and features_per_map < 1:
            raise ValueError(f"features_per_map: {features_per_map} is less than 1")
        self.spec = spec or SlamSpec()
        self.features_per_map = features_per_map
        self.slam = Slam(self.spec)  # updates the current local map
        self.maps = [self.slam.map]  # each in its own base; the last is the current one
        self._graphs = [self.slam.covisibility]  # of each local map
        self._match = match or jointly_compatible
        self._correspondences = _Correspondences(self._match)  # of closed maps, updated on demand
        self._covisible_names: list[IntArray] = []  # (e, 2) of each map, as of the last join
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
        """(3,) [m, m, rad] pose of the robot in the base of the first map, before any join."""
        return compose(self.bases[-1], self.map.pose)

    def step(self, odometry: Odometry, scan: Scan, associator: str | Associator = "jcbb") -> SlamStep:
        """Move by `odometry`, then learn from `scan`, in the current local map or, if that is closed, in a new one.

        Arguments and errors are those of `Slam.step`.
        """
        associate = resolve_associator(associator)
        prediction = self.predict(odometry, scan)
        return self.learn(scan, prediction, associate(scan, prediction))

    def predict(self, odometry: Odometry, scan: Scan) -> Prediction:
        """As `Slam.predict`; begins a new local map if the current one is closed."""
        check_inputs(odometry, scan)
        if self._is_closed:
            check_scan(scan)
            self.map.predict(odometry)
            self.slam, self._is_closed, odometry = Slam(self.spec), False, STILL
            self.slam.map = self.map.successor()
            self.maps.append(self.slam.map)
            self._graphs.append(self.slam.covisibility)
        return self.slam.predict(odometry, scan)

    def learn(self, scan: Scan, prediction: Prediction, hypothesis: Hypothesis) -> SlamStep:
        """As `Slam.learn`; `removed` also lists the features of a local map that this step closes."""
        step = self.slam.learn(scan, prediction, hypothesis)
        self._is_closed = self.features_per_map is not None and self.map.n >= self.features_per_map
        return replace(step, removed=np.concatenate([step.removed, self.map.ids])) if self._is_closed else step

    def joined(self) -> StochasticMap:
        """Join all maps in the base of the first, and fuse features that are the same. The local maps do not change.

        Fused features keep the oldest of their ids. Matches of closed maps are stored, so that only the current map is
        matched again. The time for the full covariance grows with the cube of the number of features: see `smoothed`.
        """
        names = self._match_all()
        return joined_map(self.maps, names) if len(self.maps) > 1 else self.map.copy()

    def smoothed(self) -> Smoothed:
        """As `joined`, but covariances are computed only on request. The join takes seconds for thousands of features,
        besides the matching of any two maps that overlap.

        The poses are the bases of the maps, then the pose of the robot.
        """
        return join_all(self.maps, self._match_all())

    def _match_all(self) -> list[IntArray]:
        """The names (n_i,) of the features of each map. A name is the oldest id of all features that are the same."""
        known, self._correspondences = self._correspondences, _Correspondences(self._match)
        while len(known.names) < len(self.maps) - 1:
            known.add(self.maps)
        self._correspondences = known  # an interruption leaves none of them, rather than half of them
        with_current = copy.deepcopy(self._correspondences)
        with_current.add(self.maps)
        names = with_current.names
        self._covisible_names = [of[graph.edges().pairs].reshape(-1, 2) for of, graph in zip(names, self._graphs)]
        return names

    def map_of(self, m: StochasticMap | Smoothed) -> IntArray:
        """(n,) index of the local map in which each feature of a joined map was first seen."""
        numbers: IntArray = np.searchsorted([closed.next_id for closed in self.maps[:-1]], m.ids, side="right")
        return numbers

    def locality(self, m: StochasticMap | Smoothed) -> Locality:
        """The locality in which features of a joined map are local to each other if one local map holds them."""
        return same_local_map(self.map_of(m))

    def covisible(self, m: StochasticMap | Smoothed, hops: int = 1) -> Locality:
        """The locality of features that were seen together in any local map; see `mapping.locality.covisible`.

        `m` must be the map that was joined last. Raises ValueError where it holds other features.
        """
        ids = np.concatenate([np.empty((0, 2), np.int64), *self._covisible_names])
        if not np.isin(ids, m.ids).all():
            raise ValueError("m: not the map that was joined last")
        rows = np.sort(np.searchsorted(m.ids, ids), axis=1)
        return linked(len(m.ids), np.unique(rows[rows[:, 0] != rows[:, 1]], axis=0), hops)


_Relation = tuple[Array, Array]
"""Pose (3,) of a local map in the base of another, and its covariance (3, 3)."""


class _Correspondences:
    """Which features of the local maps are the same, and the relative poses of the maps, extended map by map."""

    def __init__(self, match: Match) -> None:
        self.names: list[IntArray] = []  # (n_i,) of each map: the oldest id of all features that are the same
        self._match = match
        self._rows: dict[int, dict[int, int]] = {}  # name → map → row of the feature with that name
        self._relations: list[dict[int, _Relation]] = []  # of each map: other map → its relation, in the base of this

    def add(self, maps: Sequence[StochasticMap]) -> None:
        """Match the next map with the earlier maps that it may overlap, the most certain relation first."""
        b = len(self.names)
        ids, self._extent = maps[b].ids, float(np.hypot(*maps[b].positions.T).max(initial=1.0))
        self.names.append(ids)
        self._rows |= {name: {b: row} for row, name in enumerate(ids.tolist())}
        self._relations.append({b: (np.zeros(3), np.zeros((3, 3)))})
        if b:
            self._relate(b - 1, b, (maps[b - 1].pose, maps[b - 1].pose_covariance))
        remaining = set(range(b))
        while remaining:
            a = min(remaining, key=lambda other: self._variance(self._relations[other][b][1]))
            remaining.remove(a)
            if (found := self._compared(maps, a, b)) is not None:
                self._relate(a, b, found)

    def _variance(self, P: Array) -> float:
        """[m²] position variance, under base covariance P (3, 3), of the farthest feature of the newest map."""
        return float(P[0, 0] + P[1, 1] + P[2, 2] * self._extent**2)

    def _relate(self, a: int, b: int, relation: _Relation) -> None:
        """Store the relation of map b, the newest, to map a, and to the maps for which the path over a is surer."""
        for other, known in enumerate(self._relations[:b]):
            candidate = joined_estimate(*known[a], *relation)  # of independent relations
            if b not in known or self._variance(candidate[1]) < self._variance(known[b][1]):
                known[b], self._relations[b][other] = candidate, _inverted(candidate)

    def _compared(self, maps: Sequence[StochasticMap], a: int, b: int) -> _Relation | None:
        """Match map a with newer map b. Returns the relation of b to a that follows, or None if they share nothing."""
        older, newer, (pose, P) = maps[a], maps[b], self._relations[a][b]
        variances = [m.covariances[:, [0, 1], [0, 1]].sum(axis=1).max(initial=0.0) for m in (older, newer)]
        margin = 4.0 * math.sqrt(self._variance(P) + sum(variances))
        positions, newer_positions = older.positions, transform(pose, newer.positions)
        rows_a, rows_b = _near(positions, newer_positions, margin), _near(newer_positions, positions, margin)
        if not len(rows_a) or not len(rows_b):
            return None
        older, newer = older.copy(), newer.copy()
        older.remove(np.setdiff1d(np.arange(older.n), rows_a))
        newer.remove(np.setdiff1d(np.arange(newer.n), rows_b))
        newer.place(np.zeros(3), np.zeros((3, 3)))  # the robot of the join is then at the base of the newer map
        if a != b - 1:
            older.place(pose, P)
        names_a, names_b = self.names[a][rows_a], self.names[b][rows_b]
        _, shared_a, shared_b = np.intersect1d(names_a, names_b, return_indices=True)
        joined = equate(join(older, newer), np.column_stack([shared_a, older.n + shared_b]))
        free_a = np.setdiff1d(np.arange(older.n), shared_a)
        free_b = np.setdiff1d(np.arange(newer.n), shared_b)
        rows = older.n + np.arange(len(free_b))
        pairs = indices("match", np.ravel(self._match(joined, free_a, rows)), joined.n).reshape(-1, 2)
        if not np.isin(pairs[:, 0], free_a).all() or not np.isin(pairs[:, 1], rows).all():
            raise ValueError("match: a pair is not of an older and of a newer row")
        if any(len(np.unique(side)) < len(side) for side in pairs.T):
            raise ValueError("match: a row is in two pairs")
        united = [self._unite(int(names_a[j]), int(names_b[free_b[i - older.n]])) for j, i in pairs.tolist()]
        if not any(united) and not len(shared_a):
            return None
        joined = equate(joined, pairs[np.array(united, np.bool_)])
        return joined.pose, joined.pose_covariance

    def _unite(self, name: int, other: int) -> bool:
        """Give all features of two names the older name; returns False if a map holds both, which then must differ."""
        name, other = min(name, other), max(name, other)
        if self._rows[name].keys() & self._rows[other].keys():
            return False
        for number, row in self._rows[other].items():
            self.names[number][row] = name
        self._rows[name] |= self._rows.pop(other)
        return True


def _inverted(relation: _Relation) -> _Relation:
    """The inverse relation, ⊖relation."""
    pose, P = relation
    back = inverse(pose)
    by_back, by_pose = compose_jacobians(back, pose)  # of ⊖x ⊕ x = 0
    J = np.linalg.solve(by_back, by_pose)
    return back, J @ P @ J.T


def _near(points: Array, others: Array, margin: float) -> IntArray:
    """Rows of the points (k, 2) that lie in the bounding box of `others` (l, 2), widened by a margin [m]."""
    low, high = others.min(axis=0, initial=np.inf) - margin, others.max(axis=0, initial=-np.inf) + margin
    return np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))


def jointly_compatible(m: StochasticMap, older: IntArray, newer: IntArray) -> IntArray:
    """Find the largest set of pairs (k, 2) of an older (a,) and a newer feature (b,) that may be the same.

    Of sets of the same size, that of least D² is returned. The pairs are one to one, individually compatible, agree in
    size and kind, and are jointly compatible in every prefix at the confidence of the map. The hypothesis "newer
    feature i is older feature j" has the innovation ν_ij = F_i − F_j, and ν_ij and ν_kl have the covariance
    P_ik − P_il − P_jk + P_jl, which contains all correlations of the two maps. So this interpretation tree has a slot
    for each pairing, where that of a scan has one for each feature. The test is linear in the heading with which the
    newer map begins: from errors of about 0.1 rad on, right pairs fail it.
    """
    D = m.distances_between(newer, older, chi2_gate(2, _INDIVIDUAL))
    D[~attributes_agree(m, older, newer)] = np.inf
    rows, columns = np.nonzero(np.isfinite(D))
    rows, columns = np.array([rows, columns])[:, np.lexsort((D[rows, columns], rows))]
    pairs = np.column_stack([older[columns], newer[rows]])
    if not len(pairs):
        return pairs
    slots, (of_older, of_newer) = np.arange(len(pairs)), m.positions[pairs.T]
    numbers, level = np.unique(pairs[:, 1], return_inverse=True)
    noise, all_local = np.zeros((len(numbers), 2, 2)), np.empty((0, 0), np.bool_)
    pairings = Pairings(slots, level, of_newer - of_older, noise, difference_covariance(m, pairs), all_local, 0)
    found, gates = np.full(len(numbers), UNPAIRED), joint_gates(len(numbers), m.spec.confidence)
    branch_and_bound(pairings, pairs[:, 0].copy(), gates, _NODE_LIMIT, found)
    common: IntArray = np.column_stack([found, numbers])[found != UNPAIRED]
    return common
