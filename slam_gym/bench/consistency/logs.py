"""The logs on which estimators are compared: a corridor driven round, a hall and an office explored, Victoria Park.

**Loop.** A square corridor, features at random along both walls, driven round one and a quarter times; σ of the heading
is a setting. **Hall**, **Willow**: the scenario "hall", and the Willow Garage map with that scenario's robot, explored
by an EKF with JCBB that drives to the nearest frontier; odometry, scans and truth are written down and given to all
estimators alike. **Park**: the log with the least-squares trajectory and trunks as the truth. That was made of the
same measurements, so that a consistent filter has an ANEES below 1 there, not at 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slam_gym.association import jcbb
from slam_gym.bench.consistency.estimators import DrivenLog, LogStep
from slam_gym.bench.recordings.places import reference
from slam_gym.bench.sensing import features_in_view
from slam_gym.geometry import compose, observe
from slam_gym.mapping.stochastic_map import MapSpec
from slam_gym.recordings.recording import Recording
from slam_gym.recordings.victoria_park import victoria_park
from slam_gym.scenarios import Scenario, from_floor_plan, get_scenario, world_generator
from slam_gym.scenarios.registry import slam_for
from slam_gym.simulation.association_runs import DrivenRun, nearest_frontier
from slam_gym.simulation.episode import survey
from slam_gym.slam.slam import SlamSpec
from slam_gym.types import Array, Odometry, Scan, Truth

_SPEC = SlamSpec(MapSpec(unconfirmed_age=5), new_confidence=1.0 - 1e-6)
_AROUND = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])  # along the sides of a square


@dataclass(frozen=True)
class LoopSpec:
    """The corridor driven round."""

    heading: float = 2.0  # [deg] σ of the heading, per step of a metre
    side: int = 50  # [m] of the square
    width: float = 5.0  # [m] between the walls
    spacing: float = 3.0  # [m] of wall per feature
    reach: float = 8.0  # [m]
    laps: float = 1.25
    range_sigma: float = 0.02  # of the range
    bearing_sigma: float = math.radians(0.5)
    along: float = 0.05  # [m] σ of a step, forwards and sideways


def loop(seed: int, spec: LoopSpec) -> DrivenLog:
    """The robot drives anticlockwise, turning by 90° at each corner within a step."""
    rng = np.random.default_rng(seed)
    features = _walls(spec, rng)
    sigma = np.array([spec.along, spec.along, math.radians(spec.heading)])
    pose, steps = np.zeros(3), []
    for step in range(round(4 * spec.side * spec.laps) + 1):
        odometry = Odometry.from_motion(np.zeros(3), 0.0)
        if step:
            moved = np.array([1.0, 0.0, math.pi / 2.0 if step % spec.side == 0 else 0.0])
            pose = compose(pose, moved)
            odometry = Odometry.from_motion(moved + sigma * rng.standard_normal(3), sigma)
        steps.append((odometry, *_scan(pose, features, spec, rng)))
    name = f"loop, {spec.heading:g}°" + (", sparse" if spec.spacing > 5.0 else "")
    return DrivenLog(name, seed, steps, dict(enumerate(features)), replace(_SPEC, reach=spec.reach), 30)


def _walls(spec: LoopSpec, rng: np.random.Generator) -> Array:
    """Features (n, 2), spread evenly at random over the outer and the inner wall."""
    features = []
    for low in (-0.5 * spec.width, 0.5 * spec.width):  # of the outer and the inner square
        length = spec.side - 2.0 * low
        corners = low + length * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
        for along in rng.uniform(0.0, 4.0, round(4.0 * length / spec.spacing)).tolist():
            features.append(corners[int(along)] + (along % 1.0) * length * _AROUND[int(along)])
    return np.array(features)


def _scan(pose: Array, features: Array, spec: LoopSpec, rng: np.random.Generator) -> tuple[Scan, Truth]:
    seen = features_in_view(features, pose, spec.reach, math.pi)
    local = observe(pose, features[seen])
    ranges, bearings = np.hypot(*local.T), np.arctan2(local[:, 1], local[:, 0])
    measured = ranges * (1.0 + spec.range_sigma * rng.standard_normal(len(seen)))
    angles = bearings + spec.bearing_sigma * rng.standard_normal(len(seen))
    return Scan.from_polar(measured, angles, spec.range_sigma * measured, spec.bearing_sigma), Truth(pose, seen)


def explored(world: str, seed: int, scenario: Scenario, ticks: int) -> DrivenLog:
    """So many ticks of a scenario; the seed is that of the test world, too."""
    scenario = replace(scenario, budget=ticks)
    site = survey(scenario.generator(world_generator("test", seed)), scenario)
    driven = DrivenRun(scenario, site, nearest_frontier, np.random.default_rng(seed))
    steps: list[LogStep] = [(driven.episode.odometry, driven.scan, driven.truth)]
    while not driven.over:
        driven.next_scan()
        steps.append((driven.episode.odometry, driven.scan, driven.truth))
        driven.associate(jcbb(driven.scan, driven.prediction))
    features = dict(enumerate(site.plan.features.positions))
    return DrivenLog(world, seed, steps, features, replace(scenario.slam, reach=scenario.sensor.range), 30)


def hall(seed: int, ticks: int) -> DrivenLog:
    """The scenario "hall"."""
    return explored("hall", seed, get_scenario("hall"), ticks)


def floor(path: Path, seed: int, ticks: int) -> DrivenLog:
    """A floor plan image of 0.1 m a pixel, with the robot of the scenario "hall"."""
    return explored(path.stem, seed, from_floor_plan(path, 0.1, get_scenario("hall")), ticks)


class ParkLog(NamedTuple):
    """Victoria Park."""

    log: DrivenLog
    recording: Recording  # for its GPS


def park(folder: Path, steps: int | None = None) -> ParkLog:
    """Victoria Park, or its first steps."""
    recording = victoria_park(folder).part(0, steps)
    optimum = reference(recording)
    driven = [
        (odometry, scan, Truth(pose, sources))
        for (odometry, scan, sources), pose in zip(recording.steps(), optimum.poses)
    ]
    places = dict(zip(optimum.ids.tolist(), optimum.landmarks))
    return ParkLog(DrivenLog("park", 0, driven, places, slam_for(recording), 60, checkpoints=60), recording)
