"""The two searches by which locality enters a search with a prior, whatever the search is."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from slam_gym.association.compatibility import individual
from slam_gym.association.tree import Tree, interpretation_tree
from slam_gym.types import NONE, Effort, IntArray, Prediction, Scan

T = TypeVar("T")

Search = Callable[[Tree], tuple[IntArray, Effort, T]]
"""From a tree to the rows (m,) paired, given ones included, the effort of it, and whatever else the search found."""


def in_stages(
    scan: Scan,
    prediction: Prediction,
    search: Search[T],
    *,
    gate: float,
    confidence: float,
    locality: str | None,
) -> tuple[IntArray, Effort, T]:
    """Search among what is near, then offer what is left over to the other features; in one go without a locality.

    As in `jcbb`: the first search sees only the features near those paired in recent scans. The second sees the
    measurements left over and the other features, keeps the pairings of the first, and its first pairing restricts the
    others to its own locality. `gate` is the confidence of individual, `confidence` that of joint compatibility.
    Raises ValueError as `individual` does, and for an unknown locality.
    """
    if locality not in ("covisibility", None):
        raise ValueError(f"locality: {locality!r} is neither 'covisibility' nor None")
    near = prediction.near if locality and prediction.local is not None else None
    candidates = individual(scan, prediction, gate, eligible=near)
    rows, effort, found = search(interpretation_tree(scan, prediction, candidates, confidence))
    left = np.flatnonzero(rows == NONE)
    if near is None or not len(left) or near.all():
        return rows, effort, found
    candidates = individual(scan, prediction, gate, measurements=left, eligible=~near)
    if not len(candidates.slots):
        return rows, together(effort, Effort(individual_tests=candidates.tests)), found
    tree = interpretation_tree(scan, prediction, candidates, confidence, given=rows, local=True)
    rows, more, found = search(tree)
    return rows, together(effort, more), found


def together(first: Effort, second: Effort) -> Effort:
    """The effort of two searches: counts and times add up."""
    return Effort(
        nodes=first.nodes + second.nodes,
        individual_tests=first.individual_tests + second.individual_tests,
        joint_tests=first.joint_tests + second.joint_tests,
        limit_hit=first.limit_hit or second.limit_hit,
        unary_tests=first.unary_tests + second.unary_tests,
        binary_tests=first.binary_tests + second.binary_tests,
        leaves=first.leaves + second.leaves,
        tries=first.tries + second.tries,
        seconds=first.seconds + second.seconds,
        orientation_tests=first.orientation_tests + second.orientation_tests,
    )
