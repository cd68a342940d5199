"""A corridor round a block, seen by a sensor of limited view: the loop is all that tells where the robot is."""

import math
from typing import NamedTuple

import numpy as np

from slam_gym.geometry import compose, relative
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.metrics.map_quality import ate
from slam_gym.navigation.visibility import ViewsFrom
from slam_gym.simulation.judged import JudgedSlam
from slam_gym.slam.slam import Slam
from slam_gym.types import UNPAIRED, Array, IntArray, Odometry, Scan, Truth

RADIUS, REACH, HALF_VIEW = 20.0, 10.0, 1.0  # [m, m, rad]


class Drive(NamedTuple):
    """A log with its truth."""

    steps: list[tuple[Odometry, Scan, IntArray]]  # odometry, scan, feature behind each measurement
    poses: Array  # (t, 3) in W


def ring_of_landmarks(rng: np.random.Generator, count: int = 90) -> Array:
    """(count, 2) [m] to either side of a circle."""
    around = np.linspace(0.0, 2.0 * math.pi, count, endpoint=False) + rng.normal(0.0, 0.02, count)
    out = RADIUS + rng.choice([-1.0, 1.0], count) * rng.uniform(1.5, 5.0, count)
    return np.column_stack([out * np.cos(around), out * np.sin(around)])


def drive(
    landmarks: Array, rng: np.random.Generator, steps: int = 300, drift: float = 0.014, carried_at: int | None = None
) -> Drive:
    """Round the circle at half a metre a step; at `carried_at`, a quarter of the circle is skipped unnoticed."""
    turn, pose, log, poses = 0.5 / RADIUS, np.array([RADIUS, 0.0, math.pi / 2.0]), [], []
    Q = np.diag([0.02, 0.01, drift]) ** 2
    for step in range(steps):
        if step == carried_at:
            pose = compose(np.array([0.0, 0.0, math.pi / 2.0]), pose)
        moved = np.array([0.5, 0.0, turn])
        pose = compose(pose, moved)
        odometry = Odometry(moved + rng.normal(size=3) * np.sqrt(np.diag(Q)), Q)
        log.append((odometry, *look(landmarks, pose, rng)))
        poses.append(pose)
    return Drive(log, np.array(poses))


def look(landmarks: Array, pose: Array, rng: np.random.Generator) -> tuple[Scan, IntArray]:
    """What is in view, each with probability .95."""
    at = np.array([relative(pose, np.array([*landmark, 0.0]))[:2] for landmark in landmarks])
    ahead = (np.hypot(*at.T) < REACH) & (np.abs(np.arctan2(at[:, 1], at[:, 0])) < HALF_VIEW)
    seen = np.flatnonzero(ahead & (rng.random(len(at)) < 0.95))
    return Scan.from_points(at[seen] + rng.normal(0.0, 0.05, (len(seen), 2)), sigma=0.05), seen


VIEW = ViewsFrom(2.0 * HALF_VIEW, REACH)
"""What the sensor has in view, as a robot knows that has nothing in its way."""


def enter(
    m: StochasticMap,
    graph: CovisibilityGraph,
    points: Array,
    rng: np.random.Generator,
    sigma: float,
    scans: list[IntArray] | None = None,
) -> None:
    """Enter points (k, 2) [m] in R into a map and its graph, from where the robot stands: all of them are seen three
    times, or each of the `scans` shows some."""
    features = np.full(len(points), UNPAIRED)
    for shown in scans or 3 * [np.arange(len(points))]:
        seen = Scan.from_points(points[shown] + rng.normal(0.0, sigma, (len(shown), 2)), sigma=sigma)
        m.update(seen, features[shown])
        new = np.flatnonzero(features[shown] == UNPAIRED)
        features[shown[new]] = m.add(seen, new)
        graph.add(len(new))
        graph.see_together(features[shown])
        m.end_of_step()


def map_it(slam: Slam, log: Drive, associator: str = "jcbb") -> tuple[JudgedSlam, float]:
    """The judged run, every step of which tells what went and came, and the error of the positions [m], aligned."""
    judged, estimates, alive = JudgedSlam(slam, associator), [], set()
    for (odometry, scan, sources), pose in zip(log.steps, log.poses):
        missed = slam.atlas is not None and slam.view_from is not None and slam.missed_loop
        step = judged.step(odometry, scan, Truth(pose, sources))
        assert step.prediction.near.all() or not missed
        estimates.append(slam.map.pose)
        alive |= set(step.ids[step.created].tolist()) | set(step.returned.tolist())
        alive -= set(step.removed.tolist())
        assert alive == set(slam.map.ids.tolist())
        kept, gone = slam.fused.T
        assert np.isin(gone, step.removed).all() and np.isin(kept, slam.map.ids).all() and (kept < gone).all()
    return judged, ate(np.array(estimates)[:, :2], log.poses[:, :2], aligned=True)


def duplicates(judged: JudgedSlam) -> int:
    """Confirmed features beyond the first of their source."""
    m = judged.slam.map
    sources = judged.identities.source_of(m.ids[~m.provisional])
    return len(sources) - len(np.unique(sources))
