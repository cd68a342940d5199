"""Reference experiment: a robot loops once through a square corridor and comes back with a drifted heading.

The simulator of Neira and Tardós' teaching material, re-created and driven directly on the SLAM core. Spelt out, since
the figures depend on it: the square has sides of 10 m; each side carries 22 point features; the robot makes 44 steps
of 1 m from (0, 0) along +x, turning left by 90° at the end of steps 10, 20, 30 and 40, so that the last four repeat the
first side. It scans at step 0 and after every step. `q` scales the *covariance* that the filter is told; the noise
drawn is always the one below. All features in range and field of view are measured, without clutter.
"""

from __future__ import annotations

import argparse
import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from slam_gym.association import jcbb, nearest_neighbour, singles, true_association
from slam_gym.geometry import compose, observe
from slam_gym.mapping.stochastic_map import MapSpec
from slam_gym.metrics.association import Identities, Tally
from slam_gym.metrics.consistency import pose_nees
from slam_gym.slam import Slam, SlamSpec
from slam_gym.types import Array, Hypothesis, IntArray, Odometry, Scan, Truth

SIDE = 10.0  # [m]
STEPS = 44
RANGE = 5.0  # [m]
RANGE_SIGMA = 0.01  # of the range
BEARING_SIGMA = math.radians(0.125)
STRAIGHT_SIGMA = (0.01, 0.01, math.radians(2.0))  # [m, m, rad] of a step
TURN_SIGMA = (0.03, 0.03, math.radians(2.5))

ASSOCIATORS: dict[str, Callable[..., Hypothesis] | None] = {
    "nearest_neighbour": nearest_neighbour,
    "singles": singles,
    "jcbb": jcbb,
    "true_association": None,  # needs the truth of each scan
}

BANDS = {
    "nearest_neighbour": "features ≥ 103, FP ≥ 10 × JCBB's",
    "singles": "precise, few pairings",
    "jcbb": "precision ≥ .985, features 88–91",
    "true_association": "features 88, ANEES .9–1.2",
}


def features() -> Array:
    """The 88 point features of the corridor, (88, 2) [m]."""
    even, odd = np.arange(0.0, 11.0, 2.0), np.arange(1.0, 10.0, 2.0)
    side = np.concatenate([np.column_stack([x, np.full(len(x), y)]) for y, x in _walls(even, odd)])
    corners = np.array([[0.0, 0.0, 0.0], [SIDE, 0.0, 90.0], [SIDE, SIDE, 180.0], [0.0, SIDE, 270.0]])
    turned = []
    for x, y, degrees in corners:
        c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        turned.append(side @ np.array([[c, s], [-s, c]]) + (x, y))
    return np.concatenate(turned)


def _walls(even: Array, odd: Array) -> list[tuple[float, Array]]:
    return [(-0.6, even), (-0.35, even), (0.35, odd), (0.6, odd)]


@dataclass(frozen=True)
class Run:
    """What one run of the corridor came to."""

    slam: Slam
    tally: Tally
    pose_errors: Array  # (45, 3) [m, m, rad] estimate minus truth
    nees: Array  # (45,) pose NEES over 3 degrees of freedom; the first, of a pose known exactly, is 0
    poses: Array  # (45, 3) true poses
    estimates: Array  # (45, 3)


def run(associator: str, seed: int, q: float = 1.0, confidence: float = 0.99, locality: bool = True) -> Run:
    """One loop through the corridor with one of `ASSOCIATORS`."""
    rng = np.random.default_rng(seed)
    world = features()
    spec = SlamSpec(MapSpec(confidence=confidence), reach=RANGE, locality=locality)
    chosen = ASSOCIATORS[associator]
    slam = Slam(spec, functools.partial(chosen, confidence=confidence) if chosen else nearest_neighbour)
    identities, tally, pose = Identities(), Tally(), np.zeros(3)
    poses, estimates = [], []
    for step in range(STEPS + 1):
        pose, odometry = _move(step, pose, q, rng)
        scan, truth = _scan(world, pose, rng)
        associate = None
        if chosen is None:
            known = identities.source_of(slam.map.ids)
            associate = functools.partial(true_association, sources=truth.sources, identities=known)
        tally += identities.update(slam.step(odometry, scan, associate), truth)
        poses.append(pose)
        estimates.append(slam.map.pose)
        if step == 0:
            nees = [0.0]
        else:
            nees.append(pose_nees(slam.map.pose, slam.map.pose_covariance, pose))
    errors = np.array(estimates) - np.array(poses)
    errors[:, 2] = np.arctan2(np.sin(errors[:, 2]), np.cos(errors[:, 2]))
    return Run(slam, tally, errors, np.array(nees), np.array(poses), np.array(estimates))


def _move(step: int, pose: Array, q: float, rng: np.random.Generator) -> tuple[Array, Odometry]:
    """True pose after `step`, and the odometry that tells of it. Step 0 stands still and knows it."""
    if step == 0:
        return pose, Odometry(np.zeros(3), np.zeros((3, 3)))
    turning = step % int(SIDE) == 0
    sigma = np.array(TURN_SIGMA if turning else STRAIGHT_SIGMA)
    intended = np.array([1.0, 0.0, math.pi / 2 if turning else 0.0])
    measured = intended + sigma * rng.standard_normal(3)
    return compose(pose, intended), Odometry(measured, q * np.diag(sigma**2))


def _scan(world: Array, pose: Array, rng: np.random.Generator) -> tuple[Scan, Truth]:
    """Range and bearing of what is within 5 m and ±90°, handed on in Cartesian form."""
    local = observe(pose, world)
    seen = np.flatnonzero((np.hypot(local[:, 0], local[:, 1]) <= RANGE) & (local[:, 0] >= 0.0))
    ranges = np.hypot(local[seen, 0], local[seen, 1])
    bearings = np.arctan2(local[seen, 1], local[seen, 0])
    order = np.argsort(bearings)
    seen, ranges, bearings = seen[order], ranges[order], bearings[order]
    measured = ranges + RANGE_SIGMA * ranges * rng.standard_normal(len(seen))
    angles = bearings + BEARING_SIGMA * rng.standard_normal(len(seen))
    return polar_scan(measured, angles, RANGE_SIGMA * measured, np.full(len(seen), BEARING_SIGMA)), Truth(pose, seen)


def polar_scan(ranges: Array, bearings: Array, range_sigmas: Array, bearing_sigmas: Array) -> Scan:
    """A scan (sizes unknown) from polar measurements, all (m,) [m, rad]: Σ = J diag(σ_ρ², σ_φ²) Jᵀ."""
    c, s = np.cos(bearings), np.sin(bearings)
    jacobian = np.empty((len(ranges), 2, 2))
    jacobian[:, 0, 0], jacobian[:, 0, 1] = c, -ranges * s
    jacobian[:, 1, 0], jacobian[:, 1, 1] = s, ranges * c
    noise = np.zeros_like(jacobian)
    noise[:, 0, 0], noise[:, 1, 1] = range_sigmas**2, bearing_sigmas**2
    covariances = jacobian @ noise @ jacobian.transpose(0, 2, 1)
    covariances = 0.5 * (covariances + covariances.transpose(0, 2, 1))
    unknown = np.full(len(ranges), np.nan)
    return Scan(np.column_stack([ranges * c, ranges * s]), covariances, unknown, unknown)


def summary(associator: str, seeds: IntArray, q: float, confidence: float) -> dict[str, float]:
    """Means over the seeds, and the median over seeds of the run's ANEES."""
    runs = [run(associator, int(seed), q, confidence) for seed in seeds]
    total = sum((r.tally for r in runs), Tally())
    return {
        "features": float(np.mean([r.slam.map.n for r in runs])),
        "TP": total.tp / len(runs),
        "FP": total.fp / len(runs),
        "FN": total.fn / len(runs),
        "precision": total.precision,
        "ANEES": float(np.median([r.nees[1:].mean() / 3.0 for r in runs])),
    }


def main(argv: list[str] | None = None) -> None:
    """Print the table of the reference experiment."""
    parser = argparse.ArgumentParser(prog="python -m slam_gym.bench corridor", description=__doc__)
    parser.add_argument("--seeds", type=int, default=40, help="runs per row, seeds 0 … N−1 (default 40)")
    arguments = parser.parse_args(argv)
    seeds = np.arange(arguments.seeds)
    print("  Q  conf associator         features     TP     FP     FN   prec   ANEES   expected")
    for q, confidence in ((1.0, 0.95), (1.0, 0.99), (2.0, 0.99)):
        for associator in ASSOCIATORS:
            row = summary(associator, seeds, q, confidence)
            print(
                f"{q:2.0f}x {confidence:5.2f} {associator:18s} {row['features']:8.1f} {row['TP']:6.1f} "
                f"{row['FP']:6.2f} {row['FN']:6.1f} {row['precision']:6.3f} {row['ANEES']:7.2f}   "
                f"{BANDS[associator] if confidence == 0.99 else ''}"
            )
