"""Missed loops: the robot is back where it was before, recognises nothing, and maps the place for the second time.

Nothing looks wrong then. New features explain the scans, and D²_H is that of a sound map. What gives a missed loop away
is what the scans do *not* show: features mapped long ago should be in view, and others are paired in their place. Place
recognition then searches the whole map (`places.fusion.close_missed_loop`).
"""

from collections import deque

import numpy as np

from slam_gym.association.prediction import Prediction
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.slam.relocate import Tracker
from slam_gym.types import UNPAIRED, BoolArray, Hypothesis, IntArray

_EVERY = 5  # [scans] between looks, since visibility casts rays for every feature in reach
_LOOKS = 20  # the last so many are judged together
_REPLACED = 2.5  # mean number per look from which a loop is held to be missed; few sound maps of floors reach it …
_REPLACED_WITHOUT_VIEW = 0.3  # … and where the view is unknown, since few features count then: sound logs reach 0.2
_IN_VIEW = 0.5  # visibility from which a feature should be in view
_OLD = 100  # [steps] since a feature was first seen
_SQUARE = 0.75  # [m] side of the squares that tell from where a feature was measured
_WELL_INSIDE = 0.85  # fraction of the sector: near its edge, a feature may be out of view

Square = tuple[int, int]
"""Of a grid around a feature: the square in which the robot is."""


class MissedLoops:
    """Counts old features that should be in view and others paired in their place, in every fifth scan learned from.

    Old are established features, first seen more than 100 steps ago, that are neither paired in a recent scan nor local
    to one that was; without localities there are none. Where the prediction does not tell what is in view, a feature
    should be if it was measured from about here before (within a metre or so), so that no wall hides it, and lies well
    inside the sector in which anything was measured so far.

    Arguments:
        tracker: knows that sector; None: without a view, no loop is noticed to be missed.
    """

    def __init__(self, tracker: Tracker | None) -> None:
        self.missed = False  # since the last reset
        self._tracker = tracker
        self._replaced: deque[int] = deque(maxlen=_LOOKS)  # number of features in the last looks
        self._measured_from: dict[int, set[Square]] = {}  # by id of the feature

    def learn(self, number: int, prediction: Prediction, hypothesis: Hypothesis, m: StochasticMap) -> None:
        """Take a scan into account that the map `m` is about to learn from, the `number`th."""
        if number % _EVERY or (self._tracker is None and not prediction.has_view):
            return
        if not prediction.has_view:
            paired = hypothesis.features[hypothesis.features != UNPAIRED]
            for feature, square in zip(m.ids[paired].tolist(), _squares(m, paired)):
                self._measured_from.setdefault(feature, set()).add(square)
        old = ~prediction.near & ~prediction.provisional & (prediction.ages > _OLD)
        expected = prediction.features[old & self._in_view(prediction, m)] if old.any() else prediction.features[:0]
        absent = len(expected) - int(np.isin(expected, hypothesis.features).sum())
        self._replaced.append(min(absent, int(np.count_nonzero(hypothesis.features != UNPAIRED))))
        least = _REPLACED if prediction.has_view else _REPLACED_WITHOUT_VIEW
        if len(self._replaced) == _LOOKS and sum(self._replaced) >= least * _LOOKS:
            self.missed = True

    def reset(self) -> None:
        """Forget what was seen: a loop was closed, maps were joined, or another map begins."""
        self.missed = False
        self._replaced.clear()

    def _in_view(self, prediction: Prediction, m: StochasticMap) -> BoolArray:
        """(k,) which of the predicted features should be in view."""
        visibility = prediction.visibility()
        if visibility is not None:
            return visibility >= _IN_VIEW
        assert self._tracker is not None
        in_view = self._tracker.in_sector(prediction.positions, _WELL_INSIDE)
        rows = np.flatnonzero(in_view)
        features = prediction.features[rows]
        for row, feature, (x, y) in zip(rows.tolist(), m.ids[features].tolist(), _squares(m, features)):
            around = {(x + i, y + j) for i in (-1, 0, 1) for j in (-1, 0, 1)}
            in_view[row] = not around.isdisjoint(self._measured_from.get(feature, ()))
        return in_view


def _squares(m: StochasticMap, features: IntArray) -> list[Square]:
    """The square around each of the features (k,)."""
    squares = np.floor((m.pose[:2] - m.positions[features]) / _SQUARE).astype(np.int64)
    return [(x, y) for x, y in squares.tolist()]
