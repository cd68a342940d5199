"""The observation of a relocation walk: flat, finite, scaled float32 vectors."""

import numpy as np

from slam_gym.association.relocation.walk import RelocationWalk
from slam_gym.association.walks import (
    MEASURED_FIELDS,
    POSITION_SCALE,
    SIZE_SCALE,
    Float32Array,
    Observation,
    measurement_shown,
    squash,
)

MEASUREMENT_FIELDS = ("present", *MEASURED_FIELDS, "legal", "hidden")
"""Fields of the measurement to decide, in R. `legal`, `hidden`: numbers of legal candidates, and of those not shown."""

CANDIDATE_FIELDS = ("legal", "support", "bound", "mean", "worst", "size_difference", "covisibility")
"""Columns of `candidates`, best first. `support`: fraction of the undecided measurements that keep a legal feature
after this pairing; `bound`: fraction of the scan that the hypothesis could then pair; `mean`, `worst`: D² of its
distances to the pairings of the path; `size_difference` in σ; `covisibility`: fraction of the path's features that are
local to it."""

SCAN_FIELDS = ("present", "x", "y", "size", "decided", "paired", "candidates")
"""Columns of `scan`, one row for each measurement in the order of the levels."""

PATH_FIELDS = (
    "level",  # fraction of the measurements decided
    "pairings",  # fraction of the measurements paired
    "bound",  # fraction of the measurements that no hypothesis below this node exceeds
    "without",  # the bound below `*`
    "leaf",  # only stopping or restarting is left
    "compatible",  # the leaf passed the joint test
)
"""Fields of `path`: the decisions of this try, and what may follow."""

SEARCH_FIELDS = (
    "best",  # pairings of the best hypothesis so far, as a fraction
    "best_distance",  # its D² over its degrees of freedom
    "accepted",  # whether it would be accepted
    "needed",  # pairings required for acceptance, as a fraction
    "nodes_left",  # fraction of the node limit
    "tries",
)
"""Fields of `search`: the result of all tries so far."""

DISTANCE_SCALE = 2.0  # of D²
COUNT_SCALE = 4.0


def walk_shapes(candidates: int, measurements: int) -> dict[str, tuple[int, int]]:
    """Rows and columns of each part of the observation, for K `candidates` and scans of at most `measurements`."""
    return {
        "measurement": (1, len(MEASUREMENT_FIELDS)),
        "candidates": (candidates, len(CANDIDATE_FIELDS)),
        "scan": (measurements, len(SCAN_FIELDS)),
        "path": (1, len(PATH_FIELDS)),
        "search": (1, len(SEARCH_FIELDS)),
    }


def observe_walk(walk: RelocationWalk, measurements: int) -> Observation:
    """The parts of `walk_shapes`, flat, in [−1, 1]. Of a longer scan, the first `measurements` levels are shown."""
    return {
        "measurement": _measurement(walk),
        "candidates": _candidates(walk),
        "scan": _scan(walk, measurements),
        "path": _path(walk),
        "search": _search(walk),
    }


def _measurement(walk: RelocationWalk) -> Float32Array:
    i, offer = walk.measurement, walk.offer
    if i is None or offer is None:
        return np.zeros(len(MEASUREMENT_FIELDS), np.float32)
    counts = squash(len(offer.features), COUNT_SCALE), squash(walk.hidden, COUNT_SCALE)
    return np.array([1.0, *measurement_shown(walk.scan, i), *counts], np.float32)


def _candidates(walk: RelocationWalk) -> Float32Array:
    k, m, i, offer = walk.spec.candidates, len(walk.scan), walk.measurement, walk.offer
    out = np.zeros((k, len(CANDIDATE_FIELDS)), np.float32)
    if i is None or offer is None:
        return out.ravel()
    scan, landmarks, shown, support = walk.scan, walk.landmarks, walk.shown, offer.support[:k]
    variances = np.maximum(scan.size_variances[i] + landmarks.size_variances[shown], 1e-12)
    difference = (scan.sizes[i] - landmarks.sizes[shown]) / np.sqrt(variances)
    out[: len(shown)] = np.column_stack(
        [
            np.ones(len(shown)),
            support / max(m - walk.level - 1, 1),
            (walk.node.pairings + 1 + support) / m,
            squash(offer.mean[:k], DISTANCE_SCALE),
            squash(offer.worst[:k], DISTANCE_SCALE),
            np.nan_to_num(squash(difference, 1.0)),
            offer.local[:k],
        ]
    )
    return out.ravel()


def _scan(walk: RelocationWalk, measurements: int) -> Float32Array:
    out = np.zeros((measurements, len(SCAN_FIELDS)), np.float32)
    scan, shown = walk.scan, walk.order[:measurements]
    out[: len(shown)] = np.column_stack(
        [
            np.ones(len(shown)),
            squash(scan.points[shown], POSITION_SCALE),
            squash(np.nan_to_num(scan.sizes[shown]), SIZE_SCALE),
            walk.node.decided[shown],
            np.isin(shown, walk.node.path.measurements),
            squash(walk.node.alive[shown].sum(axis=1), COUNT_SCALE),
        ]
    )
    return out.ravel()


def _path(walk: RelocationWalk) -> Float32Array:
    m, node = max(len(walk.scan), 1), walk.node
    counts = np.array([walk.level, node.pairings, node.bound_without(None), node.bound_without(walk.measurement)])
    return np.array([*(counts / m), walk.at_leaf, bool(walk.compatible)], np.float32)


def _search(walk: RelocationWalk) -> Float32Array:
    m, best = max(len(walk.scan), 1), walk.best
    distance, tries = best.joint_distance / max(best.dof, 1), squash(walk.tries - 1, COUNT_SCALE)
    left = 1.0 - walk.nodes / walk.spec.node_limit
    shown = best.pairings / m, squash(distance, DISTANCE_SCALE), best.accepted, min(walk.needed / m, 1.0), left, tries
    return np.array(shown, np.float32)
