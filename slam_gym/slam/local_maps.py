"""SLAM as a sequence of statistically independent local maps: a new one after so many features or on demand.

Map i + 1 has its base where the robot stood at the end of map i, and starts with nothing known but that: no measurement
enters two maps, so their estimates are independent, and the last robot pose of map i, with its covariance and its
correlations, is all that links the two. The new map's first features are as certain as a scan is, what the robot does
not know of its base stays with the map before, and linearisation errors stay small. The maps are joined when the whole
is asked for (`mapping.map_joining`); features that two of them hold are found by JCBB under the prior of the join.

**Ids** run through all maps and are never given twice. When a map is closed its features leave, and its last `SlamStep`
says so in `removed`: `metrics.association.Identities` therefore judges every decision against the current local map, in
which a feature may rightly begin a second time. A joined map keeps the oldest id of each feature, so
`identities.source_of(joined.ids)` names the true feature behind each joined one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from slam_gym.association import resolve_associator
from slam_gym.association.compatibility import chi2_gate, joint_gates
from slam_gym.association.prediction import Associator, Prediction, SlamStep
from slam_gym.association.tracking.jcbb import branch_and_bound
from slam_gym.association.tree import Pairings
from slam_gym.geometry import compose
from slam_gym.mapping.locality import linked, same_local_map
from slam_gym.mapping.map_joining import equate, join
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.slam.places.verification import attributes_agree, difference_covariance
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import UNPAIRED, Array, Hypothesis, IntArray, Locality, Odometry, Scan
from slam_gym.validation import check_scan

Match = Callable[[StochasticMap, IntArray, IntArray], IntArray]
"""From a joined map, its older features (a,) and its newer ones (b,) to pairs (k, 2) that are the same."""

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
        self._match = match or jointly_compatible
        self._graphs = [self.slam.covisibility]  # of each local map
        self._first_ids = [0]  # id from which on each local map gives them
        self._joined = 1, self.slam.map  # closed maps joined so far, as one
        self._oldest: dict[int, int] = {}  # id → the older one that the last join made it the same as
        self._is_last_step = False  # of the current map, whether it is full or not
        self._is_closed = False  # the next step begins a new map

    @property
    def map(self) -> StochasticMap:
        """The current local map, in its own base."""
        return self.maps[-1]

    @property
    def bases(self) -> Array:
        """(k, 3) [m, m, rad] base of each map in the base of the first, by composing the last robot poses."""
        out = [np.zeros(3)]
        for closed in self.maps[:-1]:
            out.append(compose(out[-1], closed.pose))
        return np.array(out)

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

        Of each pair the older id is left. Joins of closed maps are kept, so that only the current one is matched again.
        """
        done, whole = self._joined
        for number in range(done, len(self.maps)):
            older = whole.n
            whole = join(whole, self.maps[number])
            pairs, ids = self._match(whole, np.arange(older), np.arange(older, whole.n)), whole.ids
            self._oldest = {i: j for i, j in self._oldest.items() if i < self._first_ids[number]}
            self._oldest.update(zip(ids[pairs[:, 1]].tolist(), ids[pairs[:, 0]].tolist()))
            whole = equate(whole, pairs)
            if number < len(self.maps) - 1:
                self._joined = number + 1, whole
        return whole.copy()

    def map_of(self, m: StochasticMap) -> IntArray:
        """(n,) number of the local map in which each feature of a joined map was first seen."""
        numbers: IntArray = np.searchsorted(self._first_ids, m.ids, side="right") - 1
        return numbers

    def locality(self, m: StochasticMap) -> Locality:
        """Features of a joined map that are of the same local map."""
        return same_local_map(self.map_of(m))

    def covisible(self, m: StochasticMap, hops: int = 1) -> Locality:
        """Features of the map that `joined` last returned that were seen together in any local map; see `covisible`.

        Raises ValueError where m holds other features than that map.
        """
        seen = [np.empty((0, 2), np.int64)]
        for local, graph in zip(self.maps, self._graphs):
            seen.append(local.ids[graph.edges().pairs].reshape(-1, 2))
        ids = np.array([self._oldest.get(i, i) for i in np.concatenate(seen).ravel().tolist()], np.int64).reshape(-1, 2)
        if not np.isin(ids, m.ids).all():
            raise ValueError("m: not the map that was joined last")
        rows = np.sort(np.searchsorted(m.ids, ids), axis=1)
        return linked(m.n, np.unique(rows[rows[:, 0] != rows[:, 1]], axis=0), hops)


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
