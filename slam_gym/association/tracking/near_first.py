"""The two searches by which locality enters a search with a prior, whatever the search is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from slam_gym.association.compatibility import individual
from slam_gym.association.tree import Tree, interpretation_tree
from slam_gym.types import UNPAIRED, Effort, IntArray, Prediction, Scan

Extra = TypeVar("Extra")


class Found(NamedTuple, Generic[Extra]):
    """What a search of a tree found."""

    rows: IntArray  # (m,) row of the prediction paired with each measurement, given ones included, or UNPAIRED
    effort: Effort
    extra: Extra  # whatever else the search has to tell


def near_first(
    scan: Scan, prediction: Prediction, search: Callable[[Tree], Found[Extra]], confidence: float | None = None
) -> Found[Extra]:
    """Search among what is near, then offer what is left over to the other features; in one go without a locality.

    As in `jcbb`: the first search sees only the features near those paired in recent scans. The second sees the
    measurements left over and the other features, keeps the pairings of the first, and its first pairing restricts the
    others to its own locality. `confidence` of the individual gate: that of the prediction, unless another is given.
    Raises ValueError as `individual` does.
    """
    near = None if prediction.local is None else prediction.near
    candidates = individual(scan, prediction, confidence, eligible=near)
    first = search(interpretation_tree(scan, prediction, candidates))
    if near is None or near.all():
        return first
    left = np.flatnonzero(first.rows == UNPAIRED)
    if not len(left):
        return first
    candidates = individual(scan, prediction, confidence, measurements=left, eligible=~near)
    if not len(candidates.slots):
        return first._replace(effort=together(first.effort, Effort(individual_tests=candidates.tests)))
    second = search(interpretation_tree(scan, prediction, candidates, given=first.rows, local=True))
    return second._replace(effort=together(first.effort, second.effort))


def together(first: Effort, second: Effort) -> Effort:
    """The effort of two searches: counts and times add up."""
    counts = {name: getattr(first, name) + getattr(second, name) for name in Effort.__slots__}
    return Effort(**counts | {"limit_hit": first.limit_hit or second.limit_hit})
