"""The reference experiment: a robot drives once round a square corridor and returns with a drifted heading.

World, robot and sensor are those of `slam_gym.world.corridor`, with the SLAM core and the filter of the papers: one
iteration, a standard error state, first-order predictions. `Q` scales the *covariance* of the odometry as the filter
knows it; the noise is always the same.

    python benchmarks/corridor.py        # 40 seeds, half a minute
"""

import numpy as np

from benchmarks.common import Record, options, table
from slam_gym import MapSpec, Slam, SlamSpec
from slam_gym.metrics.association import Tally
from slam_gym.metrics.consistency import pose_nees
from slam_gym.simulation.judged import JudgedSlam
from slam_gym.types import Array
from slam_gym.world.corridor import RANGE, walk_round

ASSOCIATORS = ("nearest_neighbour", "singles", "jcbb", "true_association")
SETTINGS = ((1.0, 0.95), (1.0, 0.99), (2.0, 0.99))  # Q, confidence of the gates


def run_corridor(
    associator: str, seed: int, q: float = 1.0, confidence: float = 0.99, locality: bool = True
) -> tuple[JudgedSlam, Array]:
    """One loop through the corridor, and the NEES (44,) of the poses after the first, over 3 degrees of freedom."""
    spec = MapSpec(confidence=confidence, iterations=1, right_invariant=False, second_order=False)
    slam = Slam(SlamSpec(spec, reach=RANGE, locality=locality))
    judged = JudgedSlam(slam, associator)
    poses = []
    for odometry, scan, truth in walk_round(np.random.default_rng(seed), q):
        judged.step(odometry, scan, truth)
        poses.append((slam.map.pose, slam.map.pose_covariance, truth.pose))
    return judged, np.array([pose_nees(*pose) for pose in poses[1:]])


def summary(associator: str, seeds: int, q: float, confidence: float) -> Record:
    """Means over the seeds, and the median over seeds of the run's ANEES."""
    runs, nees = zip(*(run_corridor(associator, seed, q, confidence) for seed in range(seeds)))
    total = sum((run.tally for run in runs), Tally())
    row: Record = {"Q": q, "confidence": confidence, "associator": associator}
    row |= {"features": float(np.mean([run.slam.map.n for run in runs]))}
    row |= {"TP": total.tp / seeds, "FP": total.fp / seeds, "FN": total.fn / seeds, "precision": total.precision}
    return row | {"ANEES": float(np.median([values.mean() / 3.0 for values in nees]))}


if __name__ == "__main__":
    a = options(__doc__, seeds=40)
    seeds = 2 if a.quick else a.seeds
    rows = [summary(name, seeds, q, confidence) for q, confidence in SETTINGS for name in ASSOCIATORS]
    table(f"The corridor; means over {seeds} seeds", rows)
