"""Negative evidence: a feature that should be in view, scan after scan, and is not measured does not exist.

Spurious measurements that agree by chance confirm a feature now and then, and a loop may leave a copy of one. What
gives them away is what later scans do *not* show (Thrun, Burgard and Fox, *Probabilistic Robotics*, 2005, §10.3.3).
"""

import numpy as np

from slam_gym.association.prediction import Prediction
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.types import Hypothesis, IntArray

_EVERY = 5  # [scans] between looks, since visibility casts rays
_FEW = 20  # sightings, above which a feature surely exists
_ABSENT = 4.0  # least expected number of looks that should have shown a feature, from which it may not exist


class NegativeEvidence:
    """Sums the probability that a feature was in view over every fifth scan that did not measure it.

    A confirmed feature does not exist if the sum is at least 4, and at least the number of scans that measured it. The
    robot must know where it is: from a wrong pose, all features seem to be absent.
    """

    def __init__(self) -> None:
        self._absent: dict[int, float] = {}  # the sum, by id of the feature

    def learn(self, number: int, prediction: Prediction, hypothesis: Hypothesis, m: StochasticMap) -> IntArray:
        """Take a scan into account that the map `m` is about to learn from, the `number`th.

        Returns the features (r,) that do not exist; none where the prediction does not tell what is in view.
        """
        features, sightings = prediction.counted
        if number % _EVERY or not prediction.has_view:
            return features[:0]
        least, paired = prediction.confirmations, set(hypothesis.features.tolist())
        known = enumerate(zip(features.tolist(), sightings.tolist()))
        rows = [row for row, (feature, seen) in known if least <= seen <= _FEW and feature not in paired]
        in_view = prediction.visibility(np.array(rows, np.int64))
        assert in_view is not None
        absent = []
        for row, feature, probability in zip(rows, m.ids[features[rows]].tolist(), in_view.tolist()):
            self._absent[feature] = self._absent.get(feature, 0.0) + probability
            if self._absent[feature] >= max(sightings[row], _ABSENT):
                absent.append(features[row])
        return np.array(absent, np.int64)
