"""The most probable hypothesis: where JCBB asks for the most pairings, this asks for the greatest density.

What the density of a hypothesis is, `hypotheses` says.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.compatibility import chi2_gate
from slam_gym.association.prediction import Expected, Prediction, PredictionArrays, expected_of, visibility
from slam_gym.association.tracking.beam import Beam
from slam_gym.association.tracking.headings import Part, whole
from slam_gym.association.tracking.hypotheses import (
    Limits,
    Rates,
    Searched,
    candidate_gate,
    check_search,
    search_tree,
    views,
    weighed_by_view,
)
from slam_gym.association.tracking.near_first import Decided, Offer, Spent, decided, is_over, joint_distance_of, offer
from slam_gym.types import UNPAIRED, Array, Hypothesis, IntArray, Posterior, Scan, ScanArrays

_TOGETHER = 0.1  # [m] hypotheses that differ by less share what is in view …
_COUNTS = 1.0 / 3.0  # … but for those less probable than the best by no more than this fraction of the margin


def map_hypothesis(
    scan: Scan,
    prediction: Prediction,
    *,
    detection: float = 0.9,
    clutter_density: float = 0.01,
    new_density: float = 0.01,
    unseen: float = 0.05,
    width: int = 100,
    margin: float = 25.0,
) -> Hypothesis:
    """The most probable hypothesis that a beam search of the interpretation tree comes across.

    Candidates are the pairings within an individual gate ten times as sure as that of the prediction, 0.999 for 0.99:
    the density itself turns down what is improbable, so no other test is made. `posterior` holds the density, its
    fraction of those of the final beam, the runner-up, and the marginals; `effort.limit_hit` says that the beam's width
    turned hypotheses away. A locality is used as in `jcbb`.

    Arguments:
        detection: P_D.
        clutter_density, new_density: [1/m²] of spurious measurements and of features not mapped yet.
        unseen: least v_j that is believed of a paired feature: what is in view may be mistaken.
        width: hypotheses kept at each level.
        margin: hypotheses this much less probable than the best, in log density, are dropped at once.

    Raises ValueError as `check_fault` and `check_search`; for densities that are negative or both 0.
    """
    check_search(detection, unseen, width, margin)
    clutter, new = clutter_density, new_density
    if not (clutter >= 0.0 and new >= 0.0 and 0.0 < clutter + new < math.inf):
        raise ValueError(f"clutter_density, new_density: {clutter} and {new} per m²: neither negative, not both 0")
    gate = chi2_gate(2, candidate_gate(prediction.confidence))
    rates = float(detection), float(unseen), float(clutter + new)
    answer, best = _decide(scan.arrays, prediction.arrays, rates, (gate, width, float(margin)))
    found = answer.hypothesis()
    posterior = Posterior(
        best.log_density, best.probability, best.runner_up, best.runner_up_probability, best.marginals, best.unpaired
    )
    return Hypothesis(found.features, found.joint_distance, found.dof, found.effort, posterior)


class _Ranking(NamedTuple):
    """The hypotheses of the last search by their density."""

    log_density: float  # of the best
    probability: float  # its fraction of all densities
    runner_up: IntArray  # (m,) map features of the next one
    runner_up_probability: float
    marginals: Array  # (m,) of the decisions of the best
    unpaired: Array  # (m,) that each measurement is of nothing in the map


@compiled
def _decide(
    scan: ScanArrays,
    prediction: PredictionArrays,
    rate_figures: tuple[float, float, float],
    limit_figures: tuple[float, int, float],
) -> tuple[Decided, _Ranking]:
    expected = expected_of(prediction[0], prediction[1], prediction[2])
    rates, limits, m = Rates(*rate_figures), Limits(*limit_figures), len(scan[0])
    part, rows, spent, fault, entry = whole(expected), np.full(m, UNPAIRED), Spent(0, 0, 0, False), 0, -1
    ranking = _Ranking(0.0, 1.0, rows, 0.0, np.ones(m), np.ones(m))
    visible = visibility(expected, part.positions, part.covariances)[0]
    for search in range(2):
        found = offer(scan, expected, rows, search == 0, limits.gate)
        fault, entry = found.fault, found.entry
        tests = spent.individual_tests + found.tests
        spent = Spent(spent.nodes, tests, spent.joint_tests, spent.limit_hit)
        if fault == 0 and (search == 0 or len(found.pairings.slots) > found.pairings.given):
            kept = search_tree(found.pairings, found.starts, found.rows, visible, np.empty(0), rates, limits)
            spent = Spent(spent.nodes + kept.nodes, tests, spent.joint_tests + kept.tests, spent.limit_hit or kept.cut)
            scores = _scores(expected, part, found, kept, visible, rates, _COUNTS * limits.margin)
            ranking = _ranked(expected, kept.rows, scores, rows)
        if fault != 0 or is_over(expected, rows):
            break
    return decided(expected, rows, joint_distance_of(scan, expected, rows), spent, fault, entry), ranking


@compiled
def _scores(
    expected: Expected, part: Part, found: Offer, kept: Searched, visible: Array, rates: Rates, counts: float
) -> Array:
    """Log densities (b,). Hypotheses less probable than the best by more than `counts` may share a view."""
    scores = _log_densities(expected, part, found, kept, visible, rates, _TOGETHER)
    if len(visible) > 0 and len(expected.visible) == 0 and expected.view_moves:
        chosen = np.flatnonzero(scores > scores.max() - counts)
        beam = kept.beam
        fewer = Beam(beam.score[chosen], beam.pairings[chosen], beam.made[chosen], beam.nodes[chosen], beam.joined)
        some = Searched(
            fewer, kept.rows[chosen], kept.fit[chosen], kept.unpaired[chosen], kept.nodes, kept.tests, kept.cut
        )
        scores[chosen] = _log_densities(expected, part, found, some, visible, rates, 0.0)
    return scores


@compiled
def _log_densities(
    expected: Expected, part: Part, found: Offer, kept: Searched, visible: Array, rates: Rates, together: float
) -> Array:
    in_view, _ = views(expected, part, found.pairings, found.rows, kept, visible, together)
    seen = weighed_by_view(kept, found.pairings.slots, in_view, np.array([rates.detection]), rates.unseen)
    return kept.fit + math.log(rates.density) * kept.unpaired + seen[:, 0]


@compiled
def _ranked(expected: Expected, hypotheses: IntArray, scores: Array, rows: IntArray) -> _Ranking:
    """Enter the best hypothesis in `rows` (m,), and rank all of them."""
    order = np.argsort(-scores, kind="mergesort")
    best, m = hypotheses[order[0]], len(rows)
    weights = np.exp(scores - scores[order[0]])
    weights /= weights.sum()
    marginals, unpaired, runner_up = np.zeros(m), np.zeros(m), np.full(m, UNPAIRED)
    for b in range(len(scores)):
        for i in range(m):
            marginals[i] += weights[b] * (hypotheses[b, i] == best[i])
            unpaired[i] += weights[b] * (hypotheses[b, i] == UNPAIRED)
    if len(order) > 1:
        for i in range(m):
            row = hypotheses[order[1], i]
            runner_up[i] = expected.features[row] if row != UNPAIRED else UNPAIRED
    second = weights[order[1]] if len(order) > 1 else 0.0
    for i in range(m):
        rows[i] = best[i]
    return _Ranking(scores[order[0]], weights[order[0]], runner_up, second, marginals, unpaired)
