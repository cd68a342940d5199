"""Does the robot still see what it should? Notices a kidnapping from the pairings, before the map learns from it."""

from __future__ import annotations

import numpy as np

from slam_gym.types import NONE, BoolArray, Hypothesis, Prediction

_SURE, _PERHAPS = 0.5, 0.1  # visibility from which a feature is expected; and from which, if it was paired last
_REGAINED = 2.0  # to be regained, it takes so many times what must be paired and there to be believed before
_MOST = 0.5  # share of the measurements that speaks for the pose, whatever else should be in view


class Tracking:
    """Counts the scans in a row that are not what the map leads one to expect.

    A scan is doubted for either of two reasons. Too few of the features that should be in view are paired, while what
    is measured makes little sense; or hardly anything that is measured is paired, right after a scan that knew its way.
    A feature should be in view if it is established, and either its predicted visibility is at least one half, or the
    last scan that was believed paired it and nothing says that it has gone out of view since. What is new on the map's
    rim is thus no reason to doubt as long as it comes into view by and by, and neither is what walls are known to hide.

    Arguments:
        collapse: share of the expected features, or of the measurements, below which a scan is doubted.
        scans: doubted scans in a row after which the robot is lost.
        least: expected features, or measurements, without which nothing is concluded.
    """

    def __init__(self, collapse: float, scans: int, least: int) -> None:
        self.collapse, self.scans, self.least = collapse, scans, least
        self.doubted = 0  # scans in a row
        self._last_paired: set[int] = set()  # features that the last scan believed was paired with

    @property
    def lost(self) -> bool:
        """So many scans were doubted that the pose cannot be right."""
        return self.doubted >= self.scans

    def doubts(self, prediction: Prediction, hypothesis: Hypothesis, established: BoolArray) -> bool:
        """Whether the scan paired too little to be learned from; `established` (k,) rows of the prediction.

        Once lost, it takes twice the share, and twice as many, to be believed again: chance pairs some now and then.
        """
        known = set(prediction.features[established].tolist())
        expected = set(prediction.features[established & self._in_view(prediction)].tolist())
        paired = known.intersection(hypothesis.features.tolist())
        measured, share = len(hypothesis.features), self.collapse * (_REGAINED if self.lost else 1.0)
        missing = len(expected) >= self.least and len(expected & paired) < share * len(expected)
        strange = min(measured, len(known & self._last_paired)) >= self.least and len(paired) < share * measured
        unsure = self.lost and len(expected & paired) < _REGAINED * self.least
        if (missing and len(paired) < _MOST * measured) or strange or unsure:
            self.doubted += 1
            return True
        self.believe(hypothesis)
        return False

    def believe(self, hypothesis: Hypothesis) -> None:
        """The hypothesis holds: tracking goes on from it."""
        self.doubted = 0
        self._last_paired = set(hypothesis.features[hypothesis.features != NONE].tolist())

    def _in_view(self, prediction: Prediction) -> BoolArray:
        paired = np.array([feature in self._last_paired for feature in prediction.features.tolist()], dtype=np.bool_)
        if prediction.visibility is None:
            return paired
        return (prediction.visibility >= _SURE) | (paired & (prediction.visibility >= _PERHAPS))
