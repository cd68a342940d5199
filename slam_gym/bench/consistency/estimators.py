"""One log through three estimators, and how far each is from the truth compared with what it claims.

* standard: EKF-SLAM of the papers, with the Jacobians at the latest estimates and one pass of each update;
* right-invariant: the default of the package, iterated and with the error of the group (see `mapping.update`);
* local maps: a sequence of independent standard maps of so many features, joined when the whole is asked for.

All are judged at the same checkpoints, by the estimate that the robot had then; for local maps that is the pose in the
map joined there. Errors are those in B, without alignment: the filter claims to know where it is from where it began.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from slam_gym.association.compatibility import chi2_gate
from slam_gym.bench.records import Record
from slam_gym.bench.timing import timed
from slam_gym.geometry import relative, wrap_angle
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.metrics.association import Identities
from slam_gym.metrics.consistency import pose_nees
from slam_gym.metrics.map_quality import landmark_rmse
from slam_gym.simulation.judged import CEILING, JudgedSlam
from slam_gym.slam.duplicates import Duplicates
from slam_gym.slam.local_maps import LocalMapSlam
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import Array, Effort, IntArray, Odometry, Scan, Truth

METHODS = ("standard", "right-invariant", "local maps")
ASSOCIATORS = ("jcbb", CEILING)
_DOF = 3  # of a pose

LogStep = tuple[Odometry, Scan, Truth]


@dataclass(frozen=True, eq=False)
class DrivenLog:
    """Steps that do not depend on what is made of them, with the truth behind them."""

    world: str
    seed: int
    steps: Sequence[LogStep]  # poses in one frame; in that of the first one they are what the estimate is compared with
    landmarks: dict[int, Array]  # true place (2,) of each source, in the frame of the poses
    slam: SlamSpec
    features_per_map: int
    checkpoints: int = 20  # evenly spaced, the last at the end

    @property
    def checked(self) -> IntArray:
        """(c,) steps of the checkpoints."""
        even = np.linspace(0, len(self.steps) - 1, self.checkpoints + 1)[1:]
        return np.unique(even.round().astype(np.int64))


class Estimate(NamedTuple):
    """What an estimator made of a log."""

    record: Record
    poses: Array  # (c, 3) at each checkpoint, in B


def estimate(log: DrivenLog, method: str, associator: str) -> Estimate:
    """Run one of METHODS with one of ASSOCIATORS over a log; the record says what came of it:

    * `ANEES` of the pose, mean over checkpoints, per degree of freedom: 1 where consistent; `optimistic`: fraction of
      checkpoints at which NEES exceeds χ²_3 at 99 %; `heading σ`: the largest at a checkpoint;
    * `error`: RMS of the position over checkpoints; `final`: error of position and heading at the end;
    * `map RMSE`: of the features at the end, aligned; `duplicates`: those beyond the first of each source;
    * `seconds`: steps and joins together.
    """
    slam, judged = _judged(log, method, associator)
    base, checked = log.steps[0][2].pose, set(log.checked.tolist())
    spent, maps, truths = 0.0, [], []
    for step, (odometry, scan, truth) in enumerate(log.steps):
        spent += timed(judged.step, odometry, scan, truth).microseconds
        if step in checked:
            whole, joining = timed(_whole_map, slam)
            spent += joining
            maps.append(PoseEstimate(whole.pose, whole.pose_covariance))
            truths.append(relative(base, truth.pose))
    record = {"world": log.world, "seed": log.seed, "method": method, "associator": associator}
    record |= pose_figures(maps, truths) | map_figures(whole, judged.identities, log.landmarks)
    return Estimate({**record, "seconds": 1e-6 * spent}, np.array([pose for pose, _ in maps]))


def _judged(log: DrivenLog, method: str, associator: str) -> tuple[Slam | LocalMapSlam, JudgedSlam]:
    spec = replace(log.slam, map=_settings(log.slam.map, method))
    identities = Identities()
    find = functools.partial(true_duplicates, identities=identities) if associator == CEILING else None
    slam = LocalMapSlam(spec, log.features_per_map, find) if method == "local maps" else Slam(spec)
    return slam, JudgedSlam(slam, associator, identities=identities)


def _settings(spec: MapSpec, method: str) -> MapSpec:
    if method == "right-invariant":
        return spec
    return replace(spec, iterations=1, right_invariant=False, second_order=False)


def _whole_map(slam: Slam | LocalMapSlam) -> StochasticMap:
    return slam.joined() if isinstance(slam, LocalMapSlam) else slam.map


class PoseEstimate(NamedTuple):
    """Where an estimator has the robot."""

    pose: Array  # (3,) [m, m, rad] in B
    covariance: Array  # (3, 3)


def pose_figures(estimates: Sequence[PoseEstimate], truths: Sequence[Array]) -> Record:
    """Of estimates at checkpoints beside the true poses (3,) in B."""
    nees = np.array([pose_nees(*estimate, truth) for estimate, truth in zip(estimates, truths)])
    off = np.array([estimate.pose - truth for estimate, truth in zip(estimates, truths)])
    metres = np.hypot(off[:, 0], off[:, 1])
    return {
        "ANEES": float(nees.mean()) / _DOF,
        "optimistic": float(np.mean(nees > chi2_gate(_DOF, 0.99))),
        "error [m]": float(np.sqrt((metres**2).mean())),
        "final [m]": float(metres[-1]),
        "final [°]": abs(math.degrees(wrap_angle(float(off[-1, 2])))),
        "heading σ [°]": max(math.degrees(math.sqrt(max(estimate.covariance[2, 2], 0.0))) for estimate in estimates),
    }


def map_figures(whole: StochasticMap, identities: Identities, places: Mapping[int, Array]) -> Record:
    """Error of the oldest feature of each source that has a place (2,), and how many features are not the oldest."""
    oldest: dict[int, int] = {}
    duplicates = 0
    for row, source in enumerate(identities.source_of(whole.ids).tolist()):
        if source >= 0:
            duplicates += source in oldest
            oldest.setdefault(source, row)
    common, error = [source for source in oldest if source in places], math.nan
    if len(common) >= 2:
        positions = whole.positions[[oldest[source] for source in common]]
        error = landmark_rmse(positions, np.array([places[source] for source in common]), aligned=True)
    return {"map RMSE [m]": error, "duplicates": duplicates, "features": whole.n}


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
