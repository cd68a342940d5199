"""JCBB: joint compatibility branch and bound (Neira and Tardós, IEEE TRA 17(6), 2001), with covisibility locality."""

from __future__ import annotations

import numpy as np

from slam_gym.association.branch_and_bound import complete
from slam_gym.association.compatibility import individual
from slam_gym.association.tree import as_hypothesis, interpretation_tree
from slam_gym.types import NONE, Effort, Hypothesis, Prediction, Scan


def jcbb(
    scan: Scan,
    prediction: Prediction,
    *,
    confidence: float = 0.99,
    node_limit: int = 100_000,
    locality: str | None = "covisibility",
) -> Hypothesis:
    """The jointly compatible hypothesis with most pairings, and of those the one with least D²_H.

    Where the prediction carries a locality, it is used unless `locality` is None, in two searches: measurements are
    first offered the features near those paired in recent scans; those left over are then offered the other features,
    with the pairings of the first search kept, and there the first pairing restricts the others to its own locality.

    `node_limit` bounds each of the two searches; where it is met, `effort.limit_hit` says so and the best hypothesis
    found until then is returned. Raises ValueError as `individual` does, for a node limit below 1, and for an unknown
    locality.
    """
    if node_limit < 1:
        raise ValueError(f"node_limit: {node_limit} is less than 1")
    if locality not in ("covisibility", None):
        raise ValueError(f"locality: {locality!r} is neither 'covisibility' nor None")
    near = prediction.locality.near if locality and prediction.locality else None
    candidates = individual(scan, prediction, confidence, eligible=near)
    tree = interpretation_tree(scan, prediction, candidates, confidence)
    rows, distance, effort = complete(tree, node_limit=node_limit)
    left = np.flatnonzero(rows == NONE)
    if near is not None and len(left) and not near.all():
        candidates = individual(scan, prediction, confidence, measurements=left, eligible=~near)
        more = Effort(individual_tests=candidates.tests)
        if len(candidates.slots):
            tree = interpretation_tree(scan, prediction, candidates, confidence, given=rows, local=True)
            rows, distance, more = complete(tree, node_limit=node_limit)
        effort = _sum(effort, more)
    return as_hypothesis(prediction, rows, distance, effort)


def _sum(a: Effort, b: Effort) -> Effort:
    return Effort(
        a.nodes + b.nodes,
        a.individual_tests + b.individual_tests,
        a.joint_tests + b.joint_tests,
        a.limit_hit or b.limit_hit,
    )
