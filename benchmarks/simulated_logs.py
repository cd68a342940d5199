"""Simulated logs in the manner of well-known simulators and courses: who maps a feature twice?

posts     80 posts in 60 m × 40 m, passed twice; with much clutter, poor detection, slip, wrong σ or few scans
streets   trees at the corners of streets 5 m apart, seen at every corner only, as in cityTrees10000 (Kaess)
dense     a feature in every square metre, a view of 2.5 m and 2° of error a metre, as in the tutorial of g2o;
          dense-long: half as long again
car       35 landmarks that a car passes twice with a view of 30 m, as in the EKF-SLAM simulator of Bailey and Nieto
doors     corridors around a block of 60 m × 22 m with doors on both sides, passed twice

Settings for real data were developed on such logs with other random numbers. Features mapped twice, precision, recall
and the error of the aligned path for every kind of log, means over the seeds.

    python benchmarks/simulated_logs.py       # ten minutes
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np
import pandas as pd

from agents.evaluation.mapped_log import associations, compare, map_log
from benchmarks.common import options, table
from slam_gym.geometry import compose, observe, relative
from slam_gym.metrics.map_quality import ate
from slam_gym.recordings.recording import Recording, starts_of
from slam_gym.scenarios import slam_for
from slam_gym.simulation.judged import CEILING
from slam_gym.slam.relocate import SEARCH
from slam_gym.types import SPURIOUS, Array, Scan

SLIPS = 0.01  # fraction of the steps in which wheels slip, if they do
MEASURES = ["duplicates", "precision", "recall", "ate"]
Site = tuple[Array, Array]
"""Landmarks (n, 2) [m] and the poses (T, 3) of the drive past them."""


def driven(waypoints: Array, step: float, turn: float, near: float) -> Array:
    """(T, 3) poses along the waypoints (w, 2) [m], `step` [m] apart, with turns of at most `turn` [rad]. A waypoint
    counts as reached within `near` [m]."""
    poses = [np.array([*waypoints[0], 0.0])]
    for goal in waypoints[1:]:
        while np.hypot(*(goal - poses[-1][:2])) >= near:
            x, y = observe(poses[-1], goal[None])[0]
            angle = float(np.clip(math.atan2(y, x), -turn, turn))
            poses.append(compose(poses[-1], np.array([step * math.cos(angle / 2), step * math.sin(angle / 2), angle])))
    return np.array(poses)


def walked(rng: np.random.Generator, block: int, blocks: int, steps: int) -> Array:
    """(steps, 3) poses 1 m apart on the streets of a square town, with turns at random corners."""
    pose, poses = np.array([block * (blocks // 2), block * (blocks // 2), 0.0]), []
    for k in range(steps):
        if k % block == 0:
            turns = rng.permutation([0.0, 0.0, 0.5 * math.pi, -0.5 * math.pi])
            ends = [compose(pose, np.array([0.0, 0.0, turn])) for turn in (*turns, math.pi)]
            inside = [np.abs(compose(end, np.array([block, 0, 0]))[:2] / block / blocks - 0.5).max() for end in ends]
            pose = ends[int(np.argmax(np.array(inside) <= 0.501))]
        pose = compose(pose, np.array([1.0, 0.0, 0.0]))
        poses.append(pose)
    return np.array(poses)


def posts(rng: np.random.Generator) -> Site:
    size, places = np.array([60.0, 40.0]), np.empty((0, 2))
    while len(places) < 80:
        place = size * rng.random(2)
        if (np.hypot(*(places - place).T) > 1.0).all():
            places = np.concatenate([places, place[None]])
    ring = [(8, 6), (30, 6), (52, 6), (52, 20), (52, 34), (30, 34), (8, 34), (8, 20)]
    cross = [*ring[:2], (30, 20), (30, 34), (8, 34), (8, 20), (30, 20), (52, 20), *ring[4:]]
    return places, driven(np.array([*ring, *cross, ring[0]], np.float64), 0.25, math.radians(8.0), 1.7)


def streets(rng: np.random.Generator) -> Site:
    return 5.0 * (np.argwhere(rng.random((20, 20)) < 0.25) + 0.5), walked(rng, 5, 20, 3000)


def dense(rng: np.random.Generator, steps: int = 1000) -> Site:
    path, (x, y) = walked(rng, 5, 8, steps), np.mgrid[-3:44, -3:44]
    return np.column_stack([x.ravel(), y.ravel()]) + rng.uniform(-0.4, 0.4, (x.size, 2)), path


def car(rng: np.random.Generator) -> Site:
    angles, radii = np.linspace(0.0, 2.0 * math.pi, 10, endpoint=False), rng.uniform(60.0, 90.0, (10, 1))
    ring = radii * np.column_stack([np.cos(angles), np.sin(angles)])
    return rng.uniform(-110.0, 110.0, (35, 2)), driven(np.concatenate([ring, ring, ring[:1]]), 0.6, 0.087, 4.0)


def doors(rng: np.random.Generator) -> Site:
    along, across = np.arange(2.0, 58.0, 4.0) + rng.uniform(-0.8, 0.8, 14), np.arange(4.0, 19.0, 4.0)
    jambs = [(x + w, y) for x in along for y in (0.0, 2.0, 20.0, 22.0) for w in (0.0, 0.9)]
    jambs += [(x, y + w) for x in (0.0, 2.0, 58.0, 60.0) for y in across for w in (0.0, 0.9)]
    block = np.array([(1, 1), (59, 1), (59, 21), (1, 21), (1, 1), (59, 1), (59, 21), (1, 21), (1, 1)], np.float64)
    return np.array(jambs), driven(block, 0.2, math.radians(8.0), 0.6)


@dataclass(frozen=True)
class LogKind:
    """A kind of log: the site, the sensor and the odometry."""

    site: Callable[[np.random.Generator], Site] = posts
    view: tuple[float, float] = (12.0, 0.5 * math.pi)  # [m] how far, [rad] how far to either side it sees
    sigmas: tuple[float, float] = (0.05, 0.01)  # [m] of ranges, [rad] of bearings
    odometry: tuple[float, float, float] = (0.0075, 0.00375, 0.002)  # [m, m, rad] σ of a step
    turning: float = 0.02  # [rad] σ for each radian of a turn
    clutter: float = 0.3  # mean number of spurious measurements in a scan
    detection: float = 0.95
    slip: float = 1.0  # factor on the error of a step in which wheels slip
    claimed: float = 1.0  # σ of the measurements in the log, relative to the true σ
    every: int = 1  # [steps] between scans


DENSE = LogKind(dense, (2.5, math.pi), (0.05, 0.02), (0.05, 0.01, 0.035), 0.0, 0.0, 0.8)
KINDS = {
    "posts": LogKind(), "clutter": LogKind(clutter=5.0), "detection 0.6": LogKind(detection=0.6),
    "slip of 10 σ": LogKind(slip=10.0), "slip of 30 σ": LogKind(slip=30.0), "σ / 1.5": LogKind(claimed=1.0 / 1.5),
    "σ × 3": LogKind(claimed=3.0), "every 10th scan": LogKind(every=10),
    "streets": LogKind(streets, (8.0, math.pi), (0.1, 0.0125), (0.02, 0.02, 0.01), 0.0, 0.0, 1.0, every=5),
    "dense": DENSE, "dense-long": replace(DENSE, site=partial(dense, steps=1500)),
    "car": LogKind(car, (30.0, 0.5 * math.pi), (0.1, 0.0175), (0.021, 0.002, 0.0028), 0.0, 0.0, 1.0),
    "doors": LogKind(doors, (6.0, math.radians(120.0)), (0.05, 0.01), (0.0134, 0.0067, 0.009), 0.05),
}  # fmt: skip


def simulated(kind: LogKind, seed: int) -> Recording:
    """The log of a drive, with its landmarks and true poses."""
    rng = np.random.default_rng(seed)
    landmarks, poses = kind.site(rng)
    (reach, side), (range_sigma, bearing_sigma) = kind.view, kind.sigmas
    motions, covariances = np.zeros((len(poses), 3)), np.tile(1e-6 * np.eye(3), (len(poses), 1, 1))
    ranges, bearings, sources = [], [], []
    for k, pose in enumerate(poses):
        if k:
            motions[k] = relative(poses[k - 1], pose)
            forward, lateral, turn = kind.odometry
            sigmas = np.array([forward, lateral, turn + kind.turning * abs(motions[k, 2])])
            slip = kind.slip if rng.random() < SLIPS else 1.0
            motions[k] += slip * sigmas * rng.standard_normal(3)
            covariances[k] = np.diag(sigmas**2)
        x, y = observe(pose, landmarks).T
        r, beta = np.hypot(x, y), np.arctan2(y, x)
        seen = np.flatnonzero((r < reach) & (np.abs(beta) < side) & (rng.random(len(landmarks)) < kind.detection))
        count = rng.poisson(kind.clutter)
        r = r[seen] + range_sigma * rng.standard_normal(len(seen))
        beta = beta[seen] + bearing_sigma * rng.standard_normal(len(seen))
        ranges.append(np.concatenate([np.maximum(r, 0.1), reach * np.sqrt(rng.uniform(0.01, 1.0, count))]))
        bearings.append(np.concatenate([beta, rng.uniform(-side, side, count)]))
        sources.append(np.concatenate([seen, np.full(count, SPURIOUS)]))
    claimed, times = (kind.claimed * range_sigma, kind.claimed * bearing_sigma), np.arange(len(poses))
    scans = Scan.from_polar(np.concatenate(ranges), np.concatenate(bearings), *claimed)
    log = Recording(
        name="simulated", source="simulated", terms="", times=0.25 * times, motions=motions,
        motion_covariances=covariances, starts=starts_of([len(rows) for rows in sources]), points=scans.points,
        covariances=scans.covariances, sources=np.concatenate(sources).astype(np.int64), reference_times=0.25 * times,
        reference_poses=poses, landmark_ids=np.arange(len(landmarks)), landmarks=landmarks, range=reach,
        field_of_view=2.0 * side,
    )  # fmt: skip
    return log.every(kind.every)


if __name__ == "__main__":
    a = options(__doc__, seed=0, associators=("jcbb", "marginal", CEILING), seeds=4, kinds=tuple(KINDS))
    rows = []
    for name, seed in product(a.kinds, range(a.seed, a.seed + (1 if a.quick else a.seeds))):
        kind = KINDS[name]
        log = simulated(kind, seed)
        log = log.part(0, 40 // kind.every) if a.quick else log
        for associator in a.associators:
            mapped = map_log(log, associator, slam_for(log), SEARCH)
            compared, measures = compare(log, mapped.poses), associations(mapped)
            error = ate(compared.estimated, compared.reference, aligned=True)
            rows.append({"associator": associator, "log": name, "seed": seed} | measures | {"ate": error})
            table("", [{name: rows[-1][name] for name in ("associator", "log", "seed", *MEASURES)}])
    groups = pd.DataFrame(rows).groupby(["associator", "log"], sort=False)
    table("Means", groups[MEASURES].mean().join(groups["duplicates"].max().rename("most")).reset_index())
