"""Short episodes without an environment around them."""

import functools
from typing import Any

import numpy as np

from slam_gym.geometry import observe
from slam_gym.scenarios import Scenario, world_generator
from slam_gym.simulation.episode import Episode, Site, survey
from slam_gym.types import SPURIOUS, UNLABELLED, Odometry, Scan, Truth
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


def circle(
    looks: int,
    seed: int = 0,
    features: int = 12,
    *,
    spread: float = 4.0,
    sigma: float = 0.02,
    spurious: float = 0.0,
    unlabelled: float = 0.0,
) -> list[tuple[Odometry, Scan, Truth]]:
    """A robot going round among features within `spread` [m], with the truth about each look; W is B."""
    rng = np.random.default_rng(seed)
    world, pose, out = rng.uniform(-spread, spread, (features, 2)), np.zeros(3), []
    for look in range(looks):
        motion = np.array([0.2, 0.0, 0.1]) if look else np.zeros(3)
        c, s = np.cos(pose[2]), np.sin(pose[2])
        pose = np.array([pose[0] + c * motion[0], pose[1] + s * motion[0], pose[2] + motion[2]])
        points, sources = observe(pose, world) + sigma * rng.standard_normal((features, 2)), np.arange(features)
        sources = np.where(rng.random(features) < unlabelled, UNLABELLED, sources)
        strange = rng.random(features) < spurious
        points[strange], sources[strange] = rng.uniform(-spread, spread, (int(strange.sum()), 2)), SPURIOUS
        odometry = Odometry.from_motion(motion + [0.01, 0.01, 0.003] * rng.standard_normal(3), [0.01, 0.01, 0.003])
        out.append((odometry, Scan.from_points(points, sigma=sigma), Truth(pose.copy(), sources)))
    return out
