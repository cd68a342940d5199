"""Global nearest neighbour: the assignment of measurements to features that is cheapest as a whole."""

from __future__ import annotations

import numpy as np

from slam_gym.association.compatibility import chi2_gate, joint_distance
from slam_gym.association.tracking.near_first import Found, near_first
from slam_gym.association.tree import Tree, as_hypothesis
from slam_gym.types import BoolArray, Effort, Hypothesis, IntArray, Prediction, Scan

_FORBIDDEN = 1e9  # the price of a pairing that is not compatible: more than any assignment without one


def global_nearest_neighbour(scan: Scan, prediction: Prediction) -> Hypothesis:
    """GNN: minimises Σ (D²_ij + log det S_ij) over the pairings plus a price for every measurement left unpaired.

    Pairings are individually compatible, each feature paired at most once (Blackman and Popoli, "Design and Analysis of
    Modern Tracking Systems", 1999, §6.4). Leaving measurement i unpaired costs the gate χ²_{2,conf} plus the largest
    log det S_ij among its candidates, so any compatible pairing is better than none, unless it takes a feature from a
    measurement that needs it more. Each pairing is still weighed alone: their correlation through the robot's pose is
    ignored. Solved exactly, by scipy's linear assignment.

    A locality of the prediction is used as in `jcbb`, except that pairings in the second search, made all at once, do
    not restrict each other. Raises ValueError as `individual` does.
    """
    gate = chi2_gate(2, prediction.confidence)

    def search(tree: Tree) -> Found[None]:
        effort = Effort(nodes=tree.levels, individual_tests=tree.candidates.tests)
        return Found(_assign(scan, prediction, tree, gate), effort, None)

    found = near_first(scan, prediction, search)
    distance = joint_distance(scan, prediction, found.rows).squared
    return as_hypothesis(prediction, found.rows, distance, found.effort)


def _assign(scan: Scan, prediction: Prediction, tree: Tree, gate: float) -> IntArray:
    """Rows (m,) of the cheapest assignment, the given ones kept."""
    from scipy.optimize import linear_sum_assignment  # takes as long to import as everything else together

    candidates, rows = tree.candidates, tree.given.copy()
    if not len(candidates.slots):
        return rows
    features = candidates.rows[candidates.slots]
    S = prediction.covariances[features] + scan.covariances[candidates.measured]
    size = np.log(S[:, 0, 0] * S[:, 1, 1] - S[:, 0, 1] ** 2)
    some, columns = np.flatnonzero(np.diff(candidates.starts)), len(candidates.rows)
    level = np.repeat(np.arange(len(some)), np.diff(candidates.starts)[some])
    costs = np.full((len(some), columns + len(some)), _FORBIDDEN)
    costs[level, candidates.slots] = candidates.distances + size
    costs[np.arange(len(some)), columns + np.arange(len(some))] = gate + np.maximum.reduceat(
        size, candidates.starts[some]
    )
    _, chosen = linear_sum_assignment(costs)
    paired: BoolArray = chosen < columns
    rows[candidates.measurements[some[paired]]] = candidates.rows[chosen[paired]]
    return rows
