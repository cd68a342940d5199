"""Leave open where the robot is, where a scan does not tell: decisions for each place that it may be at.

`marginal` refuses what is not sure. Where the hypotheses of a scan put the robot at two places it refuses nearly
everything, though each place explains most of the scan, and the next scans may tell which it was. So the hypotheses
that put the robot at one place are taken together as an *alternative*, with the probability of them all; in it,
decisions are made by the marginals of its own hypotheses. Whoever keeps several maps (`slam_gym.slam.deferred`) goes on
with each alternative in a map of its own. Whoever does not, decides as `marginal` does.

Two places are one where a feature of the prediction is, in the median, less than some standard deviations of a
measurement apart: so much the next scan mends, whichever was right.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from slam_gym.association.compatibility import plain
from slam_gym.association.tracking.marginal import check_costs, decide
from slam_gym.association.tracking.marginals import Marginals, marginals
from slam_gym.association.tracking.scan_hypotheses import all_below, moved_by
from slam_gym.types import Array, Hypothesis, IntArray, Prediction, Scan

_MOST = 8  # alternatives


def deferred(
    scan: Scan,
    prediction: Prediction,
    *,
    cost: float = 10.0,
    factor: float = 5.0,
    apart: float = 5.0,
    detection: float | None = None,
    density: float | None = None,
    unseen: float = 0.05,
    width: int = 100,
    margin: float = 12.0,
) -> Hypothesis:
    """What `marginal` decides, with `alternatives`: the decisions at each place that the robot may be at.

    There is always one at least, the most probable first; where it is the only one, it is what `marginal` decides.
    `posterior.probability` of an alternative is its own, `posterior.log_density` that of the scan and the alternative
    together: from map to map these compare.

    Arguments:
        factor: an alternative is no more than so many times less probable than the best.
        apart: standard deviations of a measurement within which two places are one.
        cost, detection, density, unseen, width, margin: as in `marginal`.

    Raises ValueError as `marginal`, for a factor less than 1 and for `apart` that is not positive.
    """
    check_costs(cost)
    if not 1.0 <= factor < math.inf:
        raise ValueError(f"factor: {factor} is not a finite number of at least 1")
    if not apart > 0.0:
        raise ValueError(f"apart: {apart} is not positive")
    found = marginals(
        scan, prediction, detection=detection, density=density, unseen=unseen, width=width, margin=margin
    )  # fmt: skip
    whole = decide(scan, prediction, found, cost)
    places = _places(scan, prediction, found, apart, factor)
    if len(places) == 1:
        return replace(whole, alternatives=(_weighed(whole, found, 1.0),))
    ways = []
    for place in places:
        part = found.some(place)
        ways.append(_weighed(decide(scan, prediction, part, cost), part, float(found.weights[place].sum())))
    return replace(whole, alternatives=tuple(ways))


def _weighed(answer: Hypothesis, found: Marginals, share: float) -> Hypothesis:
    """The decisions as an alternative of that probability."""
    assert answer.posterior is not None
    return replace(answer, posterior=replace(answer.posterior, probability=share, log_density=found.evidence))


def _places(scan: Scan, prediction: Prediction, found: Marginals, apart: float, factor: float) -> list[IntArray]:
    """The hypotheses of each place that is an alternative, the most probable place first."""
    every, features = np.arange(len(found.weights)), np.arange(len(prediction))
    if len(every) == 1 or not len(features) or not len(scan):
        return [every]
    within = apart * math.sqrt(0.5 * float(np.median(np.trace(scan.covariances, axis1=1, axis2=2))))
    if len(found.kept) == 1 and all_below(plain(prediction.covariances), features, (0.5 * within) ** 2):
        return [every]
    at, left, places = _seen_from(prediction, found), np.argsort(-found.weights, kind="stable"), list[IntArray]()
    most = 0.0
    while found.weights[left].sum() * factor >= most and len(left):  # what is left may still hold an alternative
        distances = np.median(np.hypot(*np.moveaxis(at[left] - at[left[0]], 2, 0)), axis=1)
        near = (distances < within) | (left == left[0])
        places.append(np.sort(left[near]))
        most, left = max(most, float(found.weights[places[-1]].sum())), left[~near]
    shares = np.array([found.weights[place].sum() for place in places])
    ranked = np.argsort(-shares, kind="stable")[:_MOST]
    return [places[g] for g in ranked[shares[ranked] * factor >= most].tolist()]


def _seen_from(prediction: Prediction, found: Marginals) -> Array:
    """(b, k, 2) [m] in R: where each hypothesis puts the features of the prediction."""
    parts = []
    for kept in found.kept:
        others = np.ones(len(prediction), np.bool_)
        others[kept.tree.rows] = False
        rows, at = np.concatenate((kept.tree.rows, np.flatnonzero(others))), np.empty((len(kept.fit), len(others), 2))
        at[:, rows] = moved_by(kept, rows).positions
        parts.append(at)
    return np.concatenate(parts)
