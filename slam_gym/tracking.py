"""Does the robot still see what it should? Notices a kidnapping from the pairings, before the map learns from it."""

from __future__ import annotations

import numpy as np

from slam_gym.types import NONE, BoolArray, Hypothesis, Prediction

_SURE = 0.5  # a feature is expected where its visibility is no less
_REGAINED = 2.0  # tracking is regained at so many times the share below which it was lost


class Tracking:
    """Counts the scans in a row that pair too few of the features that should be in view.

    A feature should be in view if it is established, and either the prediction gives it a visibility of at least one
    half, or, where predictions come without visibilities, the last scan that was believed paired it. What is new on the
    map's rim is thus no reason to doubt, however much of it there is, and neither is what walls are known to hide.

    Arguments:
        collapse: share of the expected features below which a scan is doubted.
        scans: doubted scans in a row after which the robot is lost.
        least: expected features without which nothing is concluded.
    """

    def __init__(self, collapse: float, scans: int, least: int) -> None:
        self.collapse, self.scans, self.least = collapse, scans, least
        self.doubted = 0  # scans in a row
        self._last_paired: set[int] = set()

    @property
    def lost(self) -> bool:
        """So many scans were doubted that the pose cannot be right."""
        return self.doubted >= self.scans

    def doubts(self, prediction: Prediction, hypothesis: Hypothesis, established: BoolArray) -> bool:
        """Whether the scan paired too little to be learned from; `established` (k,) rows of the prediction.

        Once lost, it takes a share twice as large to be believed again, for some pairings come about by chance.
        """
        expected = established & self._in_view(prediction)
        count = int(expected.sum())
        paired = int(np.isin(prediction.features[expected], hypothesis.features).sum())
        needed = self.collapse * (_REGAINED if self.lost else 1.0) * count
        if self.lost and count < self.least:
            return True
        if count >= self.least and paired < needed:
            self.doubted += 1
            return True
        self.believe(hypothesis)
        return False

    def believe(self, hypothesis: Hypothesis) -> None:
        """The hypothesis holds: tracking goes on from it."""
        self.doubted = 0
        self._last_paired = set(hypothesis.features[hypothesis.features != NONE].tolist())

    def _in_view(self, prediction: Prediction) -> BoolArray:
        if prediction.visibility is not None:
            return np.greater_equal(prediction.visibility, _SURE)
        return np.array([feature in self._last_paired for feature in prediction.features.tolist()], dtype=np.bool_)
