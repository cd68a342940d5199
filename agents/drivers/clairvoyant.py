"""The driver that knows the building: the upper reference among drivers, as `true_association` is among associators.

It is shown the plan, where it truly is, and which features its map holds. What it does not know is the noise to come.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from agents.drivers.base import LOOK_AROUND, GoalDriver, Info, Observation, legal_goals
from agents.drivers.baselines import InformationGain
from slam_gym._jit import compiled
from slam_gym.envs.observation import unsquash_goals
from slam_gym.geometry import compose, observe, transform
from slam_gym.simulation.episode import Episode, Site
from slam_gym.types import Array, BoolArray, IntArray
from slam_gym.world.ray_casting import pull_back

SPEED = 0.09  # [m/tick] along a path
OVERHEAD = 6.0  # [ticks] of a leg: to turn, to set off and to stop
LOOK = 32.0  # [ticks] to turn round once
TOURS = 32  # tried from each goal
NOISE = 0.4  # σ of the logarithm of a factor on what each viewpoint promises, drawn for each tour
EARLY = 0.2  # a feature that is mapped at once counts so much more than one at the end: plans may fail
ENOUGH = 0.5  # [features] a plan that promises less is none

_SURE = 0.95  # of the sensor's range, up to which a feature is seen often enough to be mapped
_SPACING = 1.2  # [m] between viewpoints
_VIEWPOINTS = (24, 160)  # at least and at most; larger buildings have fewer, farther apart,
_WORDS = 4_000_000  # so that what is seen on all ways takes no more of these if it can

Bits = NDArray[np.uint64]
"""(…, w) sets of features, one bit each, 64 to a word."""


class Clairvoyant(GoalDriver):
    """The goal from which the best tour over the true rooms, in the ticks that are left, maps most features.

    Where no goal leads to anything more, it drives as information gain does.
    """

    name = "clairvoyant"
    _episode: Episode | None = None

    def reset(self, seed: int) -> None:
        self._without_plan = InformationGain()

    def behold(self, episode: Episode) -> None:
        """Be shown the truth behind an episode that has just begun."""
        self._episode, rng = episode, np.random.default_rng(0)
        self._views = views = TrueViews(episode.site, episode.scenario.sensor.range)
        ticks = OVERHEAD + views.ways.lengths[:, views.viewpoints] / SPEED
        self._between = ticks, np.ascontiguousarray(views.ways.seen[:, views.viewpoints])
        self._chance = np.exp(NOISE * rng.standard_normal((TOURS, len(views.viewpoints))))

    def act(self, observation: Observation, info: Info) -> int:
        values, otherwise = self.values(observation, info), self._without_plan.act(observation, info)
        return int(np.argmax(values)) if values.max() > ENOUGH else otherwise

    def values(self, observation: Observation, info: Info) -> Array:
        """(SLOTS,) by how many features the map should be better in the end, by each goal; −inf where not legal.

        Raises RuntimeError before the truth was shown.
        """
        if self._episode is None:
            raise RuntimeError("the clairvoyant driver has not been shown an episode: call behold(episode)")
        episode, goals, legal = self._episode, unsquash_goals(observation["goals"]), legal_goals(info)
        here, left = episode.poses[-1], float(episode.scenario.budget - episode.ticks)
        places = transform(here, np.column_stack([goals["x"], goals["y"]]))
        there, ways = self._views.nearest(places), self._views.ways_from(self._views.nearest(here[None, :2]))
        ticks = OVERHEAD + np.maximum(ways.lengths[0, there], goals["path"]) / SPEED
        ticks[LOOK_AROUND] = LOOK
        known, worth = mapped_already(episode), worth_of(episode)
        values = np.full(len(legal), -np.inf)
        for k in np.flatnonzero(legal):
            seen, rest = ways.seen[0, there[k]], left - ticks[k]
            found = gained(known, seen, worth)
            if rest > 0.0:
                early = EARLY * rest / left
                values[k] = found * (1.0 + early) + self._best_tour(there[k], rest, known | seen, worth, early)
            else:
                values[k] = found * left / ticks[k]
        return values

    def _best_tour(self, cell: np.int64, left: float, known: Bits, worth: Array, early: float) -> float:
        """What the best tour from a cell brings, in the ticks that are left."""
        ways = self._views.ways
        start = OVERHEAD + ways.lengths[:, cell] / SPEED, np.ascontiguousarray(ways.seen[:, cell])
        return best_tour(start, self._between, left, known, worth, self._chance, early)


def mapped_already(episode: Episode) -> Bits:
    """The features that the map holds."""
    mapped = np.zeros(len(episode.site.plan.features), np.bool_)
    for part in episode.slam.maps:
        sources = episode.identities.source_of(part.ids[~part.provisional])
        mapped[sources[sources >= 0]] = True
    return bits_of(mapped)


def worth_of(episode: Episode) -> Array:
    """(n,) by how much each feature lowers N · E where it is mapped from a pose that is as wrong as now: 1 at best, −1
    where it ends up so far off that it is missing still, and false besides."""
    true = episode.site.plan.features.positions
    mapped = transform(compose(episode.base, episode.estimates[-1]), observe(episode.poses[-1], true))
    return 1.0 - np.minimum(np.hypot(*(mapped - true).T) / episode.scenario.prior_sigma, 2.0)


# -- tours: orienteering by many greedy tours that chance varies -------------------------------------------------------


@compiled
def gained(seen: Bits, more: Bits, worth: Array) -> float:
    """What the features of `more` (w,) that are not among those `seen` (w,) are `worth` (n,) together."""
    total, one = 0.0, np.uint64(1)
    for w in range(len(seen)):
        word = more[w] & ~seen[w]
        while word:
            lowest = word & (~word + one)
            total += worth[64 * w + math.frexp(float(lowest))[1] - 1]
            word ^= lowest
    return total


Legs = tuple[Array, Bits]
"""How long ways take [ticks], to viewpoints (…, v), and what is seen on them, (…, v, w)."""


@compiled
def best_tour(start: Legs, between: Legs, left: float, seen: Bits, worth: Array, chance: Array, early: float) -> float:
    """What the best of some tours through viewpoints brings: the `worth` (n,) of new features, each of which counts up
    to `early` more the earlier it is seen.

    Legs lead from the `start` to each viewpoint, and `between` any two of them; `left` [ticks] is what is left, `seen`
    (w,) what is known. There are as many tours as rows of `chance` (tours, v).
    """
    best = 0.0
    for tour in range(chance.shape[0]):
        power = 0.6 + 0.2 * (tour % 4)
        best = max(best, _tour(start, between, left, seen.copy(), worth, chance[tour], power, early))
    return best


@compiled
def _tour(
    start: Legs, between: Legs, left: float, seen: Bits, worth: Array, chance: Array, power: float, early: float
) -> float:
    """A tour that goes on with the leg of the most gain / ticks^`power`, times the `chance` (v,) of its end."""
    (costs, views), (ticks, legs), rest, total = start, between, left, 0.0
    while True:
        chosen, top, found = -1, 0.0, 0.0
        for v in range(len(chance)):
            if costs[v] > rest:
                continue
            gain = gained(seen, views[v], worth)
            if gain > 0.0 and gain / costs[v] ** power * chance[v] > top:
                chosen, top, found = v, gain / costs[v] ** power * chance[v], gain
        if chosen < 0:
            return total
        rest -= costs[chosen]
        for w in range(len(seen)):
            seen[w] |= views[chosen, w]
        total += found * (1.0 + early * rest / max(left, 1.0))
        costs, views = ticks[chosen], legs[chosen]


# -- what is seen from every place, and on every way between places ----------------------------------------------------


class Ways(NamedTuple):
    """The shortest ways from some cells to all cells, and what is seen on them: the same there and back."""

    lengths: Array  # (s, c) [m]; inf where none leads
    seen: Bits  # (s, c, w) from the cells of the way, both ends included


class TrueViews:
    """Views of one building: `cells` (c, 2) [m] in W, the `viewpoints` (v,) among them, and the `ways` from those."""

    def __init__(self, site: Site, sensor_range: float) -> None:
        self.cells = site.cells
        self.seen = _seen_from(site, _SURE * sensor_range)
        self._graph = _graph(self.cells)
        most = int(np.clip(_WORDS // self.seen.size, *_VIEWPOINTS))
        self.viewpoints = _spread(self.cells, most)
        self.ways = self.ways_from(self.viewpoints)

    def ways_from(self, sources: IntArray) -> Ways:
        """The ways from `sources` (s,), indices of cells."""
        lengths, before = dijkstra(self._graph, indices=sources, return_predecessors=True)
        return Ways(lengths, _along(np.argsort(lengths, axis=1), before, self.seen, lengths))

    def nearest(self, points: Array) -> IntArray:
        """(q,) indices of the cells nearest to `points` (q, 2) in W."""
        out: IntArray = ((self.cells[None] - points[:, None]) ** 2).sum(axis=2).argmin(axis=1)
        return out


def bits_of(chosen: BoolArray) -> Bits:
    """The sets (…, w) of the features that are `chosen` (…, n)."""
    words = np.zeros((*chosen.shape[:-1], 64 * max(1, -(-chosen.shape[-1] // 64))), np.bool_)
    words[..., : chosen.shape[-1]] = chosen
    return np.packbits(words, axis=-1, bitorder="little").view("<u8").astype(np.uint64)


def _spread(cells: Array, most: int) -> IntArray:
    """Cells far from each other, (v,): each next one is the farthest from all before."""
    chosen, gaps = [0], np.hypot(*(cells - cells[0]).T)
    while len(chosen) < most and gaps.max() > _SPACING:
        chosen.append(int(gaps.argmax()))
        gaps = np.minimum(gaps, np.hypot(*(cells - cells[chosen[-1]]).T))
    return np.array(chosen, np.int64)


def _graph(cells: Array) -> sparse.csr_matrix:
    """Neighbouring cells, eight around each, joined by their distance; across a corner only past two other cells."""
    across = np.diff(np.unique(cells[:, 0]))
    side = float(across.min()) if len(across) else 1.0
    columns, rows = np.rint((cells - cells.min(axis=0)) / side).astype(np.int64).T + 1
    index = np.full((rows.max() + 2, columns.max() + 2), -1)
    index[rows, columns] = np.arange(len(cells))
    starts, ends, lengths = [], [], []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        other = index[rows + down, columns + right]
        joined = (other >= 0) & (index[rows + down, columns] >= 0) & (index[rows, columns + right] >= 0)
        starts.append(np.flatnonzero(joined))
        ends.append(other[joined])
        lengths.append(np.full(int(joined.sum()), side * math.hypot(down, right)))
    one, two, length = (np.concatenate(parts) for parts in (starts, ends, lengths))
    half = sparse.csr_matrix((length, (one, two)), shape=(len(cells), len(cells)))
    return half + half.T


def _seen_from(site: Site, reach: float) -> Bits:
    """(c, w) the features that count, within `reach` [m] and that no wall hides, from each cell of the site."""
    features, short = site.plan.features.positions, pull_back(site.plan.features)
    seen = np.zeros((len(site.cells), len(features)), np.bool_)
    for cell, row in zip(site.cells, seen):
        near = np.flatnonzero(site.observable & (np.hypot(*(features - cell).T) <= reach))
        row[near] = site.index.visible(cell, features[near], short[near])
    return bits_of(seen)


@compiled
def _along(order: IntArray, before: NDArray[np.int32], seen: Bits, lengths: Array) -> Bits:
    """(s, c, w) what is seen on the ways, cell by cell from the nearest on."""
    out = np.zeros((order.shape[0], seen.shape[0], seen.shape[1]), np.uint64)
    for s in range(order.shape[0]):
        for i in range(order.shape[1]):
            c = order[s, i]
            if lengths[s, c] == math.inf:
                break
            for w in range(seen.shape[1]):
                out[s, c, w] = seen[c, w]
                if before[s, c] >= 0:
                    out[s, c, w] |= out[s, before[s, c], w]
    return out
