"""EKF-SLAM over a log, from its first step to its last."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from agents.evaluation.associators import Metered, metered
from slam_gym.geometry import compose, inverse
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.metrics.association import Identities
from slam_gym.recordings.recording import Recording, interpolate
from slam_gym.simulation.judged import CEILING, JudgedSlam
from slam_gym.slam.atlas import AtlasSpec
from slam_gym.slam.relocate import relocate_by
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import NO_ID, UNPAIRED, Array, Associator, BoolArray, IntArray, Truth


@dataclass(frozen=True)
class MappedLog:
    """What became of a log of T steps and M measurements, in B, the frame of the map."""

    poses: Array  # (T, 3) [m, m, rad]
    pose_covariances: Array  # (T, 3, 3) [m², m·rad, rad²]
    step_seconds: Array  # (T,) of the whole step
    ids: IntArray  # (M,) id of the feature that each measurement updated or started, NO_ID = neither
    created: BoolArray  # (M,) it started it
    map: StochasticMap  # in the end, with n features
    identities: Identities  # what its features are
    meter: Metered  # on the associator
    in_world: bool  # B is the frame W of the reference: the log began where the reference does, heading and all

    @property
    def confirmed(self) -> BoolArray:
        """(n,) features that have been seen often enough."""
        return ~self.map.provisional

    @property
    def sources(self) -> IntArray:
        """(n,) identity of each feature: that of the measurement which started it."""
        return self.identities.source_of(self.map.ids)

    @property
    def sources_of_pairings(self) -> IntArray:
        """(M,) identity of the feature that each measurement updated or started, UNPAIRED where it did neither."""
        return np.where(self.ids == NO_ID, UNPAIRED, self.identities.source_of(np.maximum(self.ids, 0)))


def map_log(log: Recording, associator: str | Associator, spec: SlamSpec, relocation: str | None = None) -> MappedLog:
    """Map a log with an associator, by name or itself, and find the robot by that search where it is lost.

    `true_association` is told the identities, and so is its map: every labelled feature goes in when it is first seen,
    without having to be confirmed, and nothing else does. It is what is left of the error once no association is
    wrong, and never lost. Raises as `Slam.step`, and ValueError for a search that nobody knows.
    """
    informed = associator == CEILING
    if informed:
        spec = replace(spec, map=replace(spec.map, confirmations=1))
    slam = Slam(spec)
    if relocation is not None and not informed:
        slam = Slam(spec, relocate=relocate_by(relocation), atlas=AtlasSpec())
    if (start := start_of(log)) is not None:
        slam.map.place(start, np.zeros((3, 3)))
    meter, associate = metered(associator)
    judged = JudgedSlam(slam, associate, informed=informed)
    poses, covariances, seconds, ids, created = [], [], [], [], []
    for odometry, scan, sources in log.steps():
        began = time.perf_counter()
        step = judged.step(odometry, scan, Truth(slam.map.pose, sources))
        seconds.append(time.perf_counter() - began)
        poses.append(slam.map.pose)
        covariances.append(slam.map.pose_covariance)
        ids.append(step.ids)
        created.append(step.created)
    return MappedLog(
        np.array(poses), np.array(covariances), np.array(seconds), np.concatenate(ids), np.concatenate(created),
        slam.map, judged.identities, meter, start is not None,
    )  # fmt: skip


def start_of(log: Recording) -> Array | None:
    """Pose (3,) in W from which the first motion starts, or None where the reference does not say."""
    if not len(log.reference_times) or not log.reference_times[0] <= log.times[0] <= log.reference_times[-1]:
        return None
    first = interpolate(log.reference_times, log.reference_poses, log.times[:1])[0]
    return compose(first, inverse(log.motions[0])) if np.isfinite(first[2]) else None
