"""What is measured of a mapped log: associations by the identities, poses and features by the reference."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from agents.evaluation.mapped_log import MappedLog
from agents.evaluation.records import Record
from slam_gym.geometry import transform
from slam_gym.metrics.consistency import anees, pose_nees
from slam_gym.metrics.map_quality import align_se2, landmark_rmse
from slam_gym.metrics.trajectory import ate
from slam_gym.recordings.recording import Recording, interpolate
from slam_gym.types import NO_ID, SPURIOUS, Array, BoolArray

MAX_GAP = 1.0  # [s] between samples, over which poses are not interpolated
REFERENCE_SIGMA = (0.005, 0.005, math.radians(0.5))  # [m, m, rad] of reference poses


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


def compare(log: Recording, mapped: MappedLog) -> Comparison:
    """At the instants that both know: whichever has more samples while the log lasts is interpolated at the other's."""
    t, reference = log.reference_times, log.reference_poses
    if len(t) == 0:
        return Comparison(np.empty(0), np.empty((0, 3)), np.empty((0, 3)))
    during = (t >= log.times[0]) & (t <= log.times[-1])
    if during.sum() <= len(log):
        rows = during & _close(log.times, t)
        return Comparison(t[rows], interpolate(log.times, mapped.poses, t[rows]), reference[rows])
    rows = _close(t, log.times)
    return Comparison(log.times[rows], mapped.poses[rows], interpolate(t, reference, log.times[rows]))


def _close(times: Array, at: Array) -> BoolArray:
    """Which instants (k,) lie between two of `times` that are no more than MAX_GAP apart."""
    after = np.searchsorted(times, at, side="left")
    inside = (at >= times[0]) & (at <= times[-1])
    after = np.clip(after, 0, len(times) - 1)
    before = np.where(times[after] == at, after, np.maximum(after - 1, 0))
    close: BoolArray = inside & (times[after] - times[before] <= MAX_GAP)
    return close


def measure(log: Recording, mapped: MappedLog) -> Record:
    """The numbers of a mapped log."""
    return {
        "steps": len(log), "measurements": len(log.points), **_associations(log, mapped), **_features(log, mapped),
        **_poses(log, mapped), **_landmarks(log, mapped), **_effort(mapped),
    }  # fmt: skip


def _associations(log: Recording, mapped: MappedLog) -> Record:
    """Over the measurements with an identity; what became of the spurious ones goes by itself."""
    tally = mapped.identities.total
    paired = tally.tp + tally.fp_wrong + tally.fp_duplicate
    spurious = log.sources == SPURIOUS
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


def _features(log: Recording, mapped: MappedLog) -> Record:
    """Of the confirmed features, by the identity of what started them."""
    sources = mapped.sources[mapped.confirmed]
    real = sources[sources >= 0]
    return {
        "features": len(sources),
        "true_features": len(np.unique(log.sources[log.sources >= 0])),
        "found": len(np.unique(real)),
        "duplicates": len(real) - len(np.unique(real)),
        "clutter_features": int((sources == SPURIOUS).sum()),
        "unlabelled_features": int((sources < SPURIOUS).sum()),
    }


def _poses(log: Recording, mapped: MappedLog) -> Record:
    compared = compare(log, mapped)
    known = mapped.in_world and len(compared.times) > 0
    return {
        "ate": ate(compared.estimated, compared.reference, aligned=True),
        "ate_median": float(np.median(compared.errors)) if len(compared.times) else math.nan,
        "ate_unaligned": ate(compared.estimated, compared.reference) if known else math.nan,
        "anees": _anees(log, mapped) if known else math.nan,
        **dict(zip(("align_x", "align_y", "align_heading"), compared.alignment.tolist())),
    }


def _anees(log: Recording, mapped: MappedLog) -> float:
    """Of the poses, at the steps for which there is a reference; its own uncertainty counts too."""
    known = _close(log.reference_times, log.times)
    true = interpolate(log.reference_times, log.reference_poses, log.times[known])
    covariances = mapped.pose_covariances[known] + np.diag(np.square(REFERENCE_SIGMA))
    triples = zip(mapped.poses[known], covariances, true)
    return anees(np.array([pose_nees(pose, covariance, at) for pose, covariance, at in triples]), 3)


def _landmarks(log: Recording, mapped: MappedLog) -> Record:
    """Of the landmarks whose place is known; of duplicates, the oldest is the one."""
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
    times = {"seconds": mapped.step_seconds.sum(), "step_microseconds": 1e6 * np.median(mapped.step_seconds)}
    searched = mapped.meter.effort()
    return {name: float(value) for name, value in times.items()} | {
        "microseconds": searched["microseconds"], "nodes": searched["nodes"], "limits": mapped.meter.limits,
    }  # fmt: skip


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else math.nan
