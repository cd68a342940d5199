"""Global nearest neighbour: the assignment of measurements to features that is cheapest as a whole."""

from __future__ import annotations

import numpy as np

from slam_gym.association.compatibility import chi2_gate
from slam_gym.association.prediction import Prediction
from slam_gym.association.tracking.near_first import Offer, near_first
from slam_gym.types import BoolArray, Effort, Hypothesis, IntArray, Scan

_FORBIDDEN = 1e9  # the price of a pairing that is not compatible: more than any assignment without one


def global_nearest_neighbour(scan: Scan, prediction: Prediction) -> Hypothesis:
    """GNN: minimises Σ (D²_ij + log det S_ij) over the pairings plus a price for every measurement left unpaired.

    Pairings are individually compatible, each feature paired at most once (Blackman and Popoli, "Design and Analysis of
    Modern Tracking Systems", 1999, §6.4). Leaving measurement i unpaired costs the gate χ²_{2,conf} plus the largest
    log det S_ij among its candidates, so any compatible pairing is better than none, unless it takes a feature from a
    measurement that needs it more. Each pairing is still weighed alone: their correlation through the robot's pose is
    ignored. Solved exactly, by scipy's linear assignment.

    A locality of the prediction is used as in `jcbb`, except that pairings in the second search, made all at once, do
    not restrict each other. Raises ValueError as `check_fault`.
    """
    from scipy.optimize import linear_sum_assignment  # takes as long to import as everything else together

    gate = chi2_gate(2, prediction.confidence)

    def search(offer: Offer, rows: IntArray) -> Effort:
        p, g = offer.pairings, offer.pairings.given
        measured, level = np.unique(p.measured[g:], return_inverse=True)
        features, columns = offer.rows[p.slots[g:]], len(offer.rows)
        S = prediction.covariances[features] + scan.covariances[p.measured[g:]]
        size = np.log(S[:, 0, 0] * S[:, 1, 1] - S[:, 0, 1] ** 2)
        distances = np.einsum("ci,cij,cj->c", p.innovations[g:], np.linalg.inv(S), p.innovations[g:])
        costs = np.full((len(measured), columns + len(measured)), _FORBIDDEN)
        costs[level, p.slots[g:]] = distances + size
        largest = np.full(len(measured), -np.inf)
        np.maximum.at(largest, level, size)
        costs[np.arange(len(measured)), columns + np.arange(len(measured))] = gate + largest
        _, chosen = linear_sum_assignment(costs)
        paired: BoolArray = chosen < columns
        rows[measured[paired]] = offer.rows[chosen[paired]]
        return Effort(nodes=len(offer.starts) - 1)

    return near_first(scan, prediction, search)
