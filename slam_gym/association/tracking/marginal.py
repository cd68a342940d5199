"""Decide by marginals: pair a measurement only where all hypotheses together say so.

JCBB takes the most pairings and `map_hypothesis` the most probable hypothesis, and both commit themselves to every
pairing in it. But a wrong pairing spoils the map, while a refused one is a measurement less. With p_ij the probability
that measurement i is of feature j, over all hypotheses (`marginals`), and a wrong pairing that costs c right ones,
pairing is worth p − c (1 − p): more than nothing where p > τ = c / (c + 1).

What is left unpaired starts a feature where the probability that it is of nothing in the map exceeds the same τ: a
feature that is started beside its own likeness spoils the map as a wrong pairing does. Gates have no say in it, so that
a robot that knows its pose poorly, to whom most of what it sees is compatible with something, still maps what is new
once the other measurements tell where it is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.compatibility import joint_distance, plain
from slam_gym.association.tracking.marginals import Learned, Marginals, marginals
from slam_gym.types import UNPAIRED, Array, BoolArray, Hypothesis, IntArray, Posterior, Prediction, Scan


def marginal(
    scan: Scan,
    prediction: Prediction,
    *,
    cost: float = 10.0,
    detection: float | None = None,
    density: float | None = None,
    unseen: float = 0.05,
    width: int = 100,
    margin: float = 12.0,
    provisional_cost: float | None = None,
    learned: Learned | None = None,
) -> Hypothesis:
    """Every pairing whose marginal probability makes it worth the risk, and every feature that is new as surely.

    All features in reach are candidates, near or not: an alternative that is left out makes the others look certain.
    The `posterior` holds the marginals of the decisions; its probability is that of all decisions together, 0 where the
    search did not come across that hypothesis. `effort.limit_hit` says that the beam's width turned hypotheses away.
    `experience` is for the next prediction of the same run.

    Arguments:
        cost: what a wrong pairing costs, in right ones that are missed, and a duplicate, in new features that are; at
            least 1, so that no feature is paired twice.
        detection: P_D; None: weighed by what the run has shown.
        density: [1/m²] λ of what is not in the map; None: likewise.
        unseen, width, margin: as in `map_hypothesis`.
        provisional_cost: of a wrong pairing with a feature that the map does not believe in yet, which spoils less, and
            has to be paired if it is ever to be believed in; None: `cost`.
        learned: log odds of pairings that the model does not know of (see `association.learned`).

    Raises ValueError as `map_hypothesis`, and for costs that are less than 1 or not finite.
    """
    check_costs(cost, provisional_cost)
    found = marginals(
        scan, prediction, detection=detection, density=density, unseen=unseen, width=width, margin=margin,
        learned=learned,
    )  # fmt: skip
    return decide(scan, prediction, found, cost, provisional_cost)


def check_costs(cost: float, provisional_cost: float | None = None) -> None:
    """Raises ValueError for costs that `marginal` refuses."""
    for name, price in (("cost", cost), ("provisional_cost", provisional_cost)):
        if price is not None and not 1.0 <= price < math.inf:
            raise ValueError(f"{name}: {price} is not a finite number of at least 1")


def decide(
    scan: Scan, prediction: Prediction, found: Marginals, cost: float, provisional_cost: float | None = None
) -> Hypothesis:
    """What `marginal` makes of the hypotheses found."""
    threshold = cost / (cost + 1.0)
    thresholds = np.full(len(prediction), threshold)
    if provisional_cost is not None and prediction.provisional is not None:
        thresholds[prediction.provisional] = provisional_cost / (provisional_cost + 1.0)
    answer = decided(*found[:5], plain(prediction.features), thresholds, threshold)
    rows, features, probabilities, new, runner_up, own, second, total, paired = answer
    return Hypothesis(
        features,
        joint_distance(scan, prediction, rows).squared,
        2 * paired,
        found.effort,
        posterior_of(own, second, total, runner_up, probabilities, found.unpaired),
        new=new,
        experience=found.experience,
    )


def posterior_of(
    own: float, second: float, total: float, runner_up: IntArray, probabilities: Array, unpaired: Array
) -> Posterior:
    """From what `decided` answers, and the probabilities (m,) of nothing in the map."""
    log_density = total + math.log(own) if own > 0.0 else -math.inf
    return Posterior(log_density, own, runner_up, second, marginals=probabilities, unpaired=unpaired)


class _Place(NamedTuple):
    first: int  # of the hypotheses that decide alike; −1: there is none
    weight: float  # of them all


@compiled
def decided(
    hypotheses: IntArray,
    weights: Array,
    log_densities: Array,
    pairings: Array,
    unpaired: Array,
    features: IntArray,
    thresholds: Array,
    threshold: float,
) -> tuple[IntArray, IntArray, Array, BoolArray, IntArray, float, float, float, int]:
    """Row and feature decided for each measurement (m,), its probability, and whether it is new; the features of the
    most probable other decisions; the weights of both, the log of the sum of all densities, and how many are paired.

    `thresholds` (k,) are those of pairing each row, `threshold` that of starting a feature."""
    m, paired = len(unpaired), 0
    rows, probabilities, new = np.full(m, UNPAIRED), unpaired.copy(), np.zeros(m, np.bool_)
    for i in range(m):
        for j in range(pairings.shape[1]):
            if pairings[i, j] > thresholds[j]:
                rows[i], probabilities[i] = j, min(pairings[i, j], 1.0)
        paired += rows[i] != UNPAIRED
        new[i] = rows[i] == UNPAIRED and unpaired[i] > threshold
    own, second = _placed(hypotheses, weights, rows)
    chosen, other = np.full(m, UNPAIRED), np.full(m, UNPAIRED)
    for i in range(m):
        chosen[i] = features[rows[i]] if rows[i] != UNPAIRED else UNPAIRED
        if second.first >= 0 and hypotheses[second.first, i] != UNPAIRED:
            other[i] = features[hypotheses[second.first, i]]
    most = log_densities.max()
    total = most + math.log(np.exp(log_densities - most).sum())
    return rows, chosen, probabilities, new, other, own.weight, second.weight, total, paired


@compiled
def _placed(hypotheses: IntArray, weights: Array, rows: IntArray) -> tuple[_Place, _Place]:
    """The hypotheses that decide `rows`, and the most probable other decisions."""
    own, second, weight = _Place(-1, 0.0), _Place(-1, 0.0), np.zeros(len(weights))
    keys = np.empty(len(weights), np.int64)
    for b in range(len(weights)):
        keys[b], first = _key(hypotheses[b]), b
        for other in range(b):
            if keys[other] == keys[b] and _alike(hypotheses[other], hypotheses[b]):
                first = other
                break
        weight[first] += weights[b]
    for b in range(len(weights)):
        if _alike(hypotheses[b], rows):
            own = _Place(b, weight[b]) if own.first < 0 else own
        elif weight[b] > second.weight:
            second = _Place(b, weight[b])
    return own, second


@compiled
def _key(rows: IntArray) -> int:
    """A number that few other decisions have."""
    key = 0
    for row in rows:
        key = key * 1_000_003 + row
    return key


@compiled
def _alike(rows: IntArray, others: IntArray) -> bool:
    different = 0
    for i in range(len(rows)):
        different += rows[i] != others[i]
    return different == 0
