"""The driver that knows the building: the upper reference among drivers, as `true_association` is among associators.

It knows the plan, its true pose, and which features its map contains. It does not know the noise to come.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from agents.drivers.base import LOOK_AROUND, Agent, Info, Observation
from agents.drivers.baselines import InformationGain
from slam_gym._jit import compiled
from slam_gym.envs.observation import unsquash_goals
from slam_gym.geometry import compose, observe, transform
from slam_gym.simulation.episode import Episode, Site
from slam_gym.types import Array, BoolArray, IntArray
from slam_gym.world.reachability import observable

SPEED = 0.09  # [m/tick] along a path
OVERHEAD = 6.0  # [ticks] of a leg, to turn, to start and to stop
LOOK = 32.0  # [ticks] to turn round once
TOURS = 32  # tours that are tried from each goal
NOISE = 0.4  # σ of the logarithm of a random factor on the gain of each viewpoint, drawn for each tour
EARLY = 0.2  # a feature mapped at once counts by this fraction more than one at the end, since plans may fail
ENOUGH = 0.5  # [features] least expected gain of a plan

_SURE = 0.95  # of the sensor's range, up to which a feature is seen often enough to be mapped
_SPACING = 1.2  # [m] between viewpoints
_VIEWPOINTS = (24, 160)  # least and largest number; larger buildings have fewer, farther apart
_WORDS = 4_000_000  # limit on the memory for what is seen on all paths, which determines that number

Bits = NDArray[np.uint64]
"""(…, w) sets of features, one bit each, 64 to a word."""

Legs = tuple[Array, Bits]
"""Durations [ticks] or lengths [m] of paths (…, v), and the features seen on them, (…, v, w)."""


class Clairvoyant(Agent):
    """Chooses the goal from which the best tour over the true rooms maps most features in the remaining ticks.

    Where no goal leads to further features, it drives by information gain.
    """

    name = "clairvoyant"
    _episode: Episode | None = None

    def reset(self, seed: int) -> None:
        self._without_plan = InformationGain()

    def behold(self, episode: Episode) -> None:
        """Receive the truth behind an episode that has just begun."""
        self._episode, rng = episode, np.random.default_rng(0)
        self._views = views = TrueViews(episode.site, episode.scenario.sensor.range)
        self._between = views.legs_to(views.viewpoints)
        self._chance = np.exp(NOISE * rng.standard_normal((TOURS, len(views.viewpoints))))

    def act(self, observation: Observation, info: Info) -> int:
        values, otherwise = self.values(observation, info), self._without_plan.act(observation, info)
        return int(np.argmax(values)) if values.max() > ENOUGH else otherwise

    def values(self, observation: Observation, info: Info) -> Array:
        """(SLOTS,) [features] the expected gain of the final map by each goal; −inf where not legal.

        Raises RuntimeError before `behold`.
        """
        if self._episode is None:
            raise RuntimeError("the clairvoyant driver has not been shown an episode: call behold(episode)")
        episode, goals, legal = self._episode, unsquash_goals(observation["goals"]), info["action_mask"]
        here, left = episode.poses[-1], float(episode.scenario.budget - episode.ticks)
        places = transform(here, np.column_stack([goals["x"], goals["y"]]))
        there = self._views.nearest(places)
        lengths, on_way = self._views.ways_from(self._views.nearest(here[None, :2]))
        ticks = OVERHEAD + np.maximum(lengths[0, there], goals["path"]) / SPEED
        ticks[LOOK_AROUND] = LOOK
        known, worth = mapped_already(episode), worth_of(episode)
        values = np.full(len(legal), -np.inf)
        for k in np.flatnonzero(legal):
            seen, rest = on_way[0, there[k]], left - ticks[k]
            gain = gained(known, seen, worth)
            if rest > 0.0:
                early, start = EARLY * rest / left, self._views.legs_to(there[k])
                gain_after = best_tour(start, self._between, rest, known | seen, worth, self._chance, early)
                values[k] = gain * (1.0 + early) + gain_after
            else:
                values[k] = gain * left / ticks[k]
        return values


def mapped_already(episode: Episode) -> Bits:
    """The features that the map contains."""
    sources = episode.identities.source_of(np.concatenate([m.ids[~m.provisional] for m in episode.slam.maps]))
    return bits_of(np.isin(np.arange(len(episode.site.plan.features)), sources))


def worth_of(episode: Episode) -> Array:
    """(n,) by how much each feature lowers N · E if it is mapped with the present pose error: 1 at best, −1 where it is
    so far off that it counts as missed and as false."""
    true = episode.site.plan.features.positions
    mapped = transform(compose(episode.base, episode.estimates[-1]), observe(episode.poses[-1], true))
    return 1.0 - np.minimum(np.hypot(*(mapped - true).T) / episode.scenario.prior_sigma, 2.0)


# -- tours: orienteering by many randomised greedy tours ---------------------------------------------------------------


@compiled
def gained(seen: Bits, more: Bits, worth: Array) -> float:
    """The sum of `worth` (n,) over the features that are in `more` (w,) but not in `seen` (w,)."""
    total, one = 0.0, np.uint64(1)
    for w in range(len(seen)):
        word = more[w] & ~seen[w]
        while word:
            lowest = word & (~word + one)
            total += worth[64 * w + math.frexp(float(lowest))[1] - 1]
            word ^= lowest
    return total


@compiled
def best_tour(start: Legs, between: Legs, left: float, seen: Bits, worth: Array, chance: Array, early: float) -> float:
    """The gain of the best of several tours through viewpoints: the `worth` (n,) of new features, increased by a
    fraction of up to `early` the earlier they are seen.

    Legs lead from the `start` to each viewpoint, and `between` any two of them; `left` are the remaining ticks, `seen`
    (w,) the known features. There is a tour for each row of `chance` (tours, v).
    """
    most, (ticks, legs) = 0.0, between
    for tour in range(len(chance)):
        (costs, views), known, rest, total, power = start, seen.copy(), left, 0.0, 0.6 + 0.2 * (tour % 4)
        chosen = 0
        while chosen >= 0:  # the next leg maximises gain / ticks^power times the chance of its end
            chosen, best, chosen_gain = -1, 0.0, 0.0
            for v in range(chance.shape[1]):
                gain = gained(known, views[v], worth) if costs[v] <= rest else 0.0
                if gain > 0.0 and gain / costs[v] ** power * chance[tour, v] > best:
                    chosen, best, chosen_gain = v, gain / costs[v] ** power * chance[tour, v], gain
            if chosen >= 0:
                rest -= costs[chosen]
                known |= views[chosen]
                total += chosen_gain * (1.0 + early * rest / max(left, 1.0))
                costs, views = ticks[chosen], legs[chosen]
        most = max(most, total)
    return most


# -- features seen from every place, and on every path between places ------------------------------------------------


class TrueViews:
    """Views of one building: `cells` (c, 2) [m] in W, `viewpoints` (v,) among them, and the `ways` from those.

    From a cell, the observable features are `seen` (c, w) that are near and that no wall hides.
    """

    def __init__(self, site: Site, sensor_range: float) -> None:
        self.cells = site.cells
        seen = [observable(site.plan, site.index, cell[None], _SURE * sensor_range) for cell in site.cells]
        self.seen = bits_of(site.observable & np.array(seen))
        self._graph = _graph(self.cells)
        most = int(np.clip(_WORDS // self.seen.size, *_VIEWPOINTS))
        self.viewpoints = _spread(self.cells, most)
        self.ways = self.ways_from(self.viewpoints)

    def ways_from(self, sources: IntArray) -> Legs:
        """Lengths (s, c) [m] of the shortest paths from `sources` (s,), indices of cells, to all cells, inf where there
        is none; and the features (s, c, w) seen from the cells of a path, both ends included."""
        lengths, before = dijkstra(self._graph, indices=sources, return_predecessors=True)
        return lengths, _along(before, self.seen, np.isfinite(lengths))

    def legs_to(self, cells: Any) -> Legs:
        """Durations [ticks] of the paths from all viewpoints to `cells`, and the features seen on them."""
        lengths, seen = self.ways
        return OVERHEAD + lengths[:, cells] / SPEED, np.ascontiguousarray(seen[:, cells])

    def nearest(self, points: Array) -> IntArray:
        """(q,) indices of the cells nearest to `points` (q, 2) in W."""
        return ((self.cells[None] - points[:, None]) ** 2).sum(axis=2).argmin(axis=1)


def bits_of(chosen: BoolArray) -> Bits:
    """The features that are `chosen` (…, n), as sets (…, w)."""
    words = np.zeros((*chosen.shape[:-1], 64 * max(1, -(-chosen.shape[-1] // 64))), np.bool_)
    words[..., : chosen.shape[-1]] = chosen
    return np.packbits(words, axis=-1, bitorder="little").view("<u8").astype(np.uint64)


def _spread(cells: Array, most: int) -> IntArray:
    """(v,) cells far from each other: each is the farthest from all before."""
    chosen, gaps = [0], np.hypot(*(cells - cells[0]).T)
    while len(chosen) < most and gaps.max() > _SPACING:
        chosen.append(int(gaps.argmax()))
        gaps = np.minimum(gaps, np.hypot(*(cells - cells[chosen[-1]]).T))
    return np.array(chosen, np.int64)


def _graph(cells: Array) -> sparse.csr_matrix:
    """Distances between neighbouring cells, eight around each; diagonals only where both cells beside them exist."""
    across, tree = np.diff(np.unique(cells[:, 0])), KDTree(cells)
    side = float(across.min()) if len(across) else 1.0
    beside = (tree.sparse_distance_matrix(tree, 1.1 * side, output_type="coo_matrix").tocsr() > 0.0).astype(np.float64)
    corner = beside @ beside == 2.0  # two ways lead there: over either of the cells beside the diagonal
    corner.setdiag(False)
    return side * beside + math.sqrt(2.0) * side * corner


def _along(before: NDArray[np.int32], seen: Bits, reached: BoolArray) -> Bits:
    """(s, c, w) the features seen on paths, from what is `seen` (c, w) in each cell and the cell `before` (s, c) it."""
    # every round adds what the present predecessor has collected, and goes twice as far back
    out = np.where(reached[..., None], seen, np.uint64(0))
    while (before >= 0).any():
        from_cell = np.where(before >= 0, before, np.arange(len(seen)))
        out |= np.take_along_axis(out, from_cell[..., None], axis=1)
        before = np.where(before >= 0, np.take_along_axis(before, from_cell, axis=1), before)
    return out
