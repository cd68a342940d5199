"""SLAM as a sequence of statistically independent local maps.

Map i + 1 has its base where the robot stood at the end of map i, and starts with nothing known but that: no measurement
enters two maps, so their estimates are independent, and the last robot pose of map i, with its covariance and its
correlations, is all that links the two.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import ArrayLike

from slam_gym.geometry import compose
from slam_gym.mapping.map_joining import equate, join
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.types import Array, IntArray

Match = Callable[[StochasticMap, int], IntArray]
"""From a joined map and the number of features of its older part to pairs (k, 2) of an older and a newer feature that
are the same."""


class LocalMaps:
    """A sequence of local maps. Ids and steps run through all of them, so that an id tells the map it was given in."""

    def __init__(self, first: StochasticMap) -> None:
        self._maps = [first]
        self._first_ids = [0]
        self._joined: tuple[int, StochasticMap] | None = None  # maps joined so far, all of them closed
        self._became: dict[int, int] = {}  # id -> the older one that the last join made it the same as

    def __len__(self) -> int:
        return len(self._maps)

    def __getitem__(self, number: int) -> StochasticMap:
        return self._maps[number]

    def __iter__(self) -> Iterator[StochasticMap]:
        return iter(self._maps)

    @property
    def current(self) -> StochasticMap:
        """The last map, the only one that may still grow."""
        return self._maps[-1]

    def begin(self) -> StochasticMap:
        """Close the current map, not to be changed any more; returns a new one that has its base at the robot."""
        fresh = self.current.successor()
        self._maps.append(fresh)
        self._first_ids.append(fresh.next_id)
        return fresh

    @property
    def bases(self) -> Array:
        """(k, 3) [m, m, rad] base of each map in the base of the first, by composing the last robot poses."""
        out = [np.zeros(3)]
        for closed in self._maps[:-1]:
            out.append(compose(out[-1], closed.pose))
        return np.array(out)

    @property
    def pose(self) -> Array:
        """(3,) [m, m, rad] of the robot in the base of the first map, as the maps have it before they are joined."""
        return compose(self.bases[-1], self.current.pose)

    def map_of(self, ids: ArrayLike) -> IntArray:
        """Number (n,) of the map in which each id (n,) was given: what `same_local_map` asks for.

        Raises ValueError for an id that was not given yet.
        """
        asked = np.asarray(ids, dtype=np.int64)
        numbers = np.searchsorted(self._first_ids, asked, side="right") - 1
        if asked.size and (numbers.min() < 0 or asked.max() >= self.current.next_id):
            raise ValueError(f"ids: {asked.tolist()} were not all given")
        return np.asarray(numbers, dtype=np.int64)

    def joined(self, match: Match) -> StochasticMap:
        """All maps in the base of the first, joined in their order, with what `match` finds to be the same made one.

        Of each pair the older id is left. Joins of closed maps are kept: `match` is not asked about them again.
        """
        done, whole = self._joined or (1, self._maps[0])
        for number in range(done, len(self._maps)):
            count, older = whole.n, self._first_ids[number]
            whole = join(whole, self._maps[number])
            pairs, ids = match(whole, count), whole.ids
            self._became = {i: j for i, j in self._became.items() if i < older}
            self._became.update(zip(ids[pairs[:, 1]].tolist(), ids[pairs[:, 0]].tolist()))
            whole = equate(whole, pairs)
            if number < len(self._maps) - 1:
                self._joined = number + 1, whole
        return whole.copy()

    def oldest(self, ids: ArrayLike) -> IntArray:
        """The ids (k,) under which the features of these ids (k,) are in the map that `joined` last returned."""
        return np.array([self._became.get(i, i) for i in np.asarray(ids, dtype=np.int64).tolist()], dtype=np.int64)
