"""Reference experiment: a robot loops once through a square corridor and comes back with a drifted heading.

The world, the robot and its sensor are those of `slam_gym.world.corridor`, driven directly on the SLAM core. `q` scales
the *covariance* that the filter is told; the noise drawn is always the same.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

from slam_gym.mapping.stochastic_map import MapSpec
from slam_gym.metrics.association import Tally
from slam_gym.metrics.consistency import pose_nees
from slam_gym.simulation.judged import JudgedSlam
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import Array, IntArray
from slam_gym.world.corridor import RANGE, walk_round

__all__ = ["run", "summary"]

ASSOCIATORS = ("nearest_neighbour", "singles", "jcbb", "true_association")

BANDS = {
    "nearest_neighbour": "features ≥ 103, FP ≥ 10 × JCBB's",
    "singles": "precise, few pairings",
    "jcbb": "precision ≥ .985, features 88–91",
    "true_association": "features 88, ANEES .9–1.2",
}


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
    spec = SlamSpec(MapSpec(confidence=confidence), reach=RANGE, locality=locality)
    slam = Slam(spec)
    judged = JudgedSlam(slam, associator)
    poses, estimates = [], []
    for step, (odometry, scan, truth) in enumerate(walk_round(rng, q)):
        judged.step(odometry, scan, truth)
        poses.append(truth.pose)
        estimates.append(slam.map.pose)
        if step == 0:
            nees = [0.0]
        else:
            nees.append(pose_nees(slam.map.pose, slam.map.pose_covariance, truth.pose))
    errors = np.array(estimates) - np.array(poses)
    errors[:, 2] = np.arctan2(np.sin(errors[:, 2]), np.cos(errors[:, 2]))
    return Run(slam, judged.tally, errors, np.array(nees), np.array(poses), np.array(estimates))


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
