"""The most probable hypothesis. JCBB maximises the number of pairings, this associator the density of the hypothesis.

The density is defined in `hypotheses`.
"""

import math

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.prediction import Expected, Prediction, PredictionArrays, in_view_and_facing
from slam_gym.association.tracking import hypotheses
from slam_gym.association.tracking.beam import Beam
from slam_gym.association.tracking.headings import Part
from slam_gym.association.tracking.hypotheses import LimitFields, Limits, PosteriorFields, ScanProblem, SearchResult
from slam_gym.association.tracking.near_first import Decided, Spent, decided, joint_distance_of, offer
from slam_gym.types import UNPAIRED, Array, BoolArray, Hypothesis, Posterior, Scan, ScanArrays

_CLOSE = 1.0 / 3.0  # of the margin: hypotheses this close to the best, in log density, get a view of their own


def map_hypothesis(
    scan: Scan,
    prediction: Prediction,
    *,
    detection: float = 0.9,
    density: float = 0.02,
    width: int = 100,
    margin: float = 25.0,
) -> Hypothesis:
    """The most probable hypothesis that a beam search of the interpretation tree finds.

    Candidates are the pairings within the individual gate whose confidence is ten times as close to 1 as that of the
    prediction, 0.999 for 0.99. No other test is made, because improbable hypotheses have a low density. `posterior`
    holds the density, its fraction of the densities of the final beam, the runner-up, and the marginals.
    `effort.limit_hit` is set where the width of the beam, or the limit of candidates of a measurement, may have
    excluded hypotheses. Localities are used as in `jcbb`.

    Arguments:
        detection: P_D.
        density: [1/m²] λ of spurious measurements and unmapped features together. A pairing less dense than that is
            never made: the default is for sensors that see some ten metres, to a few centimetres.
        width: hypotheses kept at each level.
        margin: a hypothesis whose log density is this much less than that of the best is dropped.

    Raises ValueError as `individual` and `limits_of`; for a detection outside (0, 1) and a density that is not
    positive.
    """
    if not 0.0 < detection < 1.0:
        raise ValueError(f"detection: {detection} is not between 0 and 1")
    if not 0.0 < density < math.inf:
        raise ValueError(f"density: {density} per m² is not positive")
    limits = hypotheses.limits_of(scan, prediction, width, margin)
    answer, posterior = _decide(scan.arrays, prediction.arrays, (float(detection), float(density)), limits)
    return answer.hypothesis(posterior=Posterior(*posterior))


@compiled
def _decide(
    scan: ScanArrays, prediction: PredictionArrays, rates: tuple[float, float], limit_fields: LimitFields
) -> tuple[Decided, PosteriorFields]:
    expected = Expected(*prediction)
    (detection, density), limits, m = rates, Limits(*limit_fields), len(scan[0])
    rows, spent = np.full(m, UNPAIRED), Spent(0, 0, 0, False)
    posterior = 0.0, 1.0, rows, 0.0, np.ones(m), np.ones(m)
    positions, covariances = expected.positions, expected.covariances
    part = Part(0.0, expected.pose[3], positions, covariances, 0.0, expected.across, np.empty((0, 0)))  # all headings
    visible = in_view_and_facing(expected, positions, covariances)
    for search in range(1 if len(expected.counts) == 0 or expected.near.all() else 2):
        offered = offer(scan, prediction, rows, search == 0, limits.gate, limits.most)
        tests = spent.individual_tests + offered.tests
        spent = Spent(spent.nodes, tests, spent.joint_tests, spent.limit_hit)
        if search == 0 or len(offered.pairings.slots) > offered.pairings.fixed:
            levels = hypotheses.levels_of(offered.pairings, offered.starts, limits.gate)
            problem = ScanProblem(part, offered, levels, visible, detection, density)
            width = hypotheses.affordable(limits.width, [problem])
            searched = hypotheses.search_tree(problem, np.empty(0), width, limits.margin)
            limit_hit = spent.limit_hit or searched.cut or bool((np.diff(offered.starts) >= limits.most).any())
            spent = Spent(spent.nodes + searched.nodes, tests, spent.joint_tests + searched.tests, limit_hit)
            fit = searched.fit + math.log(density) * searched.unpaired
            view_terms = _weighed_by_view(expected, problem, searched, fit, _CLOSE * limits.margin)
            sums = hypotheses.weighed(searched.rows, fit, view_terms, np.zeros(1), len(expected.features))
            fixed = rows != UNPAIRED
            rows[:] = searched.rows[np.argmax(sums.scores)]
            posterior = _joint_posterior(posterior, hypotheses.posterior_of(expected, sums, rows), fixed)
        if not (rows == UNPAIRED).any():
            break
    return decided(expected, rows, joint_distance_of(scan, expected, rows), spent), posterior


@compiled
def _joint_posterior(first: PosteriorFields, given: PosteriorFields, fixed: BoolArray) -> PosteriorFields:
    """The posterior of two searches: `given` is that of the second, in which the pairings of `fixed` (m,) hold."""
    log_density, probability, runner_up, runner_up_probability, marginals, unpaired = given
    probability, runner_up_probability = first[1] * probability, first[1] * runner_up_probability
    if first[3] > runner_up_probability:
        runner_up, runner_up_probability = first[2], first[3]
    marginals, unpaired = np.where(fixed, first[4], marginals), np.where(fixed, first[5], unpaired)
    return log_density, probability, runner_up, runner_up_probability, marginals, unpaired


@compiled
def _weighed_by_view(
    expected: Expected, problem: ScanProblem, searched: SearchResult, fit: Array, closeness: float
) -> Array:
    """`weighed_by_view` (b, 1). Hypotheses within `closeness` of the best get a view of their own."""
    beam, detections = searched.beam, np.array([problem.detection])
    view_terms = hypotheses.weighed_by_view(expected, problem, beam, detections, hypotheses.SAME_VIEW)
    if len(problem.visible) > 0 and len(expected.visible) == 0 and expected.view_moves:
        scores = fit + view_terms[:, 0]
        chosen = np.flatnonzero(scores > scores.max() - closeness)
        best_ones = Beam(beam.score[chosen], beam.pairings[chosen], beam.made[chosen], beam.nodes[chosen], beam.joined)
        view_terms[chosen] = hypotheses.weighed_by_view(expected, problem, best_ones, detections, 0.0)
    return view_terms
