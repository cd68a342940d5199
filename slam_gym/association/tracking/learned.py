"""The learned associator: `marginal` with learned log odds added to every pairing.

The search, the joint density of the innovations and the decision by marginals stay what they are. A small network adds
what that model does not know: whether sizes and kinds agree, how much else competes, how often a feature was seen, how
much of the scan is strange. Its weights ship (`slam_gym.weights`); `slam-gym reproduce associator` trains them.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.compatibility import Fault, check_fault
from slam_gym.association.prediction import Prediction, PredictionArrays, expected_of
from slam_gym.association.tracking.hypotheses import Limits, limits_of, scan_area, weighed
from slam_gym.association.tracking.marginal import (
    Past,
    PastArrays,
    Ready,
    gathered,
    looks_of,
    marginal,
    past_of,
    prices_of,
    problem_of,
    run_of,
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
    """As `marginal`, which explains costs; with the log odds of `weights` besides.

    The network knows that what was seen once may be clutter. Probabilities that say so are calibrated, but a robot that
    went by them at full cost would never confirm what is new: hence the lower `provisional_cost`.

    Where nobody can tell what is in view, and no measurement has a size or a kind, there is little but places to go by,
    which `marginal` knows all about: it decides alone, at full cost.

    Raises ValueError as `marginal`, and as `load_network` where there are no such weights.
    """
    if not (prediction.has_view or np.isfinite(scan.sizes).any() or (scan.kinds != UNKNOWN_KIND).any()):
        return marginal(scan, prediction, cost=cost)
    network = load_network(weights, VERSION, INPUTS)
    provisional = min(cost, provisional_cost)
    return marginal(scan, prediction, cost=cost, provisional_cost=provisional, network=network)


class Example(NamedTuple):
    """What the network is trained on: the search of one narrow heading without any odds."""

    inputs: Array  # (c, inputs) of each pairing
    measured: IntArray  # (c,) its measurement
    rows: IntArray  # (c,) its row of the prediction
    hypotheses: IntArray  # (b, m) row that each hypothesis pairs with each measurement, or UNPAIRED
    log_densities: Array  # (b,)


def examples(scan: Scan, prediction: Prediction, *, width: int, margin: float) -> list[Example]:
    """What the search of each narrow heading comes across. Raises ValueError as `check_fault`."""
    past, limits = past_of(prediction.experience), limits_of(prediction, width, margin)
    out: list[Example] = []
    parts = 1
    while len(out) < parts:
        example, parts, fault = _example(scan.arrays, prediction.arrays, past, limits, len(out))
        check_fault(fault)
        out.append(example)
    return out


@compiled
def _example(
    scan: ScanArrays,
    prediction: PredictionArrays,
    past_arrays: PastArrays,
    limit_arrays: tuple[float, int, float],
    number: int,
) -> tuple[Example, int, Fault]:
    """That of one narrow heading, by its number, and how many there are."""
    expected = expected_of(prediction[0], prediction[1], prediction[2])
    past, limits = Past(*past_arrays), Limits(*limit_arrays)
    m, area = len(scan[0]), scan_area(scan[0])
    looks, fault = looks_of(scan, expected, past, area, limits.gate, True)
    look = looks[number]
    problem = problem_of(look, scan, expected, limits.gate)
    inputs = inputs_of(scan, problem, expected, run_of(past))
    ready = Ready(problem, look.candidates.tests, np.empty(0), limits.margin)
    kept = gathered([ready], m, expected, past, limits, prices_of(past, area, m))
    scores = weighed(kept, past.detections, len(expected.features)).scores
    found = look.candidates
    return Example(inputs, found.measured, found.rows[found.slots], kept.rows, scores), len(looks), fault
