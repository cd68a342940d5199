"""A driver that knows the building: the upper reference. It knows the plan and where it truly is, not the noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agents.drivers.base import LOOK_AROUND, ActionKind, Info, Observation, legal_goals
from agents.drivers.information_gain import InformationGain
from agents.drivers.tours import best_tour, gained
from agents.drivers.true_views import TrueViews, bits_of
from slam_gym.envs.goal_observation import unsquash_goals
from slam_gym.geometry import compose, observe, transform
from slam_gym.simulation.episode import Episode
from slam_gym.types import Array


@dataclass(frozen=True)
class TourSpec:
    speed: float = 0.09  # [m/tick] along a path
    overhead: float = 6.0  # [ticks] of a leg: to turn, to set off and to stop
    look: float = 32.0  # [ticks] to turn round once
    tours: int = 48  # tried from each goal
    noise: float = 0.4  # of the logarithm of what a viewpoint promises
    drift: bool = True
    early: float = 0.2  # a feature seen at once is worth so much more than one seen at the end


class Clairvoyant:
    """The goal from which the best tour over the true rooms, in the ticks that are left, maps most features."""

    name = "clairvoyant"
    action: ActionKind = "goal"

    def __init__(self, spec: TourSpec | None = None) -> None:
        self._spec = spec or TourSpec()
        self._fallback = InformationGain()

    def behold(self, episode: Episode) -> None:
        self._episode = episode
        self._views = TrueViews(episode.site, episode.scenario.sensor.range)
        ways, spec = self._views.ways, self._spec
        ends = self._views.viewpoints
        self._ticks = spec.overhead + ways.lengths[:, ends] / spec.speed
        self._legs = np.ascontiguousarray(ways.seen[:, ends])
        rng = np.random.default_rng(0)
        self._noise = np.exp(spec.noise * rng.standard_normal((spec.tours, len(ends))))
        self._noise[:4] = 1.0

    def reset(self, seed: int) -> None:
        self._fallback.reset(seed)

    def act(self, observation: Observation, info: Info) -> int:
        values = self.values(observation, info)
        chosen = int(np.argmax(values))
        fallback = self._fallback.act(observation, info)
        if values[chosen] - values[LOOK_AROUND] < 0.5 and values[chosen] < 1.0:
            return fallback
        return chosen

    def values(self, observation: Observation, info: Info) -> Array:
        """(SLOTS,) features that will be mapped at the end beyond those mapped now; −inf where not legal."""
        episode, spec, views = self._episode, self._spec, self._views
        goals, legal = unsquash_goals(observation["goals"]), legal_goals(info)
        left = float(episode.scenario.budget - episode.ticks)
        pose = episode.poses[-1]
        places = transform(pose, np.column_stack([goals["x"], goals["y"]]).astype(float))
        known = self._known()
        here = views.nearest(pose[None, :2])
        first = views.ways_from(here)
        cells = views.nearest(places)
        values = np.full(len(legal), -np.inf)
        noise, worth = self._noise, self._worth()
        for k in np.flatnonzero(legal):
            cell = cells[k]
            length = max(first.lengths[0, cell], goals["path"][k])
            ticks = spec.look if k == LOOK_AROUND else spec.overhead + length / spec.speed
            if ticks > left:
                continue_ = left / ticks
                values[k] = continue_ * gained(known, first.seen[0, cell], worth)
                continue
            seen = first.seen[0, cell]
            now = known | seen
            found = gained(known, seen, worth) * (1.0 + spec.early * (left - ticks) / left)
            starts = spec.overhead + views.ways.lengths[:, cell] / spec.speed
            values[k] = found + best_tour(
                starts, np.ascontiguousarray(views.ways.seen[:, cell]), self._ticks, self._legs, left - ticks, now,
                worth, noise, spec.early * (left - ticks) / left,
            )  # fmt: skip
        return values

    def _worth(self) -> Array:
        """(n,) by how much each feature would lower the sum of errors, mapped from a pose as wrong as the present one."""
        episode = self._episode
        true = episode.site.plan.features.positions
        if not self._spec.drift:
            return np.ones(len(true))
        mapped = transform(compose(episode.base, episode.estimates[-1]), observe(episode.poses[-1], true))
        off = np.hypot(*(mapped - true).T) / episode.scenario.prior_sigma
        return 1.0 - np.minimum(off, 2.0)

    def _known(self):
        episode = self._episode
        mapped = np.zeros(len(episode.site.plan.features), np.bool_)
        for m in episode.slam.maps:
            sources = episode.identities.source_of(m.ids[~m.provisional])
            mapped[sources[sources >= 0]] = True
        return bits_of(mapped)
