"""Detector of relocation: from what a scan pairs, the robot notices before the map learns that it may be lost."""

from __future__ import annotations

import math

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.prediction import Prediction
from slam_gym.types import UNPAIRED, Array, BoolArray, Hypothesis, IntArray, Scan

EXPECTED = 0.5  # visibility from which a feature should be in view
_STILL_EXPECTED = 0.1  # … and from which it should if the last scan paired it
_BELIEVED_AGAIN = 2.0  # a lost robot must pair so many times what one that is not lost must
_NEAREST = 1e-9  # [m]
_KNOWN_AFTER = 10  # [scans] in which the sensor has looked no farther to the side than before
_EXPLAINED = 0.5  # fraction of the measurements that, once paired, speaks for the pose whatever should be in view


class Tracker:
    """Counts the scans in a row that are not what the map leads one to expect.

    A feature should be in view if it is established, and either its visibility is at least `EXPECTED`, or the last scan
    that was believed paired it and nothing says that it has gone out of view since. A scan is doubted where

    - too few of the features that should be in view are paired, while most of what is measured is not paired either; or
    - right after a scan that knew its way, hardly anything that is measured is paired.

    Where the prediction does not tell what is in view, a scan that pairs anything is believed: on new ground, where one
    scan pairs less than the one before, a doubt would keep the map from learning what the next scans could be paired
    with. The directions in which anything was measured so far then stand for the view: what the last scan paired and a
    turn has put out of it is not expected. A doubt stands until a scan pairs something.

    So what is new on the map's rim is no reason to doubt as long as it comes into view by and by, and neither is what
    walls are known to hide.

    Arguments:
        fraction: of the expected features, or of the measurements, that must be paired.
        scans: doubted scans in a row after which the robot is lost.
        min_expected: expected features, or measurements, without which nothing is concluded.
    """

    def __init__(self, fraction: float, scans: int, min_expected: int) -> None:
        self.fraction, self.scans, self.min_expected = fraction, scans, min_expected
        self.doubted = 0  # scans in a row
        self.relocations = 0  # how often a lost robot was found again
        self._last_paired: IntArray = np.empty(0, np.int64)
        # (m,) features that the last scan believed was paired with, or UNPAIRED
        self._least_cosine = 1.0  # of the directions of all that was measured so far
        self._looks = 0  # scans since that last fell

    @property
    def lost(self) -> bool:
        """So many scans were doubted that the pose cannot be right."""
        return self.doubted >= self.scans

    @property
    def lost_for(self) -> int:
        """Scans that the robot was lost for before the last one; negative while it is not."""
        return self.doubted - self.scans

    def enough(self, blind: bool) -> tuple[float, bool]:
        """The fraction of the measurements that must be paired so that nothing else needs to be asked.

        No fraction is enough for a robot that is lost. The second result says whether any pairing will do: to a robot
        that is `blind`, to which nothing tells what is in view, the rest may be new ground.
        """
        return (math.inf, False) if self.lost else (max(_EXPLAINED, self.fraction), blind)

    def believes(self, scan: Scan, prediction: Prediction, hypothesis: Hypothesis) -> bool:
        """Whether the scan paired enough to be learned from; counts it as doubted otherwise.

        Chance pairs some now and then, so once lost it takes twice the fraction, and twice the number, to be believed.
        """
        blind = not prediction.has_view
        if blind:
            self.look(scan.points)
        (fraction, any_will_do), measured = self.enough(blind), len(hypothesis.features)
        pairings = _pairings_with(*prediction.counted, prediction.confirmations, hypothesis.features)
        plainly_right = pairings >= fraction * measured or (any_will_do and pairings > 0)
        if plainly_right or not self._misses_too_much(prediction, hypothesis):
            self.accept(hypothesis)
            return True
        self.doubted += 1
        return False

    def look(self, points: Array) -> None:
        """Learn from measurements (m, 2) [m] in R how far the sensor looks to either side."""
        ahead = points[:, 0] / np.maximum(np.hypot(points[:, 0], points[:, 1]), _NEAREST)
        least = float(ahead.min(initial=1.0))
        self._looks = 0 if least < self._least_cosine else self._looks + 1
        self._least_cosine = min(least, self._least_cosine)

    def accept(self, hypothesis: Hypothesis) -> None:
        """The hypothesis holds: tracking goes on from it."""
        self.doubted = 0
        self._last_paired = hypothesis.features.copy()

    def forget(self) -> None:
        """Start over, in another map."""
        self.doubted, self._last_paired = 0, self._last_paired[:0]

    def renumber(self, became: IntArray) -> None:
        """Each of the map's n features `became` (n,) another, or UNPAIRED where it is gone."""
        self._last_paired = np.append(became, UNPAIRED)[self._last_paired]

    def _misses_too_much(self, prediction: Prediction, hypothesis: Hypothesis) -> bool:
        established = ~prediction.provisional
        known, last = set(prediction.features[established].tolist()), set(self._last_paired.tolist())
        expected = set(prediction.features[established & self._should_be_seen(prediction)].tolist())
        still = known & last if prediction.has_view else expected
        paired = known.intersection(hypothesis.features.tolist())
        measured = len(hypothesis.features)
        fraction = self.fraction * (_BELIEVED_AGAIN if self.lost else 1.0)
        missing = len(expected) >= self.min_expected and len(expected & paired) < fraction * len(expected)
        few = measured >= self.min_expected and len(paired) < fraction * measured
        unresolved = self.doubted > 0 and not prediction.has_view
        strange = few and (unresolved or len(still) >= self.min_expected)
        unsure = self.lost and len(expected & paired) < _BELIEVED_AGAIN * self.min_expected
        return (missing and len(paired) < _EXPLAINED * measured) or strange or unsure

    def _should_be_seen(self, prediction: Prediction) -> BoolArray:
        paired = np.isin(prediction.features, self._last_paired)
        visibility = prediction.visibility()
        if visibility is None:
            return paired & self._in_sector(prediction.positions)
        return (visibility >= EXPECTED) | (paired & (visibility >= _STILL_EXPECTED))

    def _in_sector(self, positions: Array) -> BoolArray:
        """(k,) which of the positions (k, 2) in R lie in a direction in which the sensor looks; at first, all."""
        if self._looks < _KNOWN_AFTER:
            return np.ones(len(positions), np.bool_)
        ahead: BoolArray = positions[:, 0] >= self._least_cosine * np.hypot(positions[:, 0], positions[:, 1])
        return ahead


@compiled
def _pairings_with(features: IntArray, sightings: IntArray, confirmations: int, decisions: IntArray) -> int:
    """How many of the decisions (m,) are one of the features (k,) seen so often that they are confirmed."""
    count = 0
    for decision in decisions:
        if decision != UNPAIRED:
            for row in range(len(features)):
                if sightings[row] >= confirmations and features[row] == decision:
                    count += 1
                    break
    return count
