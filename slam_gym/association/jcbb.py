"""JCBB: joint compatibility branch and bound (Neira and Tardós, IEEE TRA 17(6), 2001), with covisibility locality."""

from __future__ import annotations

from slam_gym.association.branch_and_bound import complete
from slam_gym.association.tree import as_hypothesis, interpretation_tree, root
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
    tree = interpretation_tree(scan, prediction, confidence, eligible=near)
    rows, distance, effort = complete(tree, root(tree), node_limit)
    if near is not None and not near.all() and (rows == NONE).any():
        tree = interpretation_tree(scan, prediction, confidence, given=rows, eligible=~near, local=True)
        rows, distance, more = complete(tree, root(tree), node_limit)
        effort = Effort(
            effort.nodes + more.nodes,
            effort.individual_tests + more.individual_tests,
            effort.joint_tests + more.joint_tests,
            effort.limit_hit or more.limit_hit,
        )
    return as_hypothesis(prediction, rows, distance, effort)
