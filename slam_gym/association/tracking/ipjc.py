"""IPJC: joint compatibility tested after the pose has been optimised on the hypothesis."""

from __future__ import annotations

import numpy as np

from slam_gym.association.tracking.heading_search import search as posterior_search
from slam_gym.association.tracking.stages import in_stages
from slam_gym.association.tree import Tree, as_hypothesis
from slam_gym.types import NONE, Array, Effort, Hypothesis, IntArray, Prediction, Scan

_UNRESTRICTED = np.empty((0, 0), np.bool_)


def ipjc(
    scan: Scan,
    prediction: Prediction,
    *,
    confidence: float = 0.99,
    node_limit: int = 100_000,
    locality: str | None = "covisibility",
) -> Hypothesis:
    """The hypothesis with most pairings, then least D²_H, each prefix compatible at the pose that fits it best.

    Olson and Li, "IPJC: the incremental posterior joint compatibility test for fast feature cloud matching", IROS 2012.
    JCBB tests linearised at the predicted pose, which is wrong by about r φ²/2 for a feature at range r once the robot
    turns out to have turned by φ. Here D²_H is the least value of the cost of which an EKF update is one Gauss-Newton
    step: of prior and measurements together, over pose and features. Everything is linear but for the heading, so the
    optimum is found in one dimension (`posterior_search`); where the heading is known, this is JCBB. It needs
    `Prediction.heading_variance`; a prediction where it is 0 is linear, which is JCBB again. Candidates must pass the
    individual gate at the predicted pose, as in `jcbb`.

    `joint_distance` is D²_H so optimised. `node_limit`, `locality`, `effort.limit_hit` and errors are those of `jcbb`.
    """
    if node_limit < 1:
        raise ValueError(f"node_limit: {node_limit} is less than 1")

    def search(tree: Tree) -> tuple[IntArray, Effort, float]:
        return _search(tree, node_limit)

    rows, effort, distance = in_stages(
        scan, prediction, search, gate=confidence, confidence=confidence, locality=locality
    )
    return as_hypothesis(prediction, rows, distance, effort)


def _search(tree: Tree, node_limit: int) -> tuple[IntArray, Effort, float]:
    """Rows (m,), effort and D² of the best hypothesis."""
    candidates, rows, g = tree.candidates, tree.given.copy(), tree.pairings_given
    slots = np.concatenate((np.arange(g), tree.slots))
    measured = np.concatenate((np.flatnonzero(tree.given != NONE), candidates.measured))
    if not len(slots):
        return rows, Effort(individual_tests=candidates.tests), 0.0
    variance, errors, covariance = _given_heading(tree, slots, measured)
    chosen, distance, nodes, tests, limit_hit = posterior_search(
        slots,
        measured,
        errors,
        tree.scan.covariances,
        covariance,
        variance,
        _UNRESTRICTED if tree.local is None else tree.local,
        g,
        tree.gates,
        node_limit,
    )
    rows[measured[chosen]] = tree.rows[slots[chosen]]
    return rows, Effort(nodes, candidates.tests, tests, limit_hit), distance


def _given_heading(tree: Tree, slots: IntArray, measured: IntArray) -> tuple[float, Array, Array]:
    """Variance of the heading; the four vectors (c, 2, 4) of each candidate's error; covariance given the heading."""
    z, at = tree.scan.points[measured], tree.prediction.positions[tree.rows]
    errors = np.zeros((len(slots), 2, 4))
    errors[:, :, 0] = z - at[slots]
    variance, across = tree.prediction.heading_variance, tree.prediction.heading_covariances[tree.rows]
    if not variance > 0.0:
        return 0.0, errors, tree.covariance
    turning = np.column_stack([-at[:, 1], at[:, 0]]) + across / variance
    errors[:, :, 1], errors[:, 0, 2], errors[:, 1, 2], errors[:, :, 3] = z, -z[:, 1], z[:, 0], turning[slots]
    flat = across.ravel()
    return variance, errors, tree.covariance - np.outer(flat, flat) / variance
