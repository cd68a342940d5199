"""JCBB: joint compatibility branch and bound (Neira and Tardós, IEEE TRA 17(6), 2001), with covisibility locality."""

from __future__ import annotations

from slam_gym.association.tracking.branch_and_bound import NODE_LIMIT, complete
from slam_gym.association.tracking.near_first import Found, near_first
from slam_gym.association.tree import Tree, as_hypothesis
from slam_gym.types import Hypothesis, Prediction, Scan


def jcbb(scan: Scan, prediction: Prediction, *, node_limit: int = NODE_LIMIT) -> Hypothesis:
    """The jointly compatible hypothesis with most pairings, and of those the one with least D²_H.

    Where the prediction carries a locality, there are two searches: measurements are first offered the features near
    those paired in recent scans; those left over are then offered the other features, with the pairings of the first
    search kept, and there the first pairing restricts the others to its own locality.

    `node_limit` bounds each of the two searches, and so do a million joint tests; where one is met, `effort.limit_hit`
    says so and the best hypothesis found until then is returned. Raises ValueError as `individual` does, and for a node
    limit below 1.
    """
    check_node_limit(node_limit)

    def search(tree: Tree) -> Found[float]:
        best = complete(tree, node_limit=node_limit)
        return Found(best.rows, best.effort, best.distance)

    found = near_first(scan, prediction, search)
    return as_hypothesis(prediction, found.rows, found.extra, found.effort)


def check_node_limit(node_limit: int) -> None:
    """Raises ValueError for a limit below 1."""
    if node_limit < 1:
        raise ValueError(f"node_limit: {node_limit} is less than 1")
