"""The most probable hypothesis: where JCBB asks for the most pairings, this asks for the greatest density.

What the density of a hypothesis is, `hypotheses` says.
"""

from __future__ import annotations

import math

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.compatibility import NO_FAULT
from slam_gym.association.prediction import Expected, Prediction, PredictionArrays, expected_of, visibility
from slam_gym.association.tracking.beam import Beam
from slam_gym.association.tracking.headings import whole
from slam_gym.association.tracking.hypotheses import (
    TOGETHER,
    Kept,
    Limits,
    PosteriorFields,
    Rates,
    ScanProblem,
    Searched,
    affordable,
    is_crowded,
    levels_of,
    limits_of,
    most_of_each,
    posterior_of,
    search_tree,
    weighed,
    weighed_by_view,
)
from slam_gym.association.tracking.near_first import Decided, Spent, decided, is_over, joint_distance_of, offer
from slam_gym.types import UNPAIRED, Array, Hypothesis, Posterior, Scan, ScanArrays

_COUNTS = 1.0 / 3.0  # of the margin: hypotheses less probable than the best by no more have a view of their own


def map_hypothesis(
    scan: Scan,
    prediction: Prediction,
    *,
    detection: float = 0.9,
    density: float = 0.02,
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
        density: [1/m²] λ of spurious measurements and features not mapped yet, together.
        width: hypotheses kept at each level.
        margin: hypotheses this much less probable than the best, in log density, are dropped at once.

    Raises ValueError as `check_fault` and `limits_of`; for a detection outside (0, 1) and a density that is not
    positive.
    """
    if not 0.0 < detection < 1.0:
        raise ValueError(f"detection: {detection} is not between 0 and 1")
    if not 0.0 < density < math.inf:
        raise ValueError(f"density: {density} per m² is not positive")
    limits = limits_of(prediction, width, margin)
    answer, posterior = _decide(scan.arrays, prediction.arrays, (float(detection), float(density)), limits)
    return answer.hypothesis(posterior=Posterior(*posterior))


@compiled
def _decide(
    scan: ScanArrays,
    prediction: PredictionArrays,
    rate_figures: tuple[float, float],
    limit_figures: tuple[float, int, float],
) -> tuple[Decided, PosteriorFields]:
    expected = expected_of(prediction[0], prediction[1], prediction[2])
    rates, limits, m = Rates(*rate_figures), Limits(*limit_figures), len(scan[0])
    rows, spent, fault, most = np.full(m, UNPAIRED), Spent(0, 0, 0, False), NO_FAULT, most_of_each(m)
    posterior, part = (0.0, 1.0, rows, 0.0, np.ones(m), np.ones(m)), whole(expected)
    visible = visibility(expected, part.positions, part.covariances)[0]
    for search in range(2):
        found = offer(scan, expected, rows, search == 0, limits.gate, most)
        fault, tests = found.fault, spent.individual_tests + found.tests
        spent = Spent(spent.nodes, tests, spent.joint_tests, spent.limit_hit)
        if fault[0] == 0 and (search == 0 or len(found.pairings.slots) > found.pairings.fixed):
            levels = levels_of(found.pairings, found.starts, limits.gate)
            problem = ScanProblem(part, found.pairings, found.starts, levels, found.rows, visible, rates)
            width = affordable(limits.width, [problem])
            kept = search_tree(problem, np.empty(0), Limits(limits.gate, width, limits.margin))
            limit_hit = spent.limit_hit or kept.cut or bool(is_crowded(found.starts, most).any())
            spent = Spent(spent.nodes + kept.nodes, tests, spent.joint_tests + kept.tests, limit_hit)
            fit = kept.fit + math.log(rates.density) * kept.unpaired
            seen = _weighed_by_view(expected, problem, kept, fit, _COUNTS * limits.margin)
            sums = weighed(Kept(kept.rows, fit, seen, spent), np.zeros(1), len(expected.features))
            rows[:] = kept.rows[np.argmax(sums.scores)]
            posterior = posterior_of(expected, kept.rows, sums, rows)
        if fault[0] != 0 or is_over(expected, rows):
            break
    return decided(expected, rows, joint_distance_of(scan, expected, rows), spent, fault), posterior


@compiled
def _weighed_by_view(expected: Expected, problem: ScanProblem, kept: Searched, fit: Array, counts: float) -> Array:
    """`weighed_by_view` (b, 1). Hypotheses less probable than the best by more than `counts` may share a view."""
    beam, detections = kept.beam, np.array([problem.rates.detection])
    seen = weighed_by_view(expected, problem, beam, detections, TOGETHER)
    if len(problem.visible) > 0 and len(expected.visible) == 0 and expected.view_moves:
        scores = fit + seen[:, 0]
        chosen = np.flatnonzero(scores > scores.max() - counts)
        fewer = Beam(beam.score[chosen], beam.pairings[chosen], beam.made[chosen], beam.nodes[chosen], beam.joined)
        seen[chosen] = weighed_by_view(expected, problem, fewer, detections, 0.0)
    return seen
