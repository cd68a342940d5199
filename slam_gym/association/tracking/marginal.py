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
from slam_gym.association.compatibility import check_fault, chi2_gate, gate_pairings
from slam_gym.association.prediction import Expected, Prediction, PredictionArrays, expected_of, visibility
from slam_gym.association.tracking.beam import greatest_log_density
from slam_gym.association.tracking.headings import Part, joint_in, parts_of
from slam_gym.association.tracking.hypotheses import (
    Limits,
    Rates,
    Searched,
    candidate_gate,
    check_search,
    scan_area,
    search_tree,
    views,
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
_SURE, _SURELY = np.zeros(1), 1e9  # log weights where P_D is given; [m²] as good as seen where λ is
_DOUBT = 4.0  # log density by which hypotheses of another heading may be better than the first look says
_FIRST_LOOK = 4  # hypotheses kept where a narrow heading is only tried
_TOGETHER = 0.1  # [m] hypotheses that differ by less share what is in view


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
        detection: P_D; None: weighed by what the run has shown.
        density: [1/m²] λ of what is not in the map; None: likewise.
        unseen, width, margin: as in `map_hypothesis`.
        provisional_cost: of a wrong pairing with a feature that the map does not believe in yet, which spoils less, and
            has to be paired if it is ever to be believed in; None: `cost`.
        network: adds learned log odds to every pairing (see `learned`).

    Raises ValueError as `check_fault` and `check_search`; for costs that are less than 1 or not finite, and a density
    that is not positive.
    """
    known = prediction.experience or NOTHING_SEEN
    costs = cost, cost if provisional_cost is None else provisional_cost
    answer, told = _marginals(scan, prediction, costs, detection, density, (unseen, width, margin), network)
    found = answer.hypothesis()
    log_density = told.total + math.log(told.own) if told.own > 0.0 else -math.inf
    posterior = Posterior(
        log_density, told.own, told.runner_up, told.second, marginals=told.probabilities, unpaired=told.unpaired
    )
    experience = Experience(
        _MEMORY * (known.unpaired + float(told.unpaired.sum())),
        _MEMORY * (known.area + told.area),
        _MEMORY * told.by_value if detection is None and prediction.has_view else known.detections,
    )
    return Hypothesis(
        found.features, found.joint_distance, found.dof, found.effort, posterior, new=told.new, experience=experience
    )


def marginals(
    scan: Scan,
    prediction: Prediction,
    *,
    detection: float | None = None,
    density: float | None = None,
    unseen: float = 0.05,
    width: int = 100,
    margin: float = 12.0,
    network: Network = NO_NETWORK,
) -> Marginals:
    """The probabilities that `marginal` decides by. Arguments and errors: see there."""
    answer, told = _marginals(scan, prediction, (1.0, 1.0), detection, density, (unseen, width, margin), network)
    check_fault(answer.fault, answer.entry)
    return told


def _marginals(
    scan: Scan,
    prediction: Prediction,
    costs: tuple[float, float],
    detection: float | None,
    density: float | None,
    search: tuple[float, int, float],
    network: Network,
) -> tuple[Decided, Marginals]:
    """Checks the arguments of `marginal`, and searches; `costs` of a wrong pairing, then of one that is provisional."""
    (cost, provisional), (unseen, width, margin) = costs, search
    for name, price in (("cost", cost), ("provisional_cost", provisional)):
        if not 1.0 <= price < math.inf:
            raise ValueError(f"{name}: {price} is not a finite number of at least 1")
    check_search(0.5 if detection is None else detection, unseen, width, margin)
    if density is not None and not 0.0 < density < math.inf:
        raise ValueError(f"density: {density} per m² is not positive")
    rule = cost / (cost + 1.0), provisional / (provisional + 1.0), prediction.confirmations, float(unseen)
    limits = chi2_gate(2, candidate_gate(prediction.confidence)), width, float(margin)
    past = past_of(prediction.experience, detection, density)
    found: tuple[Decided, Marginals] = _decide(scan.arrays, prediction.arrays, past, rule, limits, network[:])
    return found


class Past(NamedTuple):
    """What is taken for true of λ and P_D before the scan."""

    unpaired: float  # a
    area: float  # [m²] b, without the scan
    values: Array  # (d,) that P_D may have
    detections: Array  # (d,) log weights of those
    density: float  # [1/m²] λ that is given, or −1
    scans: bool  # whether there were any


PastArrays = tuple[float, float, Array, Array, float, bool]
RuleArrays = tuple[float, float, int, float]
LimitArrays = tuple[float, int, float]


def past_of(known: Experience | None, detection: float | None = None, density: float | None = None) -> PastArrays:
    """From what the run has shown, and from P_D and λ where they are given."""
    seen = known or NOTHING_SEEN
    values, weights = (DETECTIONS, seen.detections) if detection is None else (np.array([detection]), _SURE)
    if density is not None:
        return _SURELY * density, _SURELY, values, weights, density, known is not None
    return UNPAIRED_BEFORE + seen.unpaired, AREA + seen.area, values, weights, -1.0, known is not None


class Rule(NamedTuple):
    """What decides."""

    threshold: float  # probability that pairs, or starts a feature
    provisional: float  # … that pairs with a feature that is provisional
    confirmations: int  # sightings from which a feature is not
    unseen: float


class Marginals(NamedTuple):
    """The probabilities behind the decisions."""

    pairings: Array  # (m, k) p_ij
    probabilities: Array  # (m,) of each decision
    new: BoolArray  # (m,) which measurements start a feature
    runner_up: IntArray  # (m,) map features of the most probable other decisions
    unpaired: Array  # (m,) that each measurement is of nothing in the map
    by_value: Array  # (d,) log weights of P_D
    own: float  # weight of the hypothesis decided, and of the runner-up
    second: float
    total: float  # log of the sum of all densities
    area: float  # [m²] of the scan


class Look(NamedTuple):
    """What is compatible in a narrow heading."""

    part: Part
    starts: IntArray
    measured: IntArray
    slots: IntArray
    innovations: Array
    rows: IntArray
    tests: int
    strange: int  # measurements without a candidate
    rates: Rates
    at_most: float  # no hypothesis scores more


class Ready(NamedTuple):
    """A narrow heading, ready for a search."""

    look: Look
    pairings: Pairings
    visible: Array  # (k,) or (0,)
    odds: Array  # (c,) learned, or (0,)
    margin: float  # by which a hypothesis may be worse than the best


class Kept(NamedTuple):
    """The hypotheses of all narrow headings."""

    rows: IntArray  # (b, m) row of the prediction that each pairs with each measurement, or UNPAIRED
    fit: Array  # (b,) log density but for what is in view
    seen: Array  # (b, d) what that adds, for each P_D
    spent: Spent


class Summed(NamedTuple):
    """Sums over all hypotheses."""

    scores: Array  # (b,) log densities, P_D summed over
    weights: Array  # (b,) in sum 1
    by_value: Array  # (d,) log weights of P_D
    pairings: Array  # (m, k) p_ij
    unpaired: Array  # (m,) probability that each measurement is of nothing in the map


@compiled
def _decide(
    scan: ScanArrays,
    prediction: PredictionArrays,
    past_arrays: PastArrays,
    rule_arrays: RuleArrays,
    limit_arrays: LimitArrays,
    network_arrays: tuple[Array, Array, Array, Array, Array, Array, Array, Array, Array],
) -> tuple[Decided, Marginals]:
    expected = expected_of(prediction[0], prediction[1], prediction[2])
    past, rule, limits = Past(*past_arrays), Rule(*rule_arrays), Limits(*limit_arrays)
    network, m, area = Network(*network_arrays), len(scan[0]), scan_area(scan[0])
    rows, prices = np.full(m, UNPAIRED), prices_of(past, area, m)
    looks, fault = looks_of(scan, expected, past, area, rule.unseen, limits.gate, len(network.centre) > 0)
    if fault[0] != 0:
        nothing = np.empty(m)
        told = Marginals(np.empty((m, 0)), nothing, rows == rows, rows, nothing, past.detections, 0.0, 0.0, 0.0, area)
        return decided(expected, rows, 0.0, Spent(0, 0, 0, False), fault[0], fault[1]), told
    chosen = _worth_searching(looks, scan, expected, past, limits, prices, network)
    kept = gathered(chosen, m, expected, past, rule.unseen, limits, prices)
    sums = summed(kept, past.detections, len(expected.features))
    told = _by_marginals(kept, sums, expected, rule, area, rows)
    distance = joint_distance_of(scan, expected, rows)
    return decided(expected, rows, distance, kept.spent, 0, -1), told


@compiled
def prices_of(past: Past, area: float, m: int) -> Array:
    """The log density (m + 1,) of leaving so many measurements unpaired, of a scan of an `area` [m²]."""
    prices = np.empty(m + 1)
    for u in range(m + 1):
        if past.density > 0.0:
            prices[u] = u * math.log(past.density)
        else:
            prices[u] = math.lgamma(past.unpaired + u) - (past.unpaired + u) * math.log(past.area + area)
    return prices


@compiled
def looks_of(
    scan: ScanArrays, expected: Expected, past: Past, area: float, unseen: float, gate: float, learned: bool
) -> tuple[list[Look], tuple[int, int]]:
    """What is compatible in every narrow heading, and the fault of a number that is none to work with, and its entry.

    A search there is told one P_D, the mean, and one λ, by what has no candidate besides.
    """
    points, noise = scan[0], scan[1]
    m, every = len(points), np.arange(len(points))
    odds = np.exp(past.detections - past.detections.max())
    detection, fault = (odds * past.values).sum() / odds.sum(), (0, -1)
    seen = past.area if past.density > 0.0 else past.area + area
    looks: list[Look] = []
    parts = parts_of(expected)
    for k in range(len(parts)):
        part = parts[k]
        number, entry, starts, measured, slots, _, innovations, rows, tests = gate_pairings(
            points, noise, part.positions, part.covariances, every, np.empty(0, np.bool_), gate
        )
        if number != 0:
            fault = (number, entry)
        strange = 0
        for i in range(m):
            strange += starts[i] == starts[i + 1]
        rates, at_most = Rates(detection, unseen, (past.unpaired + strange) / seen), math.inf
        if not learned:
            at_most = part.log_weight + _greatest_score(noise, starts, rates)
        looks.append(Look(part, starts, measured, slots, innovations, rows, tests, strange, rates, at_most))
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
def made_ready(look: Look, scan: ScanArrays, expected: Expected, margin: float) -> Ready:
    """What a search in a narrow heading takes; no odds are learned."""
    part = look.part
    visible = visibility(expected, part.positions, part.covariances)[0]
    joint = joint_in(expected, part, look.rows)
    pairings = Pairings(look.slots, look.measured, look.innovations, scan[1], joint, np.empty((0, 0), np.bool_), 0)
    return Ready(look, pairings, visible, np.empty(0), margin)


@compiled
def _with_odds(ready: Ready, scan: ScanArrays, expected: Expected, past: Past, network: Network) -> Ready:
    """The same with the log odds of a network."""
    look, p, visible = ready.look, ready.pairings, ready.visible
    inputs = inputs_of(scan, p, look.rows, expected, look.part, visible, run_of(past))
    return Ready(look, p, visible, log_odds(network, inputs, look.measured, look.slots), ready.margin)


@compiled
def run_of(past: Past) -> tuple[float, float]:
    """What the learned model is told of the run: log density of what is not in the map; whether there were scans."""
    return math.log(past.unpaired / past.area), 1.0 if past.scans else 0.0


@compiled
def _searched(ready: Ready, limits: Limits) -> Searched:
    look = ready.look
    return search_tree(ready.pairings, look.starts, look.rows, ready.visible, ready.odds, look.rates, limits)


@compiled
def _worth_searching(
    looks: list[Look], scan: ScanArrays, expected: Expected, past: Past, limits: Limits, prices: Array, network: Network
) -> list[Ready]:
    """The headings in which a first look finds a hypothesis that is not hopeless beside the best."""
    best, margin = -math.inf, limits.margin
    order, score, density = np.empty(len(looks)), np.empty(len(looks)), np.empty(len(looks))
    found: list[Ready] = []
    for k in range(len(looks)):
        order[k] = -looks[k].at_most
    for k in np.argsort(order, kind="mergesort"):
        look = looks[k]
        if look.at_most <= best - margin:
            break
        ready, n = made_ready(look, scan, expected, margin), len(found)
        if len(network.centre) > 0:
            ready = _with_odds(ready, scan, expected, past, network)
        found.append(ready)
        if len(looks) == 1:
            return found
        kept = _searched(ready, Limits(limits.gate, _FIRST_LOOK, margin))
        weight = look.part.log_weight
        score[n] = weight + kept.beam.score.max()
        density[n] = weight + _greatest_density(kept, look, prices, ready.visible)
        best = max(best, score[n])
    return _chosen(found, score, density, best, margin)


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
def _chosen(found: list[Ready], score: Array, density: Array, best: float, margin: float) -> list[Ready]:
    """Those that a first look finds not hopeless beside the best; at least one of them, if there are any."""
    behind = np.full(len(found), -_DOUBT)
    for k in range(len(found)):
        behind[k] += density[: len(found)].max() - density[k]
    out: list[Ready] = []
    least = int(np.argmin(behind))
    for k in range(len(found)):
        if score[k] > best - margin and behind[k] < margin:
            out.append(with_margin(found[k], margin - max(behind[k], 0.0)))
    if len(out) == 0:  # a score knows no price of what is compatible with nothing
        out.append(with_margin(found[least], margin - max(behind[least], 0.0)))
    return out


@compiled
def with_margin(ready: Ready, margin: float) -> Ready:
    """The same, searched with another margin."""
    return Ready(ready.look, ready.pairings, ready.visible, ready.odds, margin)


@compiled
def gathered(
    chosen: list[Ready], m: int, expected: Expected, past: Past, unseen: float, limits: Limits, prices: Array
) -> Kept:
    """The hypotheses of all headings that are searched."""
    nodes, tests, joint_tests, cut, count = 0, 0, 0, False, 0
    found: list[Searched] = []
    seen: list[Array] = []
    for k in range(len(chosen)):
        ready = chosen[k]
        look = ready.look
        kept = _searched(ready, Limits(limits.gate, limits.width, ready.margin))
        in_view, _ = views(expected, look.part, ready.pairings, look.rows, kept, ready.visible, _TOGETHER)
        seen.append(weighed_by_view(kept, ready.pairings.slots, in_view, past.values, unseen))
        found.append(kept)
        nodes, tests, joint_tests = nodes + kept.nodes, tests + look.tests, joint_tests + kept.tests
        cut, count = cut or kept.cut, count + len(kept.fit)
    rows, fit, by_view, b = np.empty((count, m), np.int64), np.empty(count), np.empty((count, len(past.values))), 0
    for k in range(len(found)):
        log_weight = chosen[k].look.part.log_weight
        for h in range(len(found[k].fit)):
            rows[b], by_view[b] = found[k].rows[h], seen[k][h]
            fit[b] = log_weight + found[k].fit[h] + prices[found[k].unpaired[h]]
            b += 1
    return Kept(rows, fit, by_view, Spent(nodes, tests, joint_tests, cut))


@compiled
def summed(kept: Kept, prior: Array, features: int) -> Summed:
    """The probability of every pairing, over all hypotheses and all values of P_D."""
    hypotheses, (count, values) = kept.rows, kept.seen.shape
    scores, by_value = np.empty(count), np.full(values, -math.inf)
    for b in range(count):
        scores[b] = -math.inf
        for d in range(values):
            density = kept.fit[b] + kept.seen[b, d] + prior[d]
            scores[b], by_value[d] = np.logaddexp(scores[b], density), np.logaddexp(by_value[d], density)
    weights = np.exp(scores - scores.max())
    weights /= weights.sum()
    pairings, unpaired = np.zeros((hypotheses.shape[1], features)), np.zeros(hypotheses.shape[1])
    for b in range(count):
        for i in range(hypotheses.shape[1]):
            if hypotheses[b, i] == UNPAIRED:
                unpaired[i] += weights[b]
            else:
                pairings[i, hypotheses[b, i]] += weights[b]
    return Summed(scores, weights, by_value - by_value.max(), pairings, unpaired)


@compiled
def _by_marginals(kept: Kept, sums: Summed, expected: Expected, rule: Rule, area: float, rows: IntArray) -> Marginals:
    """Enter in `rows` (m,) what is worth pairing; the probabilities behind that."""
    m, pairings = len(rows), sums.pairings
    probabilities, new = sums.unpaired.copy(), np.zeros(m, np.bool_)
    for i in range(m):
        for j in range(pairings.shape[1]):
            established = expected.sightings[j] >= rule.confirmations
            if pairings[i, j] > (rule.threshold if established else rule.provisional):
                rows[i], probabilities[i] = j, min(pairings[i, j], 1.0)
        new[i] = rows[i] == UNPAIRED and sums.unpaired[i] > rule.threshold
    (_, own), (second, weight) = _placed(kept.rows, sums.weights, rows)
    runner_up = np.full(m, UNPAIRED)
    for i in range(m):
        if second >= 0 and kept.rows[second, i] != UNPAIRED:
            runner_up[i] = expected.features[kept.rows[second, i]]
    most = sums.scores.max()
    total = most + math.log(np.exp(sums.scores - most).sum())
    return Marginals(pairings, probabilities, new, runner_up, sums.unpaired, sums.by_value, own, weight, total, area)


@compiled
def _placed(hypotheses: IntArray, weights: Array, rows: IntArray) -> tuple[tuple[int, float], tuple[int, float]]:
    """The first hypothesis that decides `rows`, and the weight of all that do; the same of the most probable other
    decisions; −1 where there is none."""
    own, second, weight = (-1, 0.0), (-1, 0.0), np.zeros(len(weights))
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
            own = (b, weight[b]) if own[0] < 0 else own
        elif weight[b] > second[1]:
            second = (b, weight[b])
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
