"""Quantities whose decrease in a step is the reward of `Explore-v0`, so that rewards sum to the total decrease.

`map_error` uses the truth. The others do not: they are functions of the robot's own covariances over the fixed cells of
a virtual map, and therefore reward an overconfident associator.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from slam_gym.navigation.virtual_map import VirtualMap
from slam_gym.simulation.episode import Episode


def map_error(episode: Episode) -> float:
    """E = GOSPA(p = 1, α = 2, c = 2σ₀) / (σ₀ N): 1 for an empty map, 0 for a perfect one."""
    return episode.map_error()


def a_opt(episode: Episode) -> float:
    """Mean eigenvalue over the virtual map, in units of σ₀²: 1 for an unseen world."""
    return _virtual(episode).a_opt() / episode.scenario.prior_sigma**2


def d_opt(episode: Episode) -> float:
    """exp(mean log eigenvalue) over the virtual map, in units of σ₀²: 1 for an unseen world."""
    return _virtual(episode).d_opt() / episode.scenario.prior_sigma**2


def entropy(episode: Episode) -> float:
    """Mean entropy [nat] per coordinate of the virtual map, relative to an unseen world: 0 there, then negative."""
    unseen = 0.5 * math.log(2.0 * math.pi * math.e * episode.scenario.prior_sigma**2)
    return _virtual(episode).entropy() - unseen


def _virtual(episode: Episode) -> VirtualMap:
    if episode.virtual_map is None:
        raise ValueError("the episode keeps no virtual map: ask for it with Episode(…, virtual=True)")
    return episode.virtual_map


REWARDS: dict[str, Callable[[Episode], float]] = {
    "map_error": map_error,
    "a_opt": a_opt,
    "d_opt": d_opt,
    "entropy": entropy,
}
