"""Missed loops: the robot is back where it was before, recognises nothing, and maps the place for the second time.

Nothing looks wrong then. New features explain the scans, and D²_H is that of a sound map. What gives a missed loop away
is what the scans do *not* show: features mapped long ago should be in view, and others are paired in their place. Place
recognition then searches the whole map (`places.fusion.close_missed_loop`).
"""

from __future__ import annotations

from collections import deque

import numpy as np

from slam_gym.association.prediction import Prediction
from slam_gym.types import UNPAIRED, Hypothesis

_EVERY = 5  # [scans] between looks, since visibility casts rays for every feature in reach
_LOOKS = 20  # the last so many are judged together
_REPLACED = 2.5  # mean number per look from which a loop is held to be missed; few sound maps of floors reach it
_IN_VIEW = 0.5  # visibility from which a feature should be in view
_OLD = 100  # [steps] since a feature was first seen


class MissedLoops:
    """Counts old features that should be in view and others paired in their place, in every fifth scan learned from.

    Old are established features, first seen more than 100 steps ago, that are neither paired in a recent scan nor local
    to one that was. Without a view or localities the prediction does not tell, and no loop is noticed to be missed.
    """

    def __init__(self) -> None:
        self.missed = False  # since the last reset
        self._replaced: deque[int] = deque(maxlen=_LOOKS)  # number of features in the last looks

    def learn(self, number: int, prediction: Prediction, hypothesis: Hypothesis) -> None:
        """Take a scan into account that the map learns from, the `number`th."""
        if number % _EVERY or not prediction.has_view:
            return
        self._replaced.append(_replaced(prediction, hypothesis))
        if len(self._replaced) == _LOOKS and sum(self._replaced) >= _REPLACED * _LOOKS:
            self.missed = True

    def reset(self) -> None:
        """Forget what was seen: a loop was closed, maps were joined, or another map begins."""
        self.missed = False
        self._replaced.clear()


def _replaced(prediction: Prediction, hypothesis: Hypothesis) -> int:
    """The number of old features that should be in view and are not paired; at most that of the pairings."""
    old = ~prediction.near & ~prediction.provisional & (prediction.ages > _OLD)
    if not old.any():
        return 0
    visibility = prediction.visibility()
    assert visibility is not None
    expected = prediction.features[old & (visibility >= _IN_VIEW)]
    absent = len(expected) - int(np.isin(expected, hypothesis.features).sum())
    return min(absent, int(np.count_nonzero(hypothesis.features != UNPAIRED)))
