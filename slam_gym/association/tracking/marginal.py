"""Decision by marginals: a measurement is paired only where all hypotheses together support the pairing.

JCBB takes the most pairings and `map_hypothesis` the most probable hypothesis, and both make every pairing in it. But a
wrong pairing corrupts the map, while a missed one only loses a measurement. Let w_H be the weight of hypothesis H: its
density (`hypotheses`) divided by the sum over all hypotheses that a beam search keeps. As in joint probabilistic data
association, measurement i comes from feature j with the marginal probability

    p_ij = Σ of w_H over the H that pair i with j.

Where a wrong pairing costs c right ones, pairing has the value p − c (1 − p). The decision of minimum risk is to pair
where this is positive, p > τ = c / (c + 1). An unpaired measurement starts a feature where the probability that it
comes from nothing in the map exceeds the same τ: a duplicate feature corrupts the map as a wrong pairing does. No gate
decides this. So a robot with a poorly known pose, for which most measurements are compatible with some feature, still
maps new features once the other measurements determine the pose.

Neither λ nor P_D is known. A priori, λ is Γ-distributed as after a₀ unpaired measurements in b₀ m², and P_D takes one
of a few values. Earlier scans of the run (`Experience`) add to a and b, and to the log weights of these values. Both
are integrated out: a hypothesis that leaves u measurements unpaired, in a scan of area A, has the density

    N(ν_H; 0, S_H) · Γ(a + u) / (b + A)^(a + u) · Σ over P_D of weight · Π P_D v_j · Π (1 − P_D v_j).

With poor odometry the heading is uncertain too. Where it is too uncertain for the linear prediction it is split into
narrow ones (`headings`), and the hypotheses are those of all of them.
"""

import math
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.compatibility import Candidates, gate_pairings
from slam_gym.association.prediction import Expected, Prediction, PredictionArrays, in_view_and_facing
from slam_gym.association.tracking import hypotheses
from slam_gym.association.tracking.beam import greatest_log_density
from slam_gym.association.tracking.headings import Part, joint_in, parts_of
from slam_gym.association.tracking.hypotheses import LimitFields, Limits, PosteriorFields, ScanProblem, SearchResult
from slam_gym.association.tracking.near_first import Decided, Offer, Spent, decided, joint_distance_of
from slam_gym.association.tracking.network import NO_NETWORK, Network, inputs_of, log_odds
from slam_gym.association.tree import Pairings
from slam_gym.types import UNPAIRED, Array, BoolArray, Experience, Hypothesis, IntArray, Posterior, Scan, ScanArrays

DETECTIONS = np.array([0.3, 0.5, 0.7, 0.85, 0.95])
"""Candidate values of P_D, weighted by their posterior."""

NOTHING_SEEN = Experience(0.0, 0.0, np.zeros(len(DETECTIONS)))
"""The experience before the first scan of a run."""

UNPAIRED_BEFORE, AREA = 1.0, 50.0  # a₀, b₀ [m²]: λ is about 0.02 a priori
_MEMORY = 0.95  # factor by which counts decay from scan to scan
_DOUBT = 4.0  # log density by which a trial search may underestimate the hypotheses of a heading
_TRIAL_WIDTH = 4  # hypotheses kept in the trial search of a narrow heading


class Marginals(NamedTuple):
    """The probabilities on which the decisions are based."""

    pairings: Array  # (m, k) p_ij
    unpaired: Array  # (m,) that each measurement comes from nothing in the map
    new: BoolArray  # (m,) which measurements start a feature
    by_value: Array  # (d,) log weights of P_D
    area: float  # [m²] of the scan


def marginal(
    scan: Scan,
    prediction: Prediction,
    *,
    cost: float = 10.0,
    provisional_cost: float | None = None,
    width: int = 100,
    margin: float = 12.0,
    network: Network = NO_NETWORK,
) -> Hypothesis:
    """Make each pairing whose marginal probability outweighs its risk, and start each feature that is as surely new.

    All features in reach are candidates, near or not: omitting an alternative would make the others look certain. The
    `posterior` holds the marginals of the decisions. Its probability is that of all decisions together, 0 where the
    search did not find that hypothesis. `effort.limit_hit` is set where the width of the beam, or the limit of
    candidates of a measurement, may have excluded hypotheses.
    `experience` is for the next prediction of the same run.

    Arguments:
        cost: of a wrong pairing, in missed right ones, and of a duplicate, in missed new features; at least 1, so that
            no feature is paired twice.
        provisional_cost: of a wrong pairing with a feature that is not confirmed yet. It does less harm, and such a
            feature must be paired to be confirmed. None: `cost`.
        width, margin: as in `map_hypothesis`.
        network: adds learned log odds to every pairing (see `learned`).

    Raises ValueError as `individual` and `limits_of`, and for costs that are less than 1 or not finite.
    """
    past = prediction.experience or NOTHING_SEEN
    costs = cost, cost if provisional_cost is None else provisional_cost
    answer, found, posterior = weigh(scan, prediction, costs, width=width, margin=margin, network=network)
    experience = Experience(
        _MEMORY * (past.unpaired + float(found.unpaired.sum())),
        _MEMORY * (past.area + found.area),
        _MEMORY * found.by_value if prediction.has_view else past.detections,
    )
    return answer.hypothesis(posterior=Posterior(*posterior), new=found.new, experience=experience)


def weigh(
    scan: Scan,
    prediction: Prediction,
    costs: tuple[float, float] = (1.0, 1.0),
    *,
    width: int = 100,
    margin: float = 12.0,
    network: Network = NO_NETWORK,
) -> tuple[Decided, Marginals, PosteriorFields]:
    """The decision of `marginal`, the probabilities on which it is based, and its posterior.

    `costs`: of a wrong pairing, and of a wrong provisional pairing. Other arguments and errors are those of `marginal`.
    """
    for name, price in zip(("cost", "provisional_cost"), costs):
        if not 1.0 <= price < math.inf:
            raise ValueError(f"{name}: {price} is not a finite number of at least 1")
    rule = costs[0] / (costs[0] + 1.0), costs[1] / (costs[1] + 1.0), prediction.confirmations
    limits, prior = hypotheses.limits_of(scan, prediction, width, margin), prior_of(prediction.experience)
    return _decide(scan.arrays, prediction.arrays, prior, rule, limits, network[:])


class Prior(NamedTuple):
    """The prior of λ and P_D for a scan."""

    unpaired: float  # a
    area: float  # [m²] b, without this scan
    values: Array  # (d,) candidate values of P_D
    detections: Array  # (d,) their log weights
    run: tuple[float, float]  # log λ before this scan; 1 where the run has earlier scans: inputs of the network


PriorArrays = tuple[float, float, Array, Array, tuple[float, float]]


def prior_of(experience: Experience | None) -> PriorArrays:
    """The prior after the experience of a run. Raises ValueError for that of another associator."""
    past = experience or NOTHING_SEEN
    if past.detections.shape != DETECTIONS.shape:
        raise ValueError(f"experience.detections: shape {past.detections.shape}, expected {DETECTIONS.shape}")
    unpaired, area = UNPAIRED_BEFORE + past.unpaired, AREA + past.area
    run = math.log(unpaired / area), float(experience is not None)
    return unpaired, area, DETECTIONS, past.detections, run


class HeadingCandidates(NamedTuple):
    """The candidates in a narrow heading."""

    part: Part
    candidates: Candidates
    detection: float  # P_D
    density: float  # [1/m²] λ
    bound: float  # of the score of a hypothesis


HeadingSearch = tuple[ScanProblem, Array, float]
"""The problem of a narrow heading; learned log odds (c,) of its pairings, or (0,); and the margin of its search."""


@compiled
def _decide(
    scan: ScanArrays,
    prediction: PredictionArrays,
    prior_arrays: PriorArrays,
    rule: tuple[float, float, int],
    limit_fields: LimitFields,
    network_arrays: tuple[Array, Array, Array, Array, Array, Array, Array, Array, Array],
) -> tuple[Decided, Marginals, PosteriorFields]:
    """`rule`: the probability above which a pairing is made or a feature started, that for pairing a provisional
    feature, and the number of sightings from which a feature is no longer provisional."""
    expected = Expected(*prediction)
    prior, limits, network = Prior(*prior_arrays), Limits(*limit_fields), Network(*network_arrays)
    threshold, provisional, confirmations = rule
    m, area = len(scan[0]), hypotheses.scan_area(scan[0])
    rows, new, prices = np.full(m, UNPAIRED), np.zeros(m, np.bool_), prices_of(prior, area, m)
    headings = headings_of(scan, expected, prior, area, limits, len(network.centre) > 0)
    searches = _promising(headings, scan, expected, prior, limits, prices, network)
    sums, spent = search_all(searches, m, expected, prior, limits, prices)
    crowded = np.zeros(m, np.bool_)  # measurements with so many candidates that some may have been dropped
    for heading in headings:
        crowded |= np.diff(heading.candidates.starts) >= limits.most
    for i in range(m):
        for j in range(len(expected.features)):
            if sums.pairings[i, j] > (threshold if expected.sightings[j] >= confirmations else provisional):
                rows[i] = j
        new[i] = rows[i] == UNPAIRED and sums.unpaired[i] > threshold and not crowded[i]
    spent = Spent(spent.nodes, spent.individual_tests, spent.joint_tests, spent.limit_hit or bool(crowded.any()))
    marginals = Marginals(sums.pairings, sums.unpaired, new, sums.by_value, area)
    answer = decided(expected, rows, joint_distance_of(scan, expected, rows), spent)
    return answer, marginals, hypotheses.posterior_of(expected, sums, rows)


@compiled
def prices_of(prior: Prior, area: float, m: int) -> Array:
    """Log density (m + 1,) of leaving 0 … m measurements unpaired, for a scan that covers `area` [m²]."""
    prices = np.empty(m + 1)
    for u in range(m + 1):
        prices[u] = math.lgamma(prior.unpaired + u) - (prior.unpaired + u) * math.log(prior.area + area)
    return prices


@compiled
def headings_of(
    scan: ScanArrays, expected: Expected, prior: Prior, area: float, limits: Limits, learned: bool
) -> list[HeadingCandidates]:
    """The candidates in every narrow heading.

    A search in one heading uses a single P_D, the mean, and a single λ, which counts the measurements without a
    candidate.
    """
    points, noise = scan[0], scan[1]
    odds = np.exp(prior.detections - prior.detections.max())
    detection = (odds * prior.values).sum() / odds.sum()
    headings: list[HeadingCandidates] = []
    for part in parts_of(expected):
        features, every_row = (part.positions, part.covariances), np.empty(0, np.bool_)
        candidates = gate_pairings(scan[:2], features, np.arange(len(points)), every_row, limits.gate, limits.most)
        unmatched = int(np.count_nonzero(candidates.starts[1:] == candidates.starts[:-1]))
        density, bound = (prior.unpaired + unmatched) / (prior.area + area), math.inf
        if not learned:  # each measurement takes its best choice, in view and without error
            gain, unpaired, total = math.log(detection) - math.log1p(-detection), math.log(density), 0.0
            for i in range(len(points)):
                if candidates.starts[i + 1] > candidates.starts[i]:
                    total += max(unpaired, gain + greatest_log_density(noise[i]))
            bound = part.log_weight + total
        headings.append(HeadingCandidates(part, candidates, detection, density, bound))
    return headings


@compiled
def problem_of(heading: HeadingCandidates, scan: ScanArrays, expected: Expected, gate: float) -> ScanProblem:
    """The problem of searching a narrow heading."""
    part, candidates = heading.part, heading.candidates
    visible = in_view_and_facing(expected, part.positions, part.covariances)
    joint = joint_in(expected, part, candidates.rows)
    pairings = Pairings(
        candidates.slots, candidates.measured, candidates.innovations, scan[1], joint, np.empty((0, 0), np.bool_), 0
    )
    levels = hypotheses.levels_of(pairings, candidates.starts, gate)
    offer = Offer(pairings, candidates.starts, candidates.rows, candidates.tests)
    return ScanProblem(part, offer, levels, visible, heading.detection, heading.density)


@compiled
def _promising(
    headings: list[HeadingCandidates],
    scan: ScanArrays,
    expected: Expected,
    prior: Prior,
    limits: Limits,
    prices: Array,
    network: Network,
) -> list[HeadingSearch]:
    """The headings in which a trial search finds a hypothesis within the margin of the best; at least one."""
    best, margin = -math.inf, limits.margin
    # behind: by how much the best log density of a trial falls short of that of the best trial, less `_DOUBT`
    order, score, behind = np.empty(len(headings)), np.empty(len(headings)), np.empty(len(headings))
    trials: list[HeadingSearch] = []
    for k in range(len(headings)):
        order[k] = -headings[k].bound
    for k in np.argsort(order, kind="mergesort"):
        heading, n = headings[k], len(trials)
        if heading.bound <= best - margin:
            break
        problem, odds = problem_of(heading, scan, expected, limits.gate), np.empty(0)
        if len(network.centre) > 0:
            inputs = inputs_of(scan, problem, expected, prior.run)
            odds = log_odds(network, inputs, heading.candidates.measured, heading.candidates.slots)
        trials.append((problem, odds, margin))
        if len(headings) == 1:
            return trials
        searched = hypotheses.search_tree(problem, odds, min(_TRIAL_WIDTH, limits.width), margin)
        score[n] = heading.part.log_weight + searched.beam.score.max()
        behind[n] = -(heading.part.log_weight + _greatest_density(searched, problem, prices))
        best = max(best, score[n])
    behind = behind[: len(trials)] - behind[: len(trials)].min() - _DOUBT
    chosen: list[HeadingSearch] = []
    for k in range(len(trials)):
        if score[k] > best - margin and behind[k] < margin:
            problem, odds, _ = trials[k]
            chosen.append((problem, odds, margin - max(behind[k], 0.0)))
    if len(chosen) == 0:  # a score ignores measurements without a candidate
        chosen.append(trials[np.argmin(behind)])
    return chosen


@compiled
def _greatest_density(searched: SearchResult, problem: ScanProblem, prices: Array) -> float:
    """The greatest log density found by a search, with a single P_D and visibility from the predicted pose."""
    missed, greatest, unmatched = 0.0, -math.inf, len(problem.offer.starts) - 1 - len(problem.levels)
    for v in problem.visible:
        missed += math.log1p(-problem.detection * v)
    for b in range(len(searched.fit)):
        free = math.log(problem.density) * (searched.unpaired[b] - unmatched)
        greatest = max(greatest, searched.beam.score[b] - free + prices[searched.unpaired[b]])
    return missed + greatest


@compiled
def search_all(
    searches: list[HeadingSearch], m: int, expected: Expected, prior: Prior, limits: Limits, prices: Array
) -> tuple[hypotheses.Weighed, Spent]:
    """The hypotheses of all chosen headings, and the work done."""
    nodes, tests, joint_tests, cut, count = 0, 0, 0, False, 0
    results: list[SearchResult] = []
    width = hypotheses.affordable(limits.width, [problem for problem, _, _ in searches])
    for problem, odds, margin in searches:
        result = hypotheses.search_tree(problem, odds, width, margin)
        results.append(result)
        nodes, tests, joint_tests = nodes + result.nodes, tests + problem.offer.tests, joint_tests + result.tests
        cut, count = cut or result.cut, count + len(result.fit)
    rows, fit, view_terms, b = np.empty((count, m), np.int64), np.empty(count), np.empty((count, len(prior.values))), 0
    for (problem, _, _), result in zip(searches, results):
        last = b + len(result.fit)
        rows[b:last] = result.rows
        beam, values = result.beam, prior.values
        view_terms[b:last] = hypotheses.weighed_by_view(expected, problem, beam, values, hypotheses.SAME_VIEW)
        fit[b:last] = problem.part.log_weight + result.fit + prices[result.unpaired]
        b = last
    sums = hypotheses.weighed(rows, fit, view_terms, prior.detections, len(expected.features))
    return sums, Spent(nodes, tests, joint_tests, cut)


class Example(NamedTuple):
    """A training example of the network: the search of one narrow heading without learned odds."""

    inputs: Array  # (c, inputs) of each pairing
    measured: IntArray  # (c,) its measurement
    rows: IntArray  # (c,) its row of the prediction
    hypotheses: IntArray  # (b, m) row that each hypothesis pairs with each measurement, or UNPAIRED
    log_densities: Array  # (b,)


def examples(scan: Scan, prediction: Prediction, *, width: int, margin: float) -> list[Example]:
    """The search of each narrow heading. Raises ValueError as `individual`."""
    prior, limits = prior_of(prediction.experience), hypotheses.limits_of(scan, prediction, width, margin)
    return _examples(scan.arrays, prediction.arrays, prior, limits)


@compiled
def _examples(
    scan: ScanArrays, prediction: PredictionArrays, prior_arrays: PriorArrays, limit_fields: LimitFields
) -> list[Example]:
    expected = Expected(*prediction)
    prior, limits = Prior(*prior_arrays), Limits(*limit_fields)
    m, area = len(scan[0]), hypotheses.scan_area(scan[0])
    prices = prices_of(prior, area, m)
    out: list[Example] = []
    for heading in headings_of(scan, expected, prior, area, limits, True):
        candidates, problem = heading.candidates, problem_of(heading, scan, expected, limits.gate)
        sums, _ = search_all([(problem, np.empty(0), limits.margin)], m, expected, prior, limits, prices)
        inputs, rows = inputs_of(scan, problem, expected, prior.run), candidates.rows[candidates.slots]
        out.append(Example(inputs, candidates.measured, rows, sums.hypotheses, sums.scores))
    return out
