"""The right decisions while a scan is being associated, judged as in `metrics.association`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam_gym.association.tracking.walk import Walk
from slam_gym.metrics.association import Decision
from slam_gym.types import UNLABELLED, UNPAIRED, IntArray, Truth

NOT_OFFERED = -1
"""In place of an action: the right action is not offered, or unknown."""

UNDECIDED = -1
"""In place of a `Decision`: the measurement is not decided yet."""


@dataclass(frozen=True, slots=True)
class RightAnswers:
    """The truth about a scan, relative to the map before it."""

    sources: IntArray  # (m,) true feature behind each measurement
    identities: IntArray  # (n,) true feature behind each feature of the map
    right: IntArray  # (m,) map feature of each measurement, the oldest of duplicates; UNPAIRED: not in the map

    @classmethod
    def of(cls, truth: Truth, identities: IntArray) -> RightAnswers:
        """For the scan of `truth`, and a map whose features (n,) come from the true features `identities`."""
        oldest: dict[int, int] = {}
        for feature, source in enumerate(identities.tolist()):
            oldest.setdefault(source, feature)
        sources = truth.sources.tolist()
        right = [oldest.get(source, UNPAIRED) if source >= 0 else UNPAIRED for source in sources]
        return cls(truth.sources, identities, np.array(right, np.int64))

    @property
    def known(self) -> int:
        """Number of measurements of features that the map has."""
        return int(np.count_nonzero(self.right != UNPAIRED))

    def judge(self, measurement: int, feature: int) -> tuple[int, int]:
        """(right, wrong) of a pairing: (1, 0), (0, 1), or (0, 0) where a label is missing."""
        if self.sources[measurement] == UNLABELLED or self.identities[feature] == UNLABELLED:
            return 0, 0
        right = int(self.right[measurement] == feature)
        return right, 1 - right

    def right_action(self, walk: Walk) -> int:
        """The right action of the walk; NOT_OFFERED if it is not offered, or unknown."""
        i = walk.measurement
        if self.sources[i] == UNLABELLED:
            return NOT_OFFERED
        if self.right[i] == UNPAIRED:
            return walk.K
        features = walk.tree.prediction.features[walk.rows]
        rows = np.flatnonzero(features == self.right[i])
        return int(rows[0]) if len(rows) else NOT_OFFERED


def decisions(walk: Walk, answers: RightAnswers) -> IntArray:
    """(m,) `Decision` on each measurement of a walk so far, UNDECIDED for later measurements."""
    rows, out = walk.decided, np.full(len(walk.tree.scan), UNDECIDED)
    for i in walk.candidates.measurements[: walk.level].tolist():
        if rows[i] == UNPAIRED:
            out[i] = Decision.DISCARDED
            continue
        right, wrong = answers.judge(i, int(walk.tree.prediction.features[rows[i]]))
        out[i] = Decision.RIGHT if right else Decision.WRONG if wrong else Decision.UNJUDGED
    return out
