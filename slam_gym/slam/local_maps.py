"""SLAM as a sequence of statistically independent local maps: a new one after so many features or on demand.

Each local map is a `Slam` of its own. The step after the last of a map moves that map's robot by the odometry; there
the new map has its base, in which the scan of that step is the first to be entered. The new map's first features are
thus as certain as a scan is, what the robot does not know of its base stays with the map before, and linearisation
errors stay small. The maps are joined when the whole is asked for (`mapping.map_joining`), with duplicates found by
JCBB under the prior of the join.

**Ids** run through all maps and are never given twice. When a map is closed its features leave, and its last `SlamStep`
says so in `removed`: `metrics.association.Identities` therefore judges every decision against the current
local map, in which a feature may rightly begin anew. It remembers the sources of what left, and a joined map keeps the
oldest id of each feature, so `identities.source_of(joined.ids)` names the true feature behind each joined one.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from slam_gym.association import resolve_associator
from slam_gym.association.prediction import Associator, Prediction, SlamStep
from slam_gym.mapping.local_maps import LocalMaps
from slam_gym.mapping.locality import linked, same_local_map
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.slam.duplicates import Duplicates, find_duplicates
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import Array, Hypothesis, IntArray, Locality, Odometry, Scan
from slam_gym.validation import check_scan

_STILL = Odometry(np.zeros(3), np.zeros((3, 3)))

Find = Callable[[StochasticMap, IntArray, IntArray], Duplicates]
"""From a joined map, its older and its newer features to the pairs that are the same."""


class LocalMapSlam:
    """A robot's local maps, and the step that updates the current one: the interface of `Slam`.

    Arguments:
        spec: as for `Slam`, within each local map.
        features_per_map: with so many features a map is closed; None: only on demand. It should be several times what
            a scan holds: with no more than that, every step begins a map.
        find: what finds duplicates when maps are joined; by default JCBB at the confidence of `spec.map`.

    Raises ValueError for fewer than one feature per map.
    """

    def __init__(
        self, spec: SlamSpec | None = None, features_per_map: int | None = 30, find: Find | None = None
    ) -> None:
        if features_per_map is not None and features_per_map < 1:
            raise ValueError(f"features_per_map: {features_per_map} is less than 1")
        self.spec = spec or SlamSpec()
        self.features_per_map = features_per_map
        self.slam = Slam(self.spec)  # of the current local map
        self.maps = LocalMaps(self.slam.map)
        self._graphs = [self.slam.covisibility]  # of each local map
        self.duplicates: list[Duplicates] = []  # found when the k-th closed map was joined with those before
        self._find = find or functools.partial(find_duplicates, confidence=self.spec.map.confidence)
        self._asked = False  # for a new map
        self._closed = False  # the next step begins a new map

    @property
    def map(self) -> StochasticMap:
        """The current local map, in its own base."""
        return self.maps.current

    @property
    def pose(self) -> Array:
        """(3,) [m, m, rad] of the robot in the base of the first map, before any join."""
        return self.maps.pose

    def step(self, odometry: Odometry, scan: Scan, associator: str | Associator = "jcbb") -> SlamStep:
        """Move by `odometry`, then learn from `scan`: in the current local map, or in a new one if that is closed.

        Arguments and errors are those of `Slam.step`.
        """
        associate = resolve_associator(associator)
        prediction = self.predict(odometry, scan)
        return self.learn(scan, prediction, associate(scan, prediction))

    def predict(self, odometry: Odometry, scan: Scan) -> Prediction:
        """As `Slam.predict`."""
        if self._closed:
            check_scan(scan)
            self.map.predict(odometry)
            self._begin()
            odometry = _STILL
        return self.slam.predict(odometry, scan)

    def learn(self, scan: Scan, prediction: Prediction, hypothesis: Hypothesis) -> SlamStep:
        """As `Slam.learn`; tells as well what leaves with a local map that is full."""
        step = self.slam.learn(scan, prediction, hypothesis)
        full = self.features_per_map is not None and self.map.n >= self.features_per_map
        self._closed, self._asked = full or self._asked, False
        return replace(step, removed=np.concatenate([step.removed, self.map.ids])) if self._closed else step

    def new_map(self) -> None:
        """Let the next step be the last of the current local map; its SlamStep tells what leaves with the map."""
        self._asked = True

    def _begin(self) -> None:
        self.slam = Slam(self.spec)
        self.slam.map = self.maps.begin()
        self._graphs.append(self.slam.covisibility)

    def joined(self) -> StochasticMap:
        """All maps in the base of the first, duplicates matched and removed. The maps themselves stay as they are.

        What was found between closed maps is kept, so that only the current one is matched anew.
        """
        return self.maps.joined(self._match)

    def map_of(self, m: StochasticMap) -> IntArray:
        """(n,) number of the local map in which each feature of a joined map was first seen."""
        return self.maps.map_of(m.ids)

    def locality(self, m: StochasticMap) -> Locality:
        """Features of a joined map that are of the same local map."""
        return same_local_map(self.map_of(m))

    def covisible(self, m: StochasticMap, hops: int = 1) -> Locality:
        """Features of the map that `joined` last returned that were seen together in any local map; see `covisible`.

        Raises ValueError where m holds other features than that map.
        """
        seen = [np.empty((0, 2), np.int64)]
        for local, graph in zip(self.maps, self._graphs):
            seen.append(self.maps.oldest(local.ids)[graph.edges().pairs].reshape(-1, 2))
        ids = np.concatenate(seen)
        if not np.isin(ids, m.ids).all():
            raise ValueError("m: not the map that was joined last")
        rows = np.sort(np.searchsorted(m.ids, ids), axis=1)
        return linked(m.n, np.unique(rows[rows[:, 0] != rows[:, 1]], axis=0), hops)

    def _match(self, whole: StochasticMap, older: int) -> IntArray:
        found = self._find(whole, np.arange(older), np.arange(older, whole.n))
        self.duplicates.append(found)
        return found.pairs
