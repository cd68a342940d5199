"""IPJC: joint compatibility tested after the pose has been optimised on the hypothesis."""

from __future__ import annotations

import numpy as np

from slam_gym.association.tracking.branch_and_bound import complete
from slam_gym.association.tracking.heading import Turning
from slam_gym.association.tracking.jcbb import check_node_limit
from slam_gym.association.tracking.near_first import Found, near_first
from slam_gym.association.tree import Tree, as_hypothesis
from slam_gym.types import Hypothesis, Prediction, Scan


def ipjc(scan: Scan, prediction: Prediction, *, node_limit: int = 100_000) -> Hypothesis:
    """The hypothesis with most pairings, then least D²_H, each prefix compatible at the pose that fits it best.

    Olson and Li, "IPJC: the incremental posterior joint compatibility test for fast feature cloud matching", IROS 2012.
    JCBB tests linearised at the predicted pose, which is wrong by about r φ²/2 for a feature at range r once the robot
    turns out to have turned by φ. Here D²_H is the least value of the cost of which an EKF update is one Gauss-Newton
    step: of prior and measurements together, over pose and features. Everything is linear but for the heading, so the
    optimum is found in one dimension (`heading`); a prediction whose heading is certain is linear, and this is JCBB.
    Candidates must pass the individual gate at the predicted pose, as in `jcbb`.

    `joint_distance` is D²_H so optimised. `node_limit`, locality, `effort.limit_hit` and errors are those of `jcbb`.
    """
    check_node_limit(node_limit)
    certain = not prediction.heading_variance > 0.0

    def search(tree: Tree) -> Found[float]:
        if certain or not len(tree.pairings.slots):
            best = complete(tree, node_limit=node_limit)
        else:
            turning = turning_of(tree)
            best = complete(_given_heading(tree), None, node_limit, turning)
        return Found(best.rows, best.effort, best.distance)

    found = near_first(scan, prediction, search)
    return as_hypothesis(prediction, found.rows, found.extra, found.effort)


def turning_of(tree: Tree) -> Turning:
    """The uncertain heading of a prediction, with the three further vectors of each pairing's error, see `heading`."""
    prediction, slots = tree.prediction, tree.pairings.slots
    at, across = prediction.positions[tree.rows], prediction.heading_covariances[tree.rows]
    z, variance = tree.scan.points[tree.pairings.measured], prediction.heading_variance
    depth, count = len(tree.gates), len(slots)
    errors = np.empty((depth, count, 2, 3))
    errors[0, :, :, 0], errors[0, :, 0, 1], errors[0, :, 1, 1] = z, -z[:, 1], z[:, 0]
    errors[0, :, :, 2] = (np.column_stack([-at[:, 1], at[:, 0]]) + across / variance)[slots]
    return Turning(
        variance,
        errors,
        np.empty((depth, 2, 3)),
        np.zeros((depth, 4, 4)),
        np.zeros(depth),
        np.zeros((depth, count)),
    )


def _given_heading(tree: Tree) -> Tree:
    """The tree with the covariance that is left once the heading is known."""
    across = tree.prediction.heading_covariances[tree.rows].ravel()
    left = tree.pairings.covariance - np.outer(across, across) / tree.prediction.heading_variance
    return tree._replace(pairings=tree.pairings._replace(covariance=left))
