"""Consistency of estimators on long drives: the EKF of the papers, the right-invariant EKF, and joined local maps.

All have the same logs, with JCBB and, except for local maps, with true association: a square corridor driven round one
and a quarter times, with much noise of the heading, and Victoria Park, with the least-squares optimum of its labels as
the truth. ANEES of the pose is the mean over checkpoints per degree of freedom, which is 1 for a consistent filter; the
optimum uses the same measurements, so that a consistent filter has less than 1 in the park. The pose of local maps is
that in the map joined at the checkpoint. A loop counts as closed if the final map has fewer than five duplicates.

    python benchmarks/consistency.py       # fifteen minutes
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pandas as pd

from benchmarks.common import Record, options, proportion, published, table, timed
from benchmarks.recordings import reference
from slam_gym import LocalMapSlam, MapSpec, Odometry, Scan, Slam, SlamSpec
from slam_gym.geometry import compose, observe, relative
from slam_gym.metrics.consistency import pose_nees
from slam_gym.recordings import Recording
from slam_gym.scenarios import slam_for
from slam_gym.simulation.judged import JudgedSlam
from slam_gym.simulation.surveyed_field import features_in_view
from slam_gym.types import Array, IntArray, Truth

METHODS = ("standard", "right-invariant", "local maps")
CLOSED = 5  # duplicates
SPEC = SlamSpec(MapSpec(unconfirmed_age=5), new_confidence=1.0 - 1e-6)
AROUND = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])  # along the sides of a square


@dataclass(frozen=True, eq=False)
class DrivenLog:
    """A log of steps that do not depend on the estimate, with the truth behind them."""

    world: str
    steps: Sequence[tuple[Odometry, Scan, Truth]]
    slam: SlamSpec
    features_per_map: int
    checkpoints: int


class LoopSpec(NamedTuple):
    """The settings of the square corridor."""

    heading: float = 2.0  # [deg] σ of the heading, per step of a metre
    side: int = 50  # [m] of the square
    width: float = 5.0  # [m] between the walls
    spacing: float = 3.0  # [m] of wall per feature
    reach: float = 8.0  # [m]
    laps: float = 1.25
    range_sigma: float = 0.02  # [m/m] of the range
    bearing_sigma: float = math.radians(0.5)
    along: float = 0.05  # [m] σ of a step, forwards and sideways


def loop(seed: int, spec: LoopSpec) -> DrivenLog:
    """A drive round the corridor, anticlockwise, with a turn of 90° within the step at each corner."""
    rng = np.random.default_rng(seed)
    features = walls(spec, rng)
    sigma = np.array([spec.along, spec.along, math.radians(spec.heading)])
    pose, steps = np.zeros(3), []
    for step in range(round(4 * spec.side * spec.laps) + 1):
        odometry = Odometry.from_motion(np.zeros(3), 0.0)
        if step:
            moved = np.array([1.0, 0.0, math.pi / 2.0 if step % spec.side == 0 else 0.0])
            pose = compose(pose, moved)
            odometry = Odometry.from_motion(moved + sigma * rng.standard_normal(3), sigma)
        seen = features_in_view(features, pose, spec.reach, math.pi)
        local = observe(pose, features[seen])
        ranges = np.hypot(*local.T) * (1.0 + spec.range_sigma * rng.standard_normal(len(seen)))
        bearings = np.arctan2(local[:, 1], local[:, 0]) + spec.bearing_sigma * rng.standard_normal(len(seen))
        scan = Scan.from_polar(ranges, bearings, spec.range_sigma * ranges, spec.bearing_sigma)
        steps.append((odometry, scan, Truth(pose, seen)))
    name = f"loop, {spec.heading:g}°" + (", sparse" if spec.spacing > 5.0 else "")
    return DrivenLog(name, steps, replace(SPEC, reach=spec.reach), 30, 20)


def walls(spec: LoopSpec, rng: np.random.Generator) -> Array:
    """Features (n, 2) [m], uniformly distributed over the outer and the inner wall."""
    features = []
    for low in (-0.5 * spec.width, 0.5 * spec.width):  # of the outer and the inner square
        length = spec.side - 2.0 * low
        corners = low + length * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
        for along in rng.uniform(0.0, 4.0, round(4.0 * length / spec.spacing)).tolist():
            features.append(corners[int(along)] + (along % 1.0) * length * AROUND[int(along)])
    return np.array(features)


def park(log: Recording) -> DrivenLog:
    """Victoria Park, or a part of it, with the least-squares optimum as the truth."""
    poses = reference(log).poses
    driven = [(odometry, scan, Truth(pose, seen)) for (odometry, scan, seen), pose in zip(log.steps(), poses)]
    return DrivenLog("park", driven, slam_for(log), 60, 60)


def estimate(log: DrivenLog, method: str, associator: str) -> Record:
    """Run one of METHODS over a log; returns errors in B, without alignment, and the time of steps and joins."""
    spec = log.slam
    if method != "right-invariant":
        spec = replace(spec, map=replace(spec.map, iterations=1, right_invariant=False, second_order=False))
    slam = LocalMapSlam(spec, log.features_per_map) if method == "local maps" else Slam(spec)
    judged, base = JudgedSlam(slam, associator), log.steps[0][2].pose
    checked = set(np.linspace(0, len(log.steps) - 1, log.checkpoints + 1)[1:].round().astype(int).tolist())
    microseconds, nees, errors = 0.0, [], []
    for step, (odometry, scan, truth) in enumerate(log.steps):
        microseconds += timed(judged.step, odometry, scan, truth)[1]
        if step in checked:
            (pose, covariance, ids), joining = timed(present, slam)
            microseconds += joining
            true = relative(base, truth.pose)
            nees.append(pose_nees(pose, covariance, true))
            errors.append(math.dist(pose[:2], true[:2]))
    sources = judged.identities.source_of(ids)
    sources = sources[sources >= 0]
    row: Record = {"world": log.world, "method": method, "associator": associator}
    row |= {"ANEES": float(np.mean(nees)) / 3.0, "error [m]": math.sqrt(np.mean(np.square(errors)))}
    row |= {"final [m]": errors[-1], "duplicates": len(sources) - len(np.unique(sources)), "features": len(ids)}
    return row | {"seconds": 1e-6 * microseconds}


def present(slam: Slam | LocalMapSlam) -> tuple[Array, Array, IntArray]:
    """The pose (3,), its covariance (3, 3) and the ids (n,) of the features. Joins local maps."""
    if isinstance(slam, Slam):
        return slam.map.pose, slam.map.pose_covariance, slam.map.ids
    joined = slam.smoothed()
    return joined.poses[-1], joined.covariance([len(slam.maps)]), joined.ids


if __name__ == "__main__":
    a = options(__doc__, seeds=40)
    seeds = 1 if a.quick else a.seeds
    specs = (LoopSpec(side=10),) if a.quick else (LoopSpec(0.5), LoopSpec(), LoopSpec(5.0), LoopSpec(spacing=8.0))
    logs = [loop(seed, spec) for spec in specs for seed in range(seeds)]
    recorded = published("victoria_park")
    if recorded is not None:
        logs.append(park(recorded.part(0, 300 if a.quick else None)))
    runs = [(log, method, name) for log in logs for name in ("jcbb", "true_association") for method in METHODS]
    results = pd.DataFrame(estimate(*run) for run in runs if run[1:] != ("local maps", "true_association"))
    groups = results.groupby(["world", "associator", "method"], sort=False)
    medians = groups.median(numeric_only=True)
    medians.insert(0, "runs", groups.size())
    closed = groups["duplicates"].apply(lambda counts: proportion(int((counts < CLOSED).sum()), len(counts)))
    table("Medians over the runs", medians.assign(closed=closed).reset_index())
