"""The learned associator: `marginal` with learned log odds added to every pairing.

The search, the joint density of the innovations and the decision by marginals stay what they are. A small network adds
what that model does not know: whether sizes and kinds agree, how much else competes, how often a feature was seen, how
much of the scan is strange. Its weights ship (`slam_gym.weights`); `python -m agents.reproduce associator` trains them.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.compatibility import check_fault, chi2_gate
from slam_gym.association.prediction import Prediction, PredictionArrays, expected_of
from slam_gym.association.tracking.headings import split
from slam_gym.association.tracking.hypotheses import Limits, candidate_gate, scan_area
from slam_gym.association.tracking.marginal import (
    LimitArrays,
    Past,
    PastArrays,
    gathered,
    looks_of,
    made_ready,
    marginal,
    past_of,
    prices_of,
    run_of,
    summed,
)
from slam_gym.association.tracking.network import INPUTS, VERSION, inputs_of, load_network
from slam_gym.types import UNKNOWN_KIND, Array, Hypothesis, IntArray, Scan, ScanArrays

WEIGHTS = "associator"
_UNSEEN = 0.05
_COST, _PROVISIONAL = 10.0, 3.0


def learned_associator(
    scan: Scan,
    prediction: Prediction,
    *,
    cost: float = _COST,
    provisional_cost: float = _PROVISIONAL,
    weights: str | Path = WEIGHTS,
    width: int = 100,
) -> Hypothesis:
    """As `marginal`, which explains costs and `width`; with the log odds of `weights` besides.

    The network knows that what was seen once may be clutter. Probabilities that say so are calibrated, but a robot that
    went by them at full cost would never confirm what is new: hence the lower `provisional_cost`.

    Where nobody can tell what is in view, and no measurement has a size or a kind, there is little but places to go by,
    which `marginal` knows all about: it decides alone, at full cost.

    Raises ValueError as `marginal`, and as `load_network` where there are no such weights.
    """
    if not (prediction.has_view or np.isfinite(scan.sizes).any() or (scan.kinds != UNKNOWN_KIND).any()):
        return marginal(scan, prediction, cost=cost, width=width)
    network = load_network(weights, VERSION, INPUTS)
    provisional = min(cost, provisional_cost)
    return marginal(scan, prediction, cost=cost, provisional_cost=provisional, width=width, network=network)


class Example(NamedTuple):
    """What the network is trained on: the search of one narrow heading without any odds."""

    inputs: Array  # (c, inputs) of each pairing
    measured: IntArray  # (c,) its measurement
    rows: IntArray  # (c,) its row of the prediction
    hypotheses: IntArray  # (b, m) row that each hypothesis pairs with each measurement, or UNPAIRED
    log_densities: Array  # (b,)


def examples(
    scan: Scan,
    prediction: Prediction,
    *,
    width: int,
    margin: float,
    detection: float | None = None,
    density: float | None = None,
) -> list[Example]:
    """What the search of each narrow heading comes across. Raises ValueError as `check_fault`."""
    limits = chi2_gate(2, candidate_gate(prediction.confidence)), width, float(margin)
    parts = len(split(prediction.heading_variance)[0]) if len(prediction) else 1
    past, out = past_of(prediction.experience, detection, density), []
    for part in range(parts):
        example, (fault, entry) = _example(scan.arrays, prediction.arrays, past, limits, part)
        check_fault(fault, entry)
        out.append(example)
    return out


@compiled
def _example(
    scan: ScanArrays, prediction: PredictionArrays, past_arrays: PastArrays, limit_arrays: LimitArrays, number: int
) -> tuple[Example, tuple[int, int]]:
    expected = expected_of(prediction[0], prediction[1], prediction[2])
    past, limits = Past(*past_arrays), Limits(*limit_arrays)
    m, area = len(scan[0]), scan_area(scan[0])
    looks, fault = looks_of(scan, expected, past, area, _UNSEEN, limits.gate, True)
    ready = made_ready(looks[number], scan, expected, limits.margin)
    look = ready.look
    inputs = inputs_of(scan, ready.pairings, look.rows, expected, look.part, ready.visible, run_of(past))
    kept = gathered([ready], m, expected, past, _UNSEEN, limits, prices_of(past, area, m))
    sums = summed(kept, past.detections, len(expected.features))
    return Example(inputs, look.measured, look.rows[look.slots], kept.rows, sums.scores), fault
