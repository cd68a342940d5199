"""What a posterior advises a policy that walks the tree: how far each decision is on the right side of its risk."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from slam_gym.association.tracking.marginals import Learned, marginals
from slam_gym.types import Array, Experience, Prediction, Scan

_IMPOSSIBLE = 1e-9
NEVER = math.log(_IMPOSSIBLE)  # log-odds of what is not to be decided


class Advice(NamedTuple):
    """Log-odds by all hypotheses of a scan, less those from which a decision is worth its risk: what is above 0 is what
    `marginal` decides, or `learned`."""

    pairings: Array  # (m, k) of pairing each measurement with each row of the prediction
    new: Array  # (m,) of starting a feature with it, where it is left unpaired
    experience: Experience  # with this scan


Adviser = Callable[[Scan, Prediction], Advice]


def advice(
    scan: Scan,
    prediction: Prediction,
    *,
    cost: float = 10.0,
    provisional_cost: float | None = None,
    learned: Learned | None = None,
) -> Advice:
    """What `marginal` decides by; arguments as it has them."""
    found = marginals(scan, prediction, learned=learned)
    costs = np.full(len(prediction), cost)
    if provisional_cost is not None and prediction.provisional is not None:
        costs[prediction.provisional] = provisional_cost
    return Advice(
        _log_odds(found.pairings) - np.log(costs), _log_odds(found.unpaired) - math.log(cost), found.experience
    )


def _log_odds(probabilities: Array) -> Array:
    p = np.clip(probabilities, _IMPOSSIBLE, 1.0 - _IMPOSSIBLE)
    out: Array = np.log(p) - np.log1p(-p)
    return out
