"""Decide by marginals: pair a measurement only where all hypotheses together say so.

JCBB takes the most pairings and `map_hypothesis` the most probable hypothesis, and both commit themselves to every
pairing in it. But a wrong pairing spoils the map, while a refused one is a measurement less. With w_H the weight of
hypothesis H, its density (`hypotheses`) over the sum of those of all hypotheses that a beam search keeps, measurement i
is of feature j with the marginal probability

    p_ij = Σ of w_H over the H that pair i with j,

as in joint probabilistic data association. Where a wrong pairing costs c right ones, pairing is worth p − c (1 − p):
more than nothing where p > τ = c / (c + 1), the decision of minimum risk. What is left unpaired starts a feature where
the probability that it is of nothing in the map exceeds the same τ: a feature that is started beside its own likeness
spoils the map as a wrong pairing does. Gates have no say in it, so that a robot that knows its pose poorly, to whom
most of what it sees is compatible with something, still maps what is new once the other measurements tell where it is.

Neither λ nor P_D is known. A priori λ is taken for Γ-distributed, as a₀ unpaired measurements in b₀ m² would leave it,
and P_D for one of a few values; what earlier scans of the run have shown (`Experience`) adds to a and b, and to the
weights of those values. Both are integrated out: a hypothesis that leaves u measurements unpaired, in a scan of area A,
has the density

    N(ν_H; 0, S_H) · Γ(a + u) / (b + A)^(a + u) · Σ over P_D of weight · Π P_D v_j · Π (1 − P_D v_j).

Nor is the heading, where the wheels are bad: a heading that is too uncertain for the linear prediction is split into
narrow ones (`headings`), and the hypotheses are those in any of them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.compatibility import NO_FAULT, Candidates, Fault, check_fault, gate_pairings
from slam_gym.association.prediction import Expected, Prediction, PredictionArrays, expected_of, visibility
from slam_gym.association.tracking.beam import greatest_log_density
from slam_gym.association.tracking.headings import Part, joint_in, parts_of
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
    scan_area,
    search_tree,
    weighed,
    weighed_by_view,
)
from slam_gym.association.tracking.near_first import Decided, Spent, decided, joint_distance_of
from slam_gym.association.tracking.network import NO_NETWORK, Network, inputs_of, log_odds
from slam_gym.association.tree import Pairings
from slam_gym.types import UNPAIRED, Array, BoolArray, Experience, Hypothesis, IntArray, Posterior, Scan, ScanArrays

DETECTIONS = np.array([0.3, 0.5, 0.7, 0.85, 0.95])
"""Values of P_D that are weighed against each other."""

NOTHING_SEEN = Experience(0.0, 0.0, np.zeros(len(DETECTIONS)))
"""What is known before the first scan of a run."""

UNPAIRED_BEFORE, AREA = 1.0, 50.0  # a₀, b₀ [m²]: λ is some 0.02 before anything was seen
_MEMORY = 0.95  # what a scan counts in the next
_DOUBT = 4.0  # log density by which hypotheses of another heading may be better than the first look says
_FIRST_LOOK = 4  # hypotheses kept where a narrow heading is only tried


class Marginals(NamedTuple):
    """The probabilities behind the decisions."""

    pairings: Array  # (m, k) p_ij
    unpaired: Array  # (m,) that each measurement is of nothing in the map
    new: BoolArray  # (m,) which measurements start a feature
    by_value: Array  # (d,) log weights of P_D
    area: float  # [m²] of the scan


MarginalFields = tuple[Array, Array, BoolArray, Array, float]
"""The same, as they come out of compiled code."""


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
    """Every pairing whose marginal probability makes it worth the risk, and every feature that is new as surely.

    All features in reach are candidates, near or not: an alternative that is left out makes the others look certain.
    The `posterior` holds the marginals of the decisions; its probability is that of all decisions together, 0 where the
    search did not come across that hypothesis. `effort.limit_hit` says that the beam's width turned hypotheses away.
    `experience` is for the next prediction of the same run.

    Arguments:
        cost: what a wrong pairing costs, in right ones that are missed, and a duplicate, in new features that are; at
            least 1, so that no feature is paired twice.
        provisional_cost: of a wrong pairing with a feature that the map does not believe in yet, which spoils less, and
            has to be paired if it is ever to be believed in; None: `cost`.
        width, margin: as in `map_hypothesis`.
        network: adds learned log odds to every pairing (see `learned`).

    Raises ValueError as `check_fault` and `limits_of`, and for costs that are less than 1 or not finite.
    """
    known = prediction.experience or NOTHING_SEEN
    costs = cost, cost if provisional_cost is None else provisional_cost
    answer, (_, unpaired, new, by_value, area), posterior = _searched(scan, prediction, costs, width, margin, network)
    experience = Experience(
        _MEMORY * (known.unpaired + float(unpaired.sum())),
        _MEMORY * (known.area + area),
        _MEMORY * by_value if prediction.has_view else known.detections,
    )
    return answer.hypothesis(posterior=Posterior(*posterior), new=new, experience=experience)


def marginals(
    scan: Scan,
    prediction: Prediction,
    *,
    width: int = 100,
    margin: float = 12.0,
    network: Network = NO_NETWORK,
) -> Marginals:
    """The probabilities that `marginal` decides by. Arguments and errors: see there."""
    answer, told, _ = _searched(scan, prediction, (1.0, 1.0), width, margin, network)
    check_fault(answer.fault)
    return Marginals(*told)


def _searched(
    scan: Scan, prediction: Prediction, costs: tuple[float, float], width: int, margin: float, network: Network
) -> tuple[Decided, MarginalFields, PosteriorFields]:
    """`costs`: of a wrong pairing, then of one that is provisional."""
    for name, price in zip(("cost", "provisional_cost"), costs):
        if not 1.0 <= price < math.inf:
            raise ValueError(f"{name}: {price} is not a finite number of at least 1")
    rule = costs[0] / (costs[0] + 1.0), costs[1] / (costs[1] + 1.0), prediction.confirmations
    limits, past = limits_of(prediction, width, margin), past_of(prediction.experience)
    found: tuple[Decided, MarginalFields, PosteriorFields]
    found = _decide(scan.arrays, prediction.arrays, past, rule, limits, network[:])
    return found


class Past(NamedTuple):
    """What is taken for true of λ and P_D before the scan."""

    unpaired: float  # a
    area: float  # [m²] b, without the scan
    values: Array  # (d,) that P_D may have
    detections: Array  # (d,) log weights of those
    scans: bool  # whether there were any


PastArrays = tuple[float, float, Array, Array, bool]


def past_of(known: Experience | None) -> PastArrays:
    """From what the run has shown."""
    seen = known or NOTHING_SEEN
    return UNPAIRED_BEFORE + seen.unpaired, AREA + seen.area, DETECTIONS, seen.detections, known is not None


class Look(NamedTuple):
    """What is compatible in a narrow heading."""

    part: Part
    candidates: Candidates
    strange: int  # measurements without a candidate
    rates: Rates
    at_most: float  # no hypothesis scores more


class Ready(NamedTuple):
    """A narrow heading, ready for a search."""

    problem: ScanProblem
    tests: int  # pairings tested for individual compatibility
    odds: Array  # (c,) log odds of each pairing, which the model does not know of; (0,): none
    margin: float  # by which a hypothesis may be worse than the best


@compiled
def _decide(
    scan: ScanArrays,
    prediction: PredictionArrays,
    past_arrays: PastArrays,
    rule: tuple[float, float, int],
    limit_arrays: tuple[float, int, float],
    network_arrays: tuple[Array, Array, Array, Array, Array, Array, Array, Array, Array],
) -> tuple[Decided, MarginalFields, PosteriorFields]:
    """`rule`: the probability that pairs, or starts a feature; that which pairs with a provisional feature; and from
    how many sightings a feature is none."""
    expected = expected_of(prediction[0], prediction[1], prediction[2])
    past, limits, network = Past(*past_arrays), Limits(*limit_arrays), Network(*network_arrays)
    threshold, provisional, confirmations = rule
    m, area = len(scan[0]), scan_area(scan[0])
    rows, new, prices = np.full(m, UNPAIRED), np.zeros(m, np.bool_), prices_of(past, area, m)
    looks, fault = looks_of(scan, expected, past, area, limits.gate, len(network.centre) > 0)
    if fault[0] != 0:
        nothing = np.empty(m)
        refused = decided(expected, rows, 0.0, Spent(0, 0, 0, False), fault)
        return refused, (np.empty((m, 0)), nothing, new, past.detections, area), (0.0, 0.0, rows, 0.0, nothing, nothing)
    chosen = _worth_searching(looks, scan, expected, past, limits, prices, network)
    kept = gathered(chosen, m, expected, past, limits, prices)
    crowded, most = np.zeros(m, np.bool_), most_of_each(m)
    for look in looks:
        crowded |= is_crowded(look.candidates.starts, most)
    sums = weighed(kept, past.detections, len(expected.features))
    for i in range(m):
        for j in range(len(expected.features)):
            if sums.pairings[i, j] > (threshold if expected.sightings[j] >= confirmations else provisional):
                rows[i] = j
        new[i] = rows[i] == UNPAIRED and sums.unpaired[i] > threshold and not crowded[i]
    nodes, individual_tests, joint_tests, cut = kept.spent
    spent = Spent(nodes, individual_tests, joint_tests, cut or bool(crowded.any()))
    answer = decided(expected, rows, joint_distance_of(scan, expected, rows), spent, NO_FAULT)
    told = sums.pairings, sums.unpaired, new, sums.by_value, area
    return answer, told, posterior_of(expected, kept.rows, sums, rows)


@compiled
def prices_of(past: Past, area: float, m: int) -> Array:
    """The log density (m + 1,) of leaving so many measurements unpaired, of a scan of an `area` [m²]."""
    prices = np.empty(m + 1)
    for u in range(m + 1):
        prices[u] = math.lgamma(past.unpaired + u) - (past.unpaired + u) * math.log(past.area + area)
    return prices


@compiled
def looks_of(
    scan: ScanArrays, expected: Expected, past: Past, area: float, gate: float, learned: bool
) -> tuple[list[Look], Fault]:
    """What is compatible in every narrow heading; and a fault.

    A search there is told one P_D, the mean, and one λ, by what has no candidate besides.
    """
    points, noise = scan[0], scan[1]
    odds = np.exp(past.detections - past.detections.max())
    detection, fault = (odds * past.values).sum() / odds.sum(), NO_FAULT
    looks: list[Look] = []
    for part in parts_of(expected):
        bad, candidates = gate_pairings(
            points, noise, part.positions, part.covariances, np.arange(len(points)), np.empty(0, np.bool_), gate,
            most_of_each(len(points)),
        )  # fmt: skip
        if bad[0] != 0:
            fault = bad
        strange = int(np.count_nonzero(candidates.starts[1:] == candidates.starts[:-1]))
        rates, at_most = Rates(detection, (past.unpaired + strange) / (past.area + area)), math.inf
        if not learned:
            at_most = part.log_weight + _greatest_score(noise, candidates.starts, rates)
        looks.append(Look(part, candidates, strange, rates, at_most))
    return looks, fault


@compiled
def _greatest_score(noise: Array, starts: IntArray, rates: Rates) -> float:
    """What no hypothesis of a search exceeds: the best of each measurement, in view for sure and without an error."""
    gain, unpaired = math.log(rates.detection) - math.log1p(-rates.detection), math.log(rates.density)
    total = 0.0
    for i in range(len(starts) - 1):
        if starts[i + 1] > starts[i]:
            total += max(unpaired, gain + greatest_log_density(noise[i]))
    return total


@compiled
def problem_of(look: Look, scan: ScanArrays, expected: Expected, gate: float) -> ScanProblem:
    """What a search in a narrow heading takes."""
    part, found = look.part, look.candidates
    visible = visibility(expected, part.positions, part.covariances)[0]
    joint = joint_in(expected, part, found.rows)
    pairings = Pairings(found.slots, found.measured, found.innovations, scan[1], joint, np.empty((0, 0), np.bool_), 0)
    levels = levels_of(pairings, found.starts, gate)
    return ScanProblem(part, pairings, found.starts, levels, found.rows, visible, look.rates)


@compiled
def run_of(past: Past) -> tuple[float, float]:
    """What the learned model is told of the run: log density of what is not in the map; whether there were scans."""
    return math.log(past.unpaired / past.area), 1.0 if past.scans else 0.0


@compiled
def _worth_searching(
    looks: list[Look], scan: ScanArrays, expected: Expected, past: Past, limits: Limits, prices: Array, network: Network
) -> list[Ready]:
    """The headings in which a first look finds a hypothesis that is not hopeless beside the best; at least one."""
    best, margin = -math.inf, limits.margin
    order, score, behind = np.empty(len(looks)), np.empty(len(looks)), np.empty(len(looks))
    found: list[Ready] = []
    for k in range(len(looks)):
        order[k] = -looks[k].at_most
    for k in np.argsort(order, kind="mergesort"):
        look, n = looks[k], len(found)
        if look.at_most <= best - margin:
            break
        problem, odds = problem_of(look, scan, expected, limits.gate), np.empty(0)
        if len(network.centre) > 0:
            inputs = inputs_of(scan, problem, expected, run_of(past))
            odds = log_odds(network, inputs, look.candidates.measured, look.candidates.slots)
        found.append(Ready(problem, look.candidates.tests, odds, margin))
        if len(looks) == 1:
            return found
        kept = search_tree(problem, odds, Limits(limits.gate, _FIRST_LOOK, margin))
        score[n] = look.part.log_weight + kept.beam.score.max()
        behind[n] = -(look.part.log_weight + _greatest_density(kept, look, prices, problem.visible))
        best = max(best, score[n])
    behind = behind[: len(found)] - behind[: len(found)].min() - _DOUBT
    out: list[Ready] = []
    for k in range(len(found)):
        if score[k] > best - margin and behind[k] < margin:
            ready = found[k]
            out.append(Ready(ready.problem, ready.tests, ready.odds, margin - max(behind[k], 0.0)))
    if len(out) == 0:  # a score knows no price of what is compatible with nothing
        out.append(found[np.argmin(behind)])
    return out


@compiled
def _greatest_density(kept: Searched, look: Look, prices: Array, visible: Array) -> float:
    """Of the hypotheses that a search has kept, by one P_D and what is in view from the predicted pose."""
    missed, most = 0.0, -math.inf
    for v in visible:
        missed += math.log1p(-look.rates.detection * v)
    for b in range(len(kept.fit)):
        free = math.log(look.rates.density) * (kept.unpaired[b] - look.strange)
        most = max(most, kept.beam.score[b] - free + prices[kept.unpaired[b]])
    return missed + most


@compiled
def gathered(chosen: list[Ready], m: int, expected: Expected, past: Past, limits: Limits, prices: Array) -> Kept:
    """The hypotheses of all headings that are searched."""
    nodes, tests, joint_tests, cut, count = 0, 0, 0, False, 0
    found: list[Searched] = []
    width = affordable(limits.width, [ready.problem for ready in chosen])
    for ready in chosen:
        kept = search_tree(ready.problem, ready.odds, Limits(limits.gate, width, ready.margin))
        found.append(kept)
        nodes, tests, joint_tests = nodes + kept.nodes, tests + ready.tests, joint_tests + kept.tests
        cut, count = cut or kept.cut, count + len(kept.fit)
    rows, fit, seen, b = np.empty((count, m), np.int64), np.empty(count), np.empty((count, len(past.values))), 0
    for ready, kept in zip(chosen, found):
        last = b + len(kept.fit)
        rows[b:last] = kept.rows
        seen[b:last] = weighed_by_view(expected, ready.problem, kept.beam, past.values, TOGETHER)
        fit[b:last] = ready.problem.part.log_weight + kept.fit + prices[kept.unpaired]
        b = last
    return Kept(rows, fit, seen, Spent(nodes, tests, joint_tests, cut))
