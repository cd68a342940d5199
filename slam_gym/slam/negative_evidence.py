"""Negative evidence: what scans do *not* show, although it should be in view.

**Features that do not exist.** Spurious measurements that agree by chance confirm a feature now and then, and a loop
may leave a copy of one. Such a feature should be in view, scan after scan, and is not measured (Thrun, Burgard and Fox,
*Probabilistic Robotics*, 2005, §10.3.3).

**Missed loops.** The robot is back where it was before, recognises nothing, and maps the place for the second time.
Nothing looks wrong then. New features explain the scans, and D²_H is that of a sound map. But features mapped long ago
should be in view, and others are paired in their place. Place recognition then searches the whole map
(`places.fusion.close_missed_loop`). The sign must not be false: a building has places that are alike, and such a search
takes one for the other.
"""

import math
from bisect import bisect
from collections import deque

import numpy as np

from slam_gym.association.prediction import Prediction
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.slam.relocate import Tracker
from slam_gym.types import UNPAIRED, BoolArray, Hypothesis, IntArray

_NO_FEATURES = np.empty(0, np.int64)
_EVERY = 5  # [scans] between looks, since visibility casts rays for every feature in reach
_FEW = 20  # sightings, above which a feature surely exists
_ABSENT = 4.0  # least expected number of looks that should have shown a feature, from which it may not exist
_LOOKS = 20  # the last so many are judged together
_REPLACED = 2.5  # mean number per look from which a loop is held to be missed; few sound maps of floors reach it …
_REPLACED_WITHOUT_VIEW = 0.3  # … and where the view is unknown, since few features count then: sound logs reach 0.2
_IN_VIEW = 0.5  # visibility from which a feature should be in view …
_NEAR_IN_VIEW = 0.9  # … and a near one: in sound maps of rooms, furniture hides many that are less visible
_OLD = 100  # [steps] since a feature was last seen
_SURE = 10  # sightings that a missing feature must have where the view is unknown: people and clutter have fewer
_SQUARE = 0.75  # [m] side of the squares that tell from where a feature was measured
_WELL_INSIDE = 0.85  # fraction of the sector: near its edge, a feature may be out of view


class NegativeEvidence:
    """Looks at every fifth scan learned from for features that it should show, and does not measure.

    **Features that do not exist** are confirmed ones for which the probability that they were in view, summed over the
    scans that did not measure them, is at least 4, and at least the number of scans that measured them. The robot must
    know where it is: from a wrong pose, all features seem to be absent.

    **A loop is missed** where old features are absent, and others are paired in their place. Old are confirmed
    features that were last seen more than 100 steps ago. If the view is known, most of the others are newer: started
    since the absent ones were seen. Where features known for longer are measured, the robot knows the place, and walls
    that it has not explored hide the rest. Where the prediction does not tell what is in view, they were
    also seen in ten scans or more. They should then be in view if one of the looks before measured them from about here
    (within a metre or so), so that no wall hides them, and they lie well inside the sector in which anything was
    measured so far.

    Arguments:
        tracker: knows that sector; None: without a view, no loop is noticed to be missed.
        removes: whether to look for features that do not exist.
    """

    def __init__(self, tracker: Tracker | None, removes: bool) -> None:
        self.missed_loop = False  # since the last reset
        self._tracker, self._removes = tracker, removes
        self._scans = 0  # learned from so far
        self._absent: dict[int, float] = {}  # by id of the feature: sum of the probabilities that it was in view
        self._replaced: deque[int] = deque(maxlen=_LOOKS)  # number of features in the last looks
        self._begun: list[tuple[float, float]] = []  # by look: the step, and the id of the next feature to start
        self._measured_from: set[tuple[int, int, int]] = set()  # id of a feature, and square around it

    def learn(self, prediction: Prediction, hypothesis: Hypothesis, m: StochasticMap) -> IntArray:
        """Take a scan into account that the map `m` is about to learn from.

        Returns the features (r,) that do not exist; none where the prediction does not tell what is in view.
        """
        self._scans += 1
        if self._scans % _EVERY or not (prediction.has_view or self._tracker):
            return _NO_FEATURES
        self._count_replaced(prediction, hypothesis, m)
        return self._nonexistent(prediction, hypothesis, m) if prediction.has_view and self._removes else _NO_FEATURES

    def reset(self) -> None:
        """Forget which features were replaced: a loop was closed, maps were joined, or another map begins."""
        self.missed_loop = False
        self._replaced.clear()

    def _nonexistent(self, prediction: Prediction, hypothesis: Hypothesis, m: StochasticMap) -> IntArray:
        (features, sightings), least = prediction.counted, prediction.confirmations
        known, paired = enumerate(zip(features.tolist(), sightings.tolist())), set(hypothesis.features.tolist())
        rows = [row for row, (feature, seen) in known if least <= seen <= _FEW and feature not in paired]
        in_view = prediction.visibility(np.array(rows, np.int64))
        assert in_view is not None
        absent = []
        for row, feature, probability in zip(rows, m.ids[features[rows]].tolist(), in_view.tolist()):
            self._absent[feature] = self._absent.get(feature, 0.0) + probability
            if self._absent[feature] >= max(sightings[row], _ABSENT):
                absent.append(features[row])
        return np.array(absent, np.int64)

    def _count_replaced(self, prediction: Prediction, hypothesis: Hypothesis, m: StochasticMap) -> None:
        """Count the old features that should be in view while others are paired in their place.

        Where the view is known, others are the newer ones, less those known for longer.
        """
        paired = hypothesis.features[hypothesis.features != UNPAIRED]
        if not prediction.has_view:
            self._measured_from.update(_squares(m, paired))
        old = ~prediction.provisional & (m.step - m.last_seen[prediction.features] > _OLD)
        old &= prediction.has_view | (m.seen[prediction.features] >= _SURE)
        expected = prediction.features[old & self._in_view(prediction, m)] if old.any() else _NO_FEATURES
        absent, others = expected[~np.isin(expected, paired)], len(paired)
        self._begun.append((m.step, m.next_id))
        if prediction.has_view and len(absent):
            unseen_since = float(np.median(m.last_seen[absent]))
            first_new = self._begun[bisect(self._begun, (unseen_since, math.inf), lo=1) - 1][1]
            others = int(np.where(m.ids[paired] >= first_new, 1, -1).sum())
        self._replaced.append(max(min(len(absent), others), 0))
        least = _REPLACED if prediction.has_view else _REPLACED_WITHOUT_VIEW
        if len(self._replaced) == _LOOKS and sum(self._replaced) >= least * _LOOKS:
            self.missed_loop = True

    def _in_view(self, prediction: Prediction, m: StochasticMap) -> BoolArray:
        """(k,) which of the predicted features should be in view."""
        visibility = prediction.visibility()
        if visibility is not None:
            return visibility >= np.where(prediction.near, _NEAR_IN_VIEW, _IN_VIEW)
        assert self._tracker is not None
        in_view = self._tracker.in_sector(prediction.positions, _WELL_INSIDE)
        rows = np.flatnonzero(in_view)
        for row, (feature, x, y) in zip(rows.tolist(), _squares(m, prediction.features[rows])):
            around = {(feature, x + i, y + j) for i in (-1, 0, 1) for j in (-1, 0, 1)}
            in_view[row] = not around.isdisjoint(self._measured_from)
        return in_view


def _squares(m: StochasticMap, features: IntArray) -> list[tuple[int, int, int]]:
    """The id of each feature (k,), and the square of a grid around it in which the robot is."""
    squares = np.floor((m.pose[:2] - m.positions[features]) / _SQUARE).astype(np.int64)
    return [(feature, x, y) for feature, (x, y) in zip(m.ids[features].tolist(), squares.tolist())]
