"""EKF-SLAM over a log, from its first step to its last."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from agents.evaluation.associators import CEILING, gated
from agents.evaluation.drives import Metered
from slam_gym.association import true_association
from slam_gym.geometry import compose, inverse
from slam_gym.metrics.association import Identities, Tally
from slam_gym.recordings.recording import Recording, interpolate
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import NONE, Array, BoolArray, Hypothesis, IntArray, Prediction, Scan, Truth


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


class _Informed(Slam):
    """SLAM that knows the identities: it adds what its map has not got, whatever that is compatible with."""

    sources: IntArray  # (m,) behind the measurements of the step
    identities: IntArray  # (n,) behind the features of the map

    def new_features(self, scan: Scan, prediction: Prediction, hypothesis: Hypothesis) -> IntArray:
        in_map = np.isin(self.sources, self.identities)
        fresh = np.flatnonzero((self.sources >= 0) & ~in_map)
        first = np.unique(self.sources[fresh], return_index=True)[1]
        new: IntArray = fresh[np.sort(first)]
        return new


def run(log: Recording, associator: str, spec: SlamSpec) -> Run:
    """Map a log with the associator of that name (`association_evaluation.gated`).

    `true_association` is told the identities, and so is its map: every labelled feature goes in when it is first seen,
    and nothing else. It is what is left of the error once no association is wrong. Raises as `Slam.step`.
    """
    truth = associator == CEILING
    meter = None if truth else Metered(gated(associator, spec.map.confidence))
    slam = _informed(spec) if meter is None else Slam(spec, meter)
    start = start_of(log)
    if start is not None:
        slam.map.place(start, np.zeros((3, 3)))
    judge = Identities()
    steps: list[tuple[Any, ...]] = []
    for odometry, scan, sources in log.steps():
        began = time.perf_counter()
        step = slam.step(odometry, scan, _told(slam, sources, judge))
        seconds = time.perf_counter() - began
        judge.update(step, Truth(slam.map.pose, sources))
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


def _informed(spec: SlamSpec) -> Slam:
    """Nothing that it adds needs to be confirmed."""
    return _Informed(replace(spec, map=replace(spec.map, confirmations=1)), true_association)


def _told(slam: Slam, sources: IntArray, judge: Identities) -> Callable[..., Hypothesis] | None:
    if not isinstance(slam, _Informed):
        return None
    slam.sources, slam.identities = sources, judge.source_of(slam.map.ids)
    return functools.partial(true_association, sources=sources, identities=slam.identities)


def start_of(log: Recording) -> Array | None:
    """Pose (3,) in W from which the first motion starts, or None where the reference does not say."""
    if not len(log.reference_times) or not log.reference_times[0] <= log.times[0] <= log.reference_times[-1]:
        return None
    first = interpolate(log.reference_times, log.reference_poses, log.times[:1])[0]
    return compose(first, inverse(log.motions[0])) if np.isfinite(first[2]) else None
