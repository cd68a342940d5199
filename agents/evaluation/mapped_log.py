"""EKF-SLAM over a log: the run from its first step to its last, what is measured of it, and the files that it leaves.

LOG.reference.tum           poses of the reference, where it has headings
LOG.ASSOCIATOR.tum          poses of the robot, in the frame of its map
LOG.ASSOCIATOR.map.csv      features of the map, in the same frame, and moved rigidly onto the reference
LOG.ASSOCIATOR.errors.csv   the positions, moved likewise, against the reference
LOG.landmarks.csv           the true landmarks, where they are known
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from agents.evaluation.associators import Metered, metered
from agents.evaluation.records import Record, stem, written_whole
from slam_gym.association.prediction import Associator
from slam_gym.geometry import compose, inverse, transform
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.metrics.association import Identities
from slam_gym.metrics.consistency import anees, pose_nees
from slam_gym.metrics.map_quality import align_se2, ate, landmark_rmse
from slam_gym.recordings.recording import Recording, interpolate, write_tum
from slam_gym.simulation.judged import CEILING, JudgedSlam
from slam_gym.slam.atlas import AtlasSpec
from slam_gym.slam.relocate import relocate_by
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import NO_ID, SPURIOUS, UNPAIRED, Array, BoolArray, IntArray, Truth

MAX_GAP = 1.0  # [s] between samples, over which poses are not interpolated
REFERENCE_SIGMA = (0.005, 0.005, math.radians(0.5))  # [m, m, rad] of reference poses


@dataclass(frozen=True)
class MappedLog:
    """What became of a log of T steps and M measurements, in B, the frame of the map."""

    log: Recording
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

    @cached_property
    def compared(self) -> Comparison:
        """Poses against the reference, at the instants that both know: whichever has more samples while the log lasts
        is interpolated at the other's."""
        log, t, reference = self.log, self.log.reference_times, self.log.reference_poses
        if len(t) == 0:
            return Comparison(np.empty(0), np.empty((0, 3)), np.empty((0, 3)))
        during = (t >= log.times[0]) & (t <= log.times[-1])
        if during.sum() <= len(log):
            rows = during & _close(log.times, t)
            return Comparison(t[rows], interpolate(log.times, self.poses, t[rows]), reference[rows])
        rows = _close(t, log.times)
        return Comparison(log.times[rows], self.poses[rows], interpolate(t, reference, log.times[rows]))


class Comparison(NamedTuple):
    """Poses of the map and of the reference at the same instants."""

    times: Array  # (k,) [s]
    estimated: Array  # (k, 3) [m, m, rad] in B
    reference: Array  # (k, 3) [m, m, rad] in W

    @property
    def alignment(self) -> Array:
        """(3,) the pose that moves the estimate rigidly onto the reference."""
        return align_se2(self.estimated[:, :2], self.reference[:, :2])

    @property
    def aligned(self) -> Array:
        """(k, 2) [m] estimated positions, moved onto the reference."""
        return transform(self.alignment, np.ascontiguousarray(self.estimated[:, :2]))

    @property
    def errors(self) -> Array:
        """(k,) [m] distance of the aligned estimate from the reference."""
        return np.hypot(*(self.aligned - self.reference[:, :2]).T)


def _close(times: Array, at: Array) -> BoolArray:
    """Which instants (k,) lie between two of `times` that are no more than MAX_GAP apart."""
    inside = (at >= times[0]) & (at <= times[-1])
    after = np.clip(np.searchsorted(times, at, side="left"), 0, len(times) - 1)
    before = np.where(times[after] == at, after, np.maximum(after - 1, 0))
    close: BoolArray = inside & (times[after] - times[before] <= MAX_GAP)
    return close


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
        log, np.array(poses), np.array(covariances), np.array(seconds), np.concatenate(ids), np.concatenate(created),
        slam.map, judged.identities, meter, start is not None,
    )  # fmt: skip


def start_of(log: Recording) -> Array | None:
    """Pose (3,) in W from which the first motion starts, or None where the reference does not say."""
    if not len(log.reference_times) or not log.reference_times[0] <= log.times[0] <= log.reference_times[-1]:
        return None
    first = interpolate(log.reference_times, log.reference_poses, log.times[:1])[0]
    return compose(first, inverse(log.motions[0])) if np.isfinite(first[2]) else None


# -- what is measured ------------------------------------------------------------------------------------------------


def measure(mapped: MappedLog) -> Record:
    """The numbers of a mapped log."""
    log = mapped.log
    about = {"steps": len(log), "measurements": len(log.points)}
    return about | _associations(mapped) | _features(mapped) | _poses(mapped) | _landmarks(mapped) | _effort(mapped)


def _associations(mapped: MappedLog) -> Record:
    """Over the measurements with an identity; what became of the spurious ones goes by itself."""
    tally = mapped.identities.total
    paired = tally.tp + tally.fp_wrong + tally.fp_duplicate
    spurious = mapped.log.sources == SPURIOUS
    accepted = spurious & (mapped.ids != NO_ID) & ~mapped.created
    return {
        "precision": _ratio(tally.tp, paired),
        "recall": tally.recall,
        "f1": _ratio(2 * tally.tp, paired + tally.in_map),
        "wrong": tally.fp_wrong,
        "clutter": int(spurious.sum()),
        "clutter_accepted": int(accepted.sum()),
        "clutter_share": _ratio(int(accepted.sum()), int(spurious.sum())),
        "clutter_on_landmarks": int((accepted & (mapped.sources_of_pairings >= 0)).sum()),
    }


def _features(mapped: MappedLog) -> Record:
    """Of the confirmed features, by the identity of what started them."""
    sources = mapped.sources[mapped.confirmed]
    real = sources[sources >= 0]
    found = len(np.unique(real))
    return {
        "features": len(sources),
        "true_features": len(np.unique(mapped.log.sources[mapped.log.sources >= 0])),
        "found": found,
        "duplicates": len(real) - found,
        "clutter_features": int((sources == SPURIOUS).sum()),
        "unlabelled_features": int((sources < SPURIOUS).sum()),
    }


def _poses(mapped: MappedLog) -> Record:
    compared = mapped.compared
    known = mapped.in_world and len(compared.times) > 0
    return {
        "ate": ate(compared.estimated, compared.reference, aligned=True),
        "ate_median": float(np.median(compared.errors)) if len(compared.times) else math.nan,
        "ate_unaligned": ate(compared.estimated, compared.reference) if known else math.nan,
        "anees": _anees(mapped) if known else math.nan,
    }


def _anees(mapped: MappedLog) -> float:
    """Of the poses, at the steps for which there is a reference; its own uncertainty counts too."""
    log = mapped.log
    known = _close(log.reference_times, log.times)
    true = interpolate(log.reference_times, log.reference_poses, log.times[known])
    covariances = mapped.pose_covariances[known] + np.diag(np.square(REFERENCE_SIGMA))
    triples = zip(mapped.poses[known], covariances, true)
    return anees(np.array([pose_nees(pose, covariance, at) for pose, covariance, at in triples]), 3)


def _landmarks(mapped: MappedLog) -> Record:
    """Of the landmarks whose place is known; of duplicates, the oldest is the one."""
    log = mapped.log
    place = {identity: k for k, identity in enumerate(log.landmark_ids.tolist())}
    rows: dict[int, int] = {}
    for row in np.flatnonzero(mapped.confirmed).tolist():
        if (identity := int(mapped.sources[row])) in place:
            rows.setdefault(identity, row)
    estimated = mapped.map.positions[list(rows.values())]
    true = log.landmarks[[place[identity] for identity in rows]]
    return {
        "landmark_rmse": landmark_rmse(estimated, true, aligned=True),
        "landmark_rmse_unaligned": landmark_rmse(estimated, true) if mapped.in_world else math.nan,
        "landmarks_compared": len(rows),
    }


def _effort(mapped: MappedLog) -> Record:
    searched = mapped.meter.effort()
    return {
        "seconds": float(mapped.step_seconds.sum()),
        "step_microseconds": 1e6 * float(np.median(mapped.step_seconds)),
        "microseconds": searched["microseconds"],
        "nodes": searched["nodes"],
        "limits": mapped.meter.limits,
    }


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else math.nan


# -- files -----------------------------------------------------------------------------------------------------------


def write_mapped_log(folder: Path, associator: str, mapped: MappedLog) -> None:
    """All files of a log mapped with an associator."""
    log = mapped.log
    folder.mkdir(parents=True, exist_ok=True)
    known = np.isfinite(log.reference_poses[:, 2])
    if known.any():
        write_tum(folder / f"{stem(log.name)}.reference.tum", log.reference_times[known], log.reference_poses[known])
    _write(folder / f"{stem(log.name)}.landmarks.csv", {"x": log.landmarks[:, 0], "y": log.landmarks[:, 1]})
    base = stem(log.name, associator)
    write_tum(folder / f"{base}.tum", log.times, mapped.poses)
    compared, m = mapped.compared, mapped.map
    variances = m.covariances.reshape(-1, 4)
    at, aligned_at = m.positions, transform(compared.alignment, m.positions)
    features = {
        "id": m.ids, "identity": mapped.sources, "confirmed": mapped.confirmed.astype(int), "seen": m.seen,
        "x": at[:, 0], "y": at[:, 1], "aligned_x": aligned_at[:, 0], "aligned_y": aligned_at[:, 1],
        "variance_x": variances[:, 0], "covariance_xy": variances[:, 1], "variance_y": variances[:, 3],
        "size": m.sizes,
    }  # fmt: skip
    _write(folder / f"{base}.map.csv", features)
    aligned, reference = compared.aligned, compared.reference
    errors = {
        "time": compared.times, "x": aligned[:, 0], "y": aligned[:, 1], "reference_x": reference[:, 0],
        "reference_y": reference[:, 1], "error": compared.errors,
    }  # fmt: skip
    _write(folder / f"{base}.errors.csv", errors)


def _write(path: Path, columns: dict[str, Array]) -> None:
    with written_whole(path) as partial:
        pd.DataFrame(columns).to_csv(partial, index=False, float_format="%.9g")
