"""EKF-SLAM over a log, from its first step to its last."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from agents.evaluation.associators import CEILING, find_associator
from agents.evaluation.drives import Metered
from slam_gym.geometry import compose, inverse
from slam_gym.metrics.association import Tally
from slam_gym.recordings.recording import Recording, interpolate
from slam_gym.simulation.judged import JudgedSlam
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import NONE, Array, BoolArray, IntArray, Truth


@dataclass(frozen=True)
class Run:
    """What became of a log of T steps and M measurements; n features in the end. In B, the frame of the map."""

    poses: Array  # (T, 3) [m, m, rad]
    pose_covariances: Array  # (T, 3, 3) [m², m·rad, rad²]
    ids: IntArray  # (M,) id of the feature that each measurement updated or started, NONE = neither
    created: BoolArray  # (M,) it started it
    behind: IntArray  # (M,) identity of that feature: the source of what started it; NONE where there is no feature
    tally: Tally  # of the decisions
    features: IntArray  # (n,) ids, oldest first
    identities: IntArray  # (n,)
    confirmed: BoolArray  # (n,)
    seen: IntArray  # (n,) [steps]
    positions: Array  # (n, 2) [m]
    covariances: Array  # (n, 2, 2) [m²]
    sizes: Array  # (n,) [m], NaN where unknown
    surveyed: bool  # B is the frame W of the reference: the run began where the reference does, heading and all
    step_seconds: Array  # (T,) of the whole step
    nodes: IntArray  # (T,) of the interpretation tree; (0,) where nothing searched
    associator_seconds: Array  # likewise
    limits: int  # searches that met their limit


def run(log: Recording, associator: str, spec: SlamSpec) -> Run:
    """Map a log with the associator of that name (`find_associator`).

    `true_association` is told the identities, and so is its map: every labelled feature goes in when it is first seen,
    and nothing else. It is what is left of the error once no association is wrong. Raises as `Slam.step`.
    """
    truth = associator == CEILING
    meter = None if truth else Metered(find_associator(associator))
    # nothing that the labels add needs to be confirmed
    slam = Slam(replace(spec, map=replace(spec.map, confirmations=1)) if truth else spec)
    start = start_of(log)
    if start is not None:
        slam.map.place(start, np.zeros((3, 3)))
    judged = JudgedSlam(slam, meter or associator, informed=truth)
    judge = judged.identities
    steps: list[tuple[Any, ...]] = []
    for odometry, scan, sources in log.steps():
        began = time.perf_counter()
        step = judged.step(odometry, scan, Truth(np.full(3, np.nan), sources))
        seconds = time.perf_counter() - began
        steps.append((slam.map.pose, slam.map.pose_covariance, step.ids, step.created, seconds))
    poses, covariances, ids, created, taken = zip(*steps)
    every_id = np.concatenate(ids)
    behind = np.where(every_id == NONE, NONE, judge.source_of(np.maximum(every_id, 0)))
    return Run(
        np.array(poses), np.array(covariances), every_id, np.concatenate(created), behind, judge.total,
        slam.map.ids, judge.source_of(slam.map.ids), ~slam.map.provisional, slam.map.seen, slam.map.positions,
        slam.map.covariances, slam.map.sizes, start is not None, np.array(taken),
        np.array(meter.nodes if meter else [], np.int64), np.array(meter.seconds if meter else []),
        meter.limits if meter else 0,
    )  # fmt: skip


def start_of(log: Recording) -> Array | None:
    """Pose (3,) in W from which the first motion starts, or None where the reference does not say."""
    if not len(log.reference_times) or not log.reference_times[0] <= log.times[0] <= log.reference_times[-1]:
        return None
    first = interpolate(log.reference_times, log.reference_poses, log.times[:1])[0]
    return compose(first, inverse(log.motions[0])) if np.isfinite(first[2]) else None
