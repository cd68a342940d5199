"""Short episodes without an environment around them."""

import functools
from typing import Any

import numpy as np

from slam_gym.scenarios import Scenario, world_generator
from slam_gym.simulation.episode import Episode, Site, survey
from tests.rollouts import short

SMALL = short(60)
"""A small office, for episodes of 60 ticks."""


@functools.cache
def site_of(scenario: Scenario, world: int = 0) -> Site:
    return survey(scenario.generator(world_generator("train", world)), scenario)


def start(scenario: Scenario = SMALL, associator: Any = "jcbb", seed: int = 0, **options: Any) -> Episode:
    """An episode at its first look."""
    return Episode(scenario, site_of(scenario), associator, np.random.default_rng(seed), **options)


def drive(episode: Episode, ticks: int, seed: int = 0) -> Episode:
    """The same after some ticks of driving about, turning as often as not."""
    rng = np.random.default_rng(seed)
    for _ in range(ticks):
        episode.tick(float(rng.uniform(-0.2, 1.0)), float(rng.uniform(-1.0, 1.0)))
    return episode
