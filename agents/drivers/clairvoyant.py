"""The driver that knows the building: the upper reference among drivers, as `true_association` is among associators.

It is shown the plan, where it truly is, and which features its map holds. What it does not know is the noise to come.
"""

from __future__ import annotations

import math

import numpy as np

from agents.drivers.base import LOOK_AROUND, ActionKind, Info, Observation, legal_goals
from agents.drivers.information_gain import InformationGain
from agents.drivers.true_views import Bits, TrueViews, Ways, bits_of
from slam_gym._jit import compiled
from slam_gym.envs.observation import unsquash_goals
from slam_gym.geometry import compose, observe, transform
from slam_gym.simulation.episode import Episode
from slam_gym.types import Array

SPEED = 0.09  # [m/tick] along a path
OVERHEAD = 6.0  # [ticks] of a leg: to turn, to set off and to stop
LOOK = 32.0  # [ticks] to turn round once
TOURS = 32  # tried from each goal
NOISE = 0.4  # σ of the logarithm of a factor on what each viewpoint promises, drawn for each tour
EARLY = 0.2  # a feature that is mapped at once counts so much more than one at the end: plans may fail
ENOUGH = 0.5  # [features] a plan that promises less is none


class Clairvoyant:
    """The goal from which the best tour over the true rooms, in the ticks that are left, maps most features.

    Where no goal leads to anything more, it drives as information gain does.
    """

    name = "clairvoyant"
    action: ActionKind = "goal"

    def __init__(self) -> None:
        self._without_plan = InformationGain()
        self._episode: Episode | None = None

    def reset(self, seed: int) -> None:
        self._without_plan.reset(seed)

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
        goals, legal, here = unsquash_goals(observation["goals"]), legal_goals(info), self._episode.poses[-1]
        places = transform(here, np.column_stack([goals["x"], goals["y"]]))
        there, ways = self._views.nearest(places), self._views.ways_from(self._views.nearest(here[None, :2]))
        ticks = OVERHEAD + np.maximum(ways.lengths[0, there], goals["path"]) / SPEED
        ticks[LOOK_AROUND] = LOOK
        known, worth = self._known(), self._worth()
        values = np.full(len(legal), -np.inf)
        for k in np.flatnonzero(legal):
            values[k] = self._value(int(there[k]), float(ticks[k]), ways, known, worth)
        return values

    def _value(self, cell: int, ticks: float, way: Ways, known: Bits, worth: Array) -> float:
        """What the way to a cell brings, and the best tour from there."""
        assert self._episode is not None
        ways = self._views.ways
        left = float(self._episode.scenario.budget - self._episode.ticks)
        found = gained(known, way.seen[0, cell], worth)
        if ticks >= left:
            return found * left / ticks
        early = EARLY * (left - ticks) / left
        start = OVERHEAD + ways.lengths[:, cell] / SPEED, np.ascontiguousarray(ways.seen[:, cell])
        more = best_tour(start, self._between, left - ticks, known | way.seen[0, cell], worth, self._chance, early)
        return found * (1.0 + early) + more

    def _known(self) -> Bits:
        """The features that the map holds already."""
        assert self._episode is not None
        mapped = np.zeros(len(self._episode.site.plan.features), np.bool_)
        for part in self._episode.slam.maps:
            sources = self._episode.identities.source_of(part.ids[~part.provisional])
            mapped[sources[sources >= 0]] = True
        return bits_of(mapped)

    def _worth(self) -> Array:
        """(n,) by how much each feature lowers N · E where it is mapped from a pose that is as wrong as now: 1 at best,
        −1 where it ends up so far off that it is missing still, and false besides."""
        episode = self._episode
        assert episode is not None
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
