"""JCBB: joint compatibility branch and bound (Neira and Tardós, IEEE TRA 17(6), 2001), with covisibility locality."""

from __future__ import annotations

from slam_gym.association.tracking.branch_and_bound import complete
from slam_gym.association.tracking.stages import in_stages
from slam_gym.association.tree import Tree, as_hypothesis
from slam_gym.types import Effort, Hypothesis, IntArray, Prediction, Scan


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

    def search(tree: Tree) -> tuple[IntArray, Effort, float]:
        rows, distance, effort = complete(tree, node_limit=node_limit)
        return rows, effort, distance

    rows, effort, distance = in_stages(
        scan, prediction, search, gate=confidence, confidence=confidence, locality=locality
    )
    return as_hypothesis(prediction, rows, distance, effort)
