"""What is right, decision by decision, while a scan is being associated; judged as `metrics.association` does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam_gym.association.tracking.walk import Walk
from slam_gym.metrics.association import Decision
from slam_gym.types import UNLABELLED, UNPAIRED, IntArray, Truth

NOT_OFFERED = -1
"""Instead of an action: the right one is not on offer, or nobody knows it."""

UNDECIDED = -1
"""Instead of a `Decision`: the measurement is still to be decided."""


@dataclass(frozen=True, slots=True)
class RightAnswers:
    """What the truth has to say about a scan, given the map before it."""

    sources: IntArray  # (m,) true feature behind each measurement
    identities: IntArray  # (n,) true feature behind each feature of the map
    right: IntArray  # (m,) map feature of each measurement, of duplicates the oldest; UNPAIRED: the map has none

    @classmethod
    def of(cls, truth: Truth, identities: IntArray) -> RightAnswers:
        """On the scan of `truth`, by a map whose features (n,) come from the true features `identities`."""
        oldest: dict[int, int] = {}
        for feature, source in enumerate(identities.tolist()):
            oldest.setdefault(source, feature)
        sources = truth.sources.tolist()
        right = [oldest.get(source, UNPAIRED) if source >= 0 else UNPAIRED for source in sources]
        return cls(truth.sources, identities, np.array(right, np.int64))

    @property
    def known(self) -> int:
        """Measurements of features seen before."""
        return int(np.count_nonzero(self.right != UNPAIRED))

    def judge(self, measurement: int, feature: int) -> tuple[int, int]:
        """(right, wrong) of a pairing: (1, 0), (0, 1), or (0, 0) where a label is missing."""
        if self.sources[measurement] == UNLABELLED or self.identities[feature] == UNLABELLED:
            return 0, 0
        right = int(self.right[measurement] == feature)
        return right, 1 - right

    def right_action(self, walk: Walk) -> int:
        """The action of the walk that is right; NOT_OFFERED where it is not on offer, or nobody knows."""
        i = walk.measurement
        if self.sources[i] == UNLABELLED:
            return NOT_OFFERED
        if self.right[i] == UNPAIRED:
            return walk.K
        features = walk.tree.prediction.features[walk.rows]
        found = np.flatnonzero(features == self.right[i])
        return int(found[0]) if len(found) else NOT_OFFERED


def decisions(walk: Walk, answers: RightAnswers) -> IntArray:
    """(m,) `Decision` on each measurement of a walk so far, UNDECIDED where there is none yet."""
    rows, out = walk.decided, np.full(len(walk.tree.scan), UNDECIDED)
    for i in walk.candidates.measurements[: walk.level].tolist():
        if rows[i] == UNPAIRED:
            out[i] = Decision.DISCARDED
            continue
        right, wrong = answers.judge(i, int(walk.tree.prediction.features[rows[i]]))
        out[i] = Decision.RIGHT if right else Decision.WRONG if wrong else Decision.UNJUDGED
    return out
