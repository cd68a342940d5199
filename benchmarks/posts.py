"""Simulated logs among posts, with clutter, poor detection, slip, wrong σ or few scans: who maps a post twice?

A robot drives twice round a field of posts, as in courses on EKF-SLAM.

80 posts at random in 60 m × 40 m, at least 1 m apart; 1 413 steps of 0.25 m along a ring, a cross and the ring again; a
sensor that sees 12 m far and 90° to either side. The treatment of slip, and of old features beside near ones, was
developed on logs of this kind with other random numbers. Features mapped twice, precision, recall and the error of the
aligned path for every kind of log, means over the seeds.

    python benchmarks/posts.py       # two minutes
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
import pandas as pd

from agents.evaluation.mapped_log import associations, compare, map_log
from benchmarks.common import options, table
from slam_gym.geometry import compose, observe, relative, wrap_angle
from slam_gym.metrics.map_quality import ate
from slam_gym.recordings.recording import Recording
from slam_gym.scenarios.registry import slam_for
from slam_gym.slam.relocate import SEARCH
from slam_gym.types import SPURIOUS, Array, Scan

SIZE, POSTS, APART = np.array([60.0, 40.0]), 80, 1.0  # [m]; number; [m]
RING = [(8, 6), (30, 6), (52, 6), (52, 20), (52, 34), (30, 34), (8, 34), (8, 20)]
CROSS = [*RING[:2], (30, 20), (30, 34), (8, 34), (8, 20), (30, 20), (52, 20), *RING[4:]]
STEP, TURN, NEAR = 0.25, math.radians(8.0), 1.7  # [m], [rad] at most, [m] from a waypoint to the next one
RANGE, RANGE_SIGMA, BEARING_SIGMA = 12.0, 0.05, 0.01  # [m], [m], [rad]
SLIPS = 0.01  # fraction of the steps in which wheels slip, if they do
MEASURES = ["duplicates", "precision", "recall", "ate"]


@dataclass(frozen=True)
class Variation:
    """What is special about a log."""

    clutter: float = 0.3  # mean number of spurious measurements in a scan
    detection: float = 0.95
    slip: float = 1.0  # factor on the error of a step in which wheels slip
    claimed: float = 1.0  # σ of the measurements in the log, relative to the true σ
    every: int = 1  # [steps] between scans


VARIATIONS = {
    "nominal": Variation(), "clutter": Variation(clutter=5.0), "detection 0.6": Variation(detection=0.6),
    "slip of 10 σ": Variation(slip=10.0), "slip of 30 σ": Variation(slip=30.0), "σ / 1.5": Variation(claimed=1.0 / 1.5),
    "σ × 3": Variation(claimed=3.0), "every 10th scan": Variation(every=10),
}  # fmt: skip


def driven() -> Array:
    """(T, 3) poses along the waypoints."""
    waypoints = np.array([*RING, *CROSS, RING[0]], np.float64)
    poses = [np.array([*waypoints[0], 0.0])]
    for goal in waypoints[1:]:
        while np.hypot(*(goal - poses[-1][:2])) >= NEAR:
            x, y = observe(poses[-1], goal[None])[0]
            turn = float(np.clip(math.atan2(y, x), -TURN, TURN))
            poses.append(compose(poses[-1], np.array([STEP * math.cos(turn / 2), STEP * math.sin(turn / 2), turn])))
    return np.array(poses)


def simulated(variation: Variation, seed: int) -> Recording:
    """The log of a drive, with its landmarks and true poses."""
    rng, poses, posts = np.random.default_rng(seed), driven(), np.empty((0, 2))
    while len(posts) < POSTS:
        post = SIZE * rng.random(2)
        if (np.hypot(*(posts - post).T) > APART).all():
            posts = np.concatenate([posts, post[None]])
    motions, covariances = np.zeros((len(poses), 3)), np.tile(1e-6 * np.eye(3), (len(poses), 1, 1))
    ranges, bearings, sources = [], [], []
    for k, pose in enumerate(poses):
        if k:
            motions[k] = relative(poses[k - 1], pose)
            sigmas = np.array([0.0075, 0.00375, 0.002 + 0.02 * abs(motions[k, 2])])
            slip = variation.slip if rng.random() < SLIPS else 1.0
            motions[k] += slip * sigmas * rng.standard_normal(3)
            covariances[k] = np.diag(sigmas**2)
        x, y = observe(pose, posts).T
        seen = np.flatnonzero((np.hypot(x, y) < RANGE) & (x > 0.0) & (rng.random(POSTS) < variation.detection))
        count = rng.poisson(variation.clutter)
        r = np.hypot(x, y)[seen] + RANGE_SIGMA * rng.standard_normal(len(seen))
        beta = np.arctan2(y, x)[seen] + BEARING_SIGMA * rng.standard_normal(len(seen))
        ranges.append(np.concatenate([np.maximum(r, 0.1), RANGE * np.sqrt(rng.uniform(0.01, 1.0, count))]))
        bearings.append(np.concatenate([[wrap_angle(b) for b in beta], rng.uniform(-1.5, 1.5, count)]))
        sources.append(np.concatenate([seen, np.full(count, SPURIOUS)]))
    starts = np.concatenate([[0], np.cumsum([len(rows) for rows in sources])])
    claimed, times = (variation.claimed * RANGE_SIGMA, variation.claimed * BEARING_SIGMA), np.arange(len(poses))
    scans = Scan.from_polar(np.concatenate(ranges), np.concatenate(bearings), *claimed)
    log = Recording(
        name="posts", source="simulated", terms="", times=0.25 * times, motions=motions, motion_covariances=covariances,
        starts=starts.astype(np.int64), points=scans.points, covariances=scans.covariances,
        sources=np.concatenate(sources).astype(np.int64), reference_times=0.25 * times, reference_poses=poses,
        landmark_ids=np.arange(POSTS), landmarks=posts, range=RANGE, field_of_view=math.pi,
    )  # fmt: skip
    return log.every(variation.every)


def main() -> None:
    a = options(__doc__, associators=("jcbb", "marginal"), seeds=4)
    rows = []
    for (name, variation), seed in product(VARIATIONS.items(), range(a.seed, a.seed + (1 if a.quick else a.seeds))):
        log = simulated(variation, seed)
        log = log.part(0, 40 // variation.every) if a.quick else log
        for associator in a.associators:
            mapped = map_log(log, associator, slam_for(log), SEARCH)
            compared, measures = compare(log, mapped.poses), associations(mapped)
            error = ate(compared.estimated, compared.reference, aligned=True)
            rows.append({"associator": associator, "log": name, "seed": seed} | measures | {"ate": error})
    groups = pd.DataFrame(rows).groupby(["associator", "log"], sort=False)
    table("Means", groups[MEASURES].mean().join(groups["duplicates"].max().rename("most")).reset_index())


if __name__ == "__main__":
    main()
