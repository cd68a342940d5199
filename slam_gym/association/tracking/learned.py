"""The learned associator: `marginal` with learned log odds added to every pairing.

The search, the joint density of the innovations and the decision by marginals are those of `marginal`. A small network
adds evidence that this model ignores: whether sizes and kinds agree, how many pairings compete, how often a feature was
seen, and what fraction of the scan is unexplained. Its weights ship with the package (`slam_gym.weights`); `slam-gym
reproduce associator` trains them.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.prediction import Prediction, PredictionArrays, expected_of
from slam_gym.association.tracking.hypotheses import LimitFields, Limits, limits_of, scan_area, weighed
from slam_gym.association.tracking.marginal import (
    HeadingSearch,
    Prior,
    PriorArrays,
    headings_of,
    marginal,
    prices_of,
    prior_of,
    problem_of,
    search_all,
)
from slam_gym.association.tracking.network import INPUTS, VERSION, inputs_of, load_network
from slam_gym.types import UNKNOWN_KIND, Array, Hypothesis, IntArray, Scan, ScanArrays

WEIGHTS = "associator"
_COST, _PROVISIONAL = 10.0, 3.0


def learned_associator(
    scan: Scan,
    prediction: Prediction,
    *,
    cost: float = _COST,
    provisional_cost: float = _PROVISIONAL,
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
    network = load_network(weights, VERSION, INPUTS)
    provisional = min(cost, provisional_cost)
    return marginal(scan, prediction, cost=cost, provisional_cost=provisional, network=network)


class Example(NamedTuple):
    """A training example of the network: the search of one narrow heading without learned odds."""

    inputs: Array  # (c, inputs) of each pairing
    measured: IntArray  # (c,) its measurement
    rows: IntArray  # (c,) its row of the prediction
    hypotheses: IntArray  # (b, m) row that each hypothesis pairs with each measurement, or UNPAIRED
    log_densities: Array  # (b,)


def examples(scan: Scan, prediction: Prediction, *, width: int, margin: float) -> list[Example]:
    """The search of each narrow heading. Raises ValueError as `individual`."""
    prior, limits = prior_of(prediction.experience), limits_of(scan, prediction, width, margin)
    return _examples(scan.arrays, prediction.arrays, prior, limits)


@compiled
def _examples(
    scan: ScanArrays, prediction: PredictionArrays, prior_arrays: PriorArrays, limit_fields: LimitFields
) -> list[Example]:
    expected = expected_of(prediction[0], prediction[1], prediction[2])
    prior, limits = Prior(*prior_arrays), Limits(*limit_fields)
    m, area = len(scan[0]), scan_area(scan[0])
    prices = prices_of(prior, area, m)
    out: list[Example] = []
    for heading in headings_of(scan, expected, prior, area, limits, True):
        candidates, problem = heading.candidates, problem_of(heading, scan, expected, limits.gate)
        search = HeadingSearch(problem, candidates.tests, np.empty(0), limits.margin)
        kept = search_all([search], m, expected, prior, limits, prices)
        scores = weighed(kept, prior.detections, len(expected.features)).scores
        inputs, rows = inputs_of(scan, problem, expected, prior.run), candidates.rows[candidates.slots]
        out.append(Example(inputs, candidates.measured, rows, kept.rows, scores))
    return out
