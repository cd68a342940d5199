"""What is measured of a run over a log: associations by the identities, poses and features by the reference."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from agents.evaluation.recording_run import Run
from slam_gym.geometry import transform
from slam_gym.metrics.consistency import anees, pose_nees
from slam_gym.metrics.map_quality import align_se2, landmark_rmse
from slam_gym.metrics.trajectory import ate
from slam_gym.recordings.recording import Recording, interpolate
from slam_gym.types import NONE, Array

GAP = 1.0  # [s] between samples, over which poses are not interpolated
REFERENCE_SIGMA = (0.005, 0.005, math.radians(0.5))  # [m, m, rad] of reference poses


def compare(log: Recording, run: Run) -> tuple[Array, Array, Array]:
    """Instants (k,) that both know, poses (k, 3) of the run, and of the reference.

    Whichever has more samples while the log lasts is interpolated at those of the other.
    """
    t, reference = log.reference_times, log.reference_poses
    if len(t) == 0:
        return np.empty(0), np.empty((0, 3)), np.empty((0, 3))
    during = (t >= log.times[0]) & (t <= log.times[-1])
    if during.sum() <= len(log):
        rows = during & _close(log.times, t)
        return t[rows], interpolate(log.times, run.poses, t[rows]), reference[rows]
    rows = _close(t, log.times)
    return log.times[rows], run.poses[rows], interpolate(t, reference, log.times[rows])


def _close(times: Array, at: Array) -> np.ndarray:
    """Which instants (k,) lie between two of `times` that are no more than GAP apart."""
    after = np.searchsorted(times, at, side="left")
    inside = (at >= times[0]) & (at <= times[-1])
    after = np.clip(after, 0, len(times) - 1)
    before = np.where(times[after] == at, after, np.maximum(after - 1, 0))
    close: np.ndarray = inside & (times[after] - times[before] <= GAP)
    return close


def measure(log: Recording, run: Run) -> dict[str, Any]:
    """The numbers of a run."""
    return {
        "steps": len(log), "measurements": len(log.points),
        **_associations(log, run), **_features(log, run), **_poses(log, run), **_landmarks(log, run), **_effort(run),
    }  # fmt: skip


def _associations(log: Recording, run: Run) -> dict[str, Any]:
    """Over the measurements with an identity; what became of the spurious ones goes by itself."""
    tally = run.tally
    paired = tally.tp + tally.fp_wrong + tally.fp_duplicate
    spurious = (log.sources == NONE) & (run.ids != NONE) & ~run.created
    clutter = int((log.sources == NONE).sum())
    return {
        "precision": _ratio(tally.tp, paired),
        "recall": tally.recall,
        "f1": _ratio(2 * tally.tp, paired + tally.in_map),
        "wrong": tally.fp_wrong,
        "clutter": clutter,
        "clutter_accepted": int(spurious.sum()),
        "clutter_share": _ratio(int(spurious.sum()), clutter),
        "clutter_on_landmarks": int((spurious & (run.behind >= 0)).sum()),
    }


def _features(log: Recording, run: Run) -> dict[str, Any]:
    """Of the confirmed features, by the identity of what started them."""
    identities = run.identities[run.confirmed]
    real = identities[identities >= 0]
    return {
        "features": len(identities),
        "true_features": len(np.unique(log.sources[log.sources >= 0])),
        "found": len(np.unique(real)),
        "duplicates": len(real) - len(np.unique(real)),
        "clutter_features": int((identities == NONE).sum()),
        "unlabelled_features": int((identities < NONE).sum()),
    }


def _poses(log: Recording, run: Run) -> dict[str, float]:
    _, estimated, reference = compare(log, run)
    align = align_se2(estimated[:, :2], reference[:, :2])
    off = np.hypot(*(transform(align, np.ascontiguousarray(estimated[:, :2])) - reference[:, :2]).T)
    known = run.surveyed and len(reference) > 0
    return {
        "ate": ate(estimated, reference, aligned=True),
        "ate_median": float(np.median(off)) if len(off) else math.nan,
        "ate_unaligned": ate(estimated, reference) if known else math.nan,
        "anees": _anees(log, run) if known else math.nan,
        **dict(zip(("align_x", "align_y", "align_heading"), align.tolist())),
    }


def _anees(log: Recording, run: Run) -> float:
    """Of the poses, at the steps for which there is a reference; its own uncertainty counts too."""
    known = _close(log.reference_times, log.times)
    true = interpolate(log.reference_times, log.reference_poses, log.times[known])
    own = np.diag(np.square(REFERENCE_SIGMA))
    triples = zip(run.poses[known], run.pose_covariances[known] + own, true)
    return anees(np.array([pose_nees(pose, covariance, at) for pose, covariance, at in triples]), 3)


def _landmarks(log: Recording, run: Run) -> dict[str, float]:
    """Of the landmarks whose place is known; of duplicates, the oldest is the one."""
    place = {identity: k for k, identity in enumerate(log.landmark_ids.tolist())}
    rows: dict[int, int] = {}
    for row in np.flatnonzero(run.confirmed).tolist():
        if (identity := int(run.identities[row])) in place:
            rows.setdefault(identity, row)
    estimated = run.positions[list(rows.values())]
    true = log.landmarks[[place[identity] for identity in rows]]
    return {
        "landmark_rmse": landmark_rmse(estimated, true, aligned=True),
        "landmark_rmse_unaligned": landmark_rmse(estimated, true) if run.surveyed else math.nan,
        "landmarks_compared": len(rows),
    }


def _effort(run: Run) -> dict[str, float]:
    searched = len(run.nodes) > 0
    return {
        "seconds": float(run.step_seconds.sum()),
        "step_microseconds": 1e6 * float(np.median(run.step_seconds)),
        "microseconds": 1e6 * float(np.median(run.associator_seconds)) if searched else math.nan,
        "nodes": float(run.nodes.mean()) if searched else math.nan,
        "limits": run.limits,
    }


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else math.nan
