"""The learned associator: `marginal` with learned log odds added to every pairing.

The search, the joint density of the innovations and the decision by marginals are those of `marginal`. A small network
adds evidence that this model ignores: whether sizes and kinds agree, how many pairings compete, how often a feature was
seen, and what fraction of the scan is unexplained. Its weights ship with the package (`slam_gym.weights`); `slam-gym
reproduce associator` trains them.
"""

from pathlib import Path

import numpy as np

from slam_gym.association.prediction import Prediction
from slam_gym.association.tracking.marginal import marginal
from slam_gym.association.tracking.network import load_network
from slam_gym.types import UNKNOWN_KIND, Hypothesis, Scan

WEIGHTS = "associator"


def learned_associator(
    scan: Scan,
    prediction: Prediction,
    *,
    cost: float = 10.0,
    provisional_cost: float = 3.0,
    weights: str | Path = WEIGHTS,
) -> Hypothesis:
    """The associator `marginal`, which explains the costs, with the log odds of `weights` added.

    The network has learned that features seen only once may be clutter. Its probabilities are calibrated, but at full
    cost a robot would never confirm new features: hence the lower `provisional_cost`.

    Where visibility is unknown and no measurement has a size or a kind, positions are nearly the only evidence, and
    `marginal` already models them. It then decides alone, at full cost.

    Raises ValueError as `marginal`, and as `load_network` where there are no such weights.
    """
    if not (prediction.has_view or np.isfinite(scan.size_variances).any() or (scan.kinds != UNKNOWN_KIND).any()):
        return marginal(scan, prediction, cost=cost)
    provisional = min(cost, provisional_cost)
    return marginal(scan, prediction, cost=cost, provisional_cost=provisional, network=load_network(weights))
