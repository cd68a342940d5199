"""One log through three estimators, and how far each is from the truth compared with what it claims.

* standard: EKF-SLAM with the Jacobians at the latest estimates;
* first estimates: the same with Jacobians at first estimates (Huang, Mourikis and Roumeliotis, IJRR 29(5), 2010);
* local maps: a sequence of independent maps of so many features, joined when the whole is asked for.

All are judged at the same checkpoints, by the estimate that the robot had then; for local maps that is the pose in the
map joined there. Errors are those in B, without alignment: the filter claims to know where it is from where it began.
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from slam_gym.geometry import relative, wrap_angle
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.metrics.association import Identities
from slam_gym.metrics.consistency import pose_nees
from slam_gym.metrics.map_quality import landmark_rmse
from slam_gym.simulation.judged import JudgedSlam
from slam_gym.slam.duplicates import Duplicates
from slam_gym.slam.local_maps import LocalMapSlam
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import Array, Effort, IntArray, Odometry, Scan, Truth

METHODS = ("standard", "first estimates", "local maps")
ASSOCIATORS = ("jcbb", "true association")

Look = tuple[Odometry, Scan, Truth]


@dataclass(frozen=True, eq=False)
class Log:
    """Looks that do not depend on what is made of them, with the truth behind them."""

    world: str
    seed: int
    looks: Sequence[Look]  # poses in one frame; in that of the first one they are what the estimate is compared with
    landmarks: dict[int, Array]  # true place (2,) of each source, in the frame of the poses
    slam: SlamSpec
    features_per_map: int
    checkpoints: int = 20  # evenly spaced, the last at the end


@dataclass(frozen=True)
class Result:
    """What one estimator made of one log."""

    world: str
    seed: int
    method: str
    associator: str
    anees: float  # of the pose, mean over checkpoints, per degree of freedom: 1 where consistent
    optimistic: float  # share of checkpoints at which NEES exceeds χ²_3 at 99 %
    error: float  # [m] RMS of the position over checkpoints
    final: float  # [m] of the position at the end
    final_degrees: float  # of the heading at the end
    claimed: float  # [deg] largest σ of the heading at a checkpoint
    landmarks: float  # [m] RMSE of the features at the end, aligned
    duplicates: int  # features beyond the first of each source
    features: int
    seconds: float  # steps and joins together
    gps: float = math.nan  # [m] RMS distance from the GPS over checkpoints, aligned, where there is one


_CHI2_3_99 = 11.345
_DOF = 3.0


def run(log: Log, method: str, associator: str) -> tuple[Result, IntArray, Array]:
    """The result, and at each checkpoint the step (c,) and the estimated pose (c, 3) in B."""
    spec = replace(log.slam, map=replace(log.slam.map, first_estimate_jacobians=method == "first estimates"))
    base, spent, told = log.looks[0][2].pose, 0.0, associator == "true association"
    identities = Identities()
    find = functools.partial(true_duplicates, identities=identities) if told else None
    local = LocalMapSlam(spec, log.features_per_map, find) if method == "local maps" else None
    slam = local or Slam(spec)
    judged = JudgedSlam(slam, "true_association" if told else "jcbb", identities=identities)
    at = np.unique(np.linspace(0, len(log.looks) - 1, log.checkpoints + 1).round().astype(np.int64)[1:])
    checks, poses, nees, turns = set(at.tolist()), [], [], []
    for step, (odometry, scan, truth) in enumerate(log.looks):
        start = time.perf_counter()
        judged.step(odometry, scan, truth)
        spent += time.perf_counter() - start
        if step in checks:
            start = time.perf_counter()
            whole = slam.map if local is None else local.joined()
            spent += time.perf_counter() - start
            poses.append(whole.pose)
            nees.append(pose_nees(whole.pose, whole.pose_covariance, relative(base, truth.pose)))
            turns.append(math.degrees(math.sqrt(max(whole.pose_covariance[2, 2], 0.0))))
    true = np.array([relative(base, log.looks[k][2].pose) for k in at.tolist()])
    estimates = np.array(poses)
    away = np.hypot(*(estimates - true)[:, :2].T)
    rmse, duplicates = _map_quality(whole, identities, log.landmarks)
    result = Result(
        log.world,
        log.seed,
        method,
        associator,
        float(np.mean(nees)) / _DOF,
        float(np.mean(np.array(nees) > _CHI2_3_99)),
        float(np.sqrt((away**2).mean())),
        float(away[-1]),
        abs(math.degrees(wrap_angle(float(estimates[-1, 2] - true[-1, 2])))),
        max(turns),
        rmse,
        duplicates,
        whole.n,
        spent,
    )
    return result, at, estimates


def true_duplicates(m: StochasticMap, older: IntArray, newer: IntArray, *, identities: Identities) -> Duplicates:
    """What the truth knows to be the same feature, when maps are joined: the oldest of each source in either part."""
    sources = identities.source_of(m.ids)
    first: dict[int, int] = {}
    for row in older.tolist():
        first.setdefault(int(sources[row]), row)
    taken, pairs = set(), []
    for row in newer.tolist():
        source = int(sources[row])
        if source >= 0 and source in first and source not in taken:
            taken.add(source)
            pairs.append((first[source], row))
    return Duplicates(np.array(pairs, np.int64).reshape(-1, 2), 0.0, 2 * len(pairs), Effort())


def _map_quality(whole: StochasticMap, identities: Identities, places: dict[int, Array]) -> tuple[float, int]:
    """RMSE [m] of the oldest feature of each source, aligned; and how many features are not the oldest of theirs."""
    oldest: dict[int, int] = {}
    duplicates = 0
    for row, source in enumerate(identities.source_of(whole.ids).tolist()):
        if source >= 0:
            duplicates += source in oldest
            oldest.setdefault(source, row)
    common = [source for source in oldest if source in places]
    if len(common) < 2:
        return math.nan, duplicates
    positions = whole.positions[[oldest[source] for source in common]]
    return landmark_rmse(positions, np.array([places[source] for source in common]), aligned=True), duplicates
