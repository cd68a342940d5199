"""The probability of every pairing, over all hypotheses that a beam search keeps.

With w_H the weight of hypothesis H, its density (`scan_hypotheses`) over the sum of those of all hypotheses,
measurement i is of feature j with the marginal probability

    p_ij = Σ of w_H over the H that pair i with j.

Neither λ nor P_D is known. A priori λ is taken for Γ-distributed, as a₀ unpaired measurements in b₀ m² would leave it,
and P_D for one of a few values; what earlier scans of the run have shown (`Experience`) adds to a and b, and to the
weights of those values. Both are integrated out: a hypothesis that leaves u measurements unpaired, in a scan of area A,
has the density

    N(ν_H; 0, S_H) · Γ(a + u) / (b + A)^(a + u) · Σ over P_D of weight · Π P_D v_j · Π (1 − P_D v_j).

Nor is the heading, where the wheels are bad: a heading that is too uncertain for the linear prediction is split into
narrow ones (`headings`), and the hypotheses are those in any of them.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.compatibility import Candidates, chi2_gate, individual, plain
from slam_gym.association.tracking.beam import greatest_log_density
from slam_gym.association.tracking.headings import Heading, headings
from slam_gym.association.tracking.near_first import together
from slam_gym.association.tracking.scan_hypotheses import (
    Kept,
    Rates,
    candidate_gate,
    check_search,
    checked_visibility,
    log_densities,
    scan_area,
    search,
    views,
)
from slam_gym.association.tree import Tree, interpretation_tree
from slam_gym.types import UNPAIRED, Array, Effort, Experience, IntArray, Prediction, Scan

DETECTIONS = np.array([0.3, 0.5, 0.7, 0.85, 0.95])
"""Values of P_D that are weighed against each other."""

NOTHING_SEEN = Experience(0.0, 0.0, np.zeros(len(DETECTIONS)))
"""What is known before the first scan of a run."""

UNPAIRED_BEFORE, AREA = 1.0, 50.0  # a₀, b₀ [m²]: λ is some .02 before anything was seen
_MEMORY = 0.95  # what a scan counts in the next
_SURE, _SURELY = np.zeros(1), 1e9  # log weights where P_D is given; [m²] as good as seen where λ is
DOUBT = 4.0  # log density by which hypotheses of another heading may be better than the first look says
FIRST_LOOK = 4  # hypotheses kept where a narrow heading is only tried
TOGETHER = 0.1  # [m] hypotheses that differ by less share what is in view


Learned = Callable[[Tree, Array | None], Array]
"""From a tree and the visibility (k,) of the prediction's features, where it is known, to log odds of each pairing."""


class Marginals(NamedTuple):
    """The probability of every pairing, over all hypotheses that a search kept."""

    hypotheses: IntArray  # (b, m) row of the prediction that each pairs with each measurement, or UNPAIRED
    weights: Array  # (b,) in sum 1
    log_densities: Array  # (b,) unnormalised
    pairings: Array  # (m, k) p_ij
    unpaired: Array  # (m,) probability that each measurement is of nothing in the map
    effort: Effort
    experience: Experience  # with this scan


def marginals(
    scan: Scan,
    prediction: Prediction,
    *,
    detection: float | None = None,
    density: float | None = None,
    unseen: float = 0.05,
    width: int = 100,
    margin: float = 12.0,
    learned: Learned | None = None,
) -> Marginals:
    """The probability of every pairing within the gate of `candidate_gate`. Arguments and errors: see `marginal`.

    `learned` adds what the model does not know.
    """
    check_search(0.5 if detection is None else detection, unseen, width, margin)
    if density is not None and not 0.0 < density < math.inf:
        raise ValueError(f"density: {density} per m² is not positive")
    known, area = prediction.experience or NOTHING_SEEN, scan_area(plain(scan.points))
    belief = _belief(detection, density, len(scan), known, area)
    looks = [_Look.of(scan, heading, belief, unseen, learned) for heading in headings(prediction)]
    parts, margins = _worth_searching(scan, looks, margin)
    kept = [part.search(width, least) for part, least in zip(parts, margins)]
    fit = [part.look.heading.log_weight + one.fit + belief.prices[one.unpaired] for part, one in zip(parts, kept)]
    seen = [
        log_densities(one, views(one, part.visibility, TOGETHER), belief.values, unseen)
        for part, one in zip(parts, kept)
    ]
    hypotheses = _joined([one.rows for one in kept])
    sums = summed(hypotheses, _joined(fit), _joined(seen), belief.weights, len(prediction))
    scores, shares, by_value, pairings, unpaired = sums
    weighed = detection is None and parts[0].visibility is not None
    experience = experience_after(known, unpaired, area, by_value if weighed else None)
    effort = functools.reduce(together, [one.effort for one in kept])
    return Marginals(hypotheses, shares, scores, pairings, unpaired, effort, experience)


def experience_after(known: Experience, unpaired: Array, area: float, by_value: Array | None) -> Experience:
    """With a scan of an `area` [m²] as well, of which `unpaired` (m,) tells; `by_value` (d,) are the log weights of
    P_D, None where nobody can tell."""
    return Experience(
        _MEMORY * (known.unpaired + float(unpaired.sum())),
        _MEMORY * (known.area + area),
        known.detections if by_value is None else _MEMORY * by_value,
    )


class _Belief(NamedTuple):
    """What is taken for true of λ and P_D before the scan."""

    values: Array  # (d,) that P_D may have
    weights: Array  # (d,) log weights of those
    detection: float  # their mean
    unpaired: float  # a, with nothing unpaired in this scan
    area: float  # [m²] b + A
    prices: Array  # (m + 1,) log density of leaving so many measurements unpaired

    def density(self, strange: int) -> float:
        """[1/m²] λ of a scan in which `strange` measurements have no candidate."""
        return (self.unpaired + strange) / self.area


def _belief(detection: float | None, density: float | None, m: int, known: Experience, area: float) -> _Belief:
    """Of a scan of m measurements in `area` [m²]."""
    values, weights = (DETECTIONS, plain(known.detections)) if detection is None else (np.array([detection]), _SURE)
    a, b = UNPAIRED_BEFORE + known.unpaired, AREA + known.area + area
    if density is not None:
        a, b = _SURELY * density, _SURELY
    mean, prices = expected_detections(values, weights, a, b, -1.0 if density is None else density, m)
    return _Belief(values, weights, mean, a, b, prices)


@compiled
def expected_detections(
    values: Array, weights: Array, a: float, b: float, density: float, m: int
) -> tuple[float, Array]:
    """The mean of P_D, and the log density (m + 1,) of leaving so many measurements unpaired; a λ < 0 is not known."""
    odds, prices = np.exp(weights - weights.max()), np.empty(m + 1)
    for u in range(m + 1):
        prices[u] = u * math.log(density) if density > 0.0 else math.lgamma(a + u) - (a + u) * math.log(b)
    return (odds * values).sum() / odds.sum(), prices


class _Look(NamedTuple):
    """What is compatible in one narrow heading, and what a search there is told: one λ, by what has no candidate
    besides, and one P_D."""

    heading: Heading
    candidates: Candidates
    rates: Rates
    gate: float
    strange: int  # measurements without a candidate
    prices: Array  # (m + 1,) of `_Belief`
    learned: Learned | None
    at_most: float  # no hypothesis of the search scores more

    @classmethod
    def of(cls, scan: Scan, heading: Heading, belief: _Belief, unseen: float, learned: Learned | None) -> _Look:
        gate = candidate_gate(heading.prediction.confidence)
        candidates = individual(scan, heading.prediction, gate)
        starts = candidates.starts
        strange = int(np.count_nonzero(starts[1:] == starts[:-1]))
        rates = Rates(belief.detection, unseen, belief.density(strange))
        at_most = heading.log_weight + greatest_score(plain(scan.covariances), starts, rates[:])
        at_most = at_most if learned is None else math.inf
        return cls(heading, candidates, rates, chi2_gate(2, gate), strange, belief.prices, learned, at_most)

    def part(self, scan: Scan) -> _Part:
        prediction = self.heading.prediction
        tree, visibility = interpretation_tree(scan, prediction, self.candidates), checked_visibility(prediction)
        return _Part(self, tree, visibility, _SURE[:0] if self.learned is None else self.learned(tree, visibility))


class _Part(NamedTuple):
    """The search in one narrow heading."""

    look: _Look
    tree: Tree
    visibility: Array | None
    odds: Array  # (c,) learned, of each pairing; or none

    def search(self, width: int, margin: float) -> Kept:
        return search(self.tree, self.visibility, self.look.rates, self.look.gate, width, margin, self.odds)

    def log_density(self, kept: Kept) -> float:
        """The greatest of the hypotheses kept, by the one P_D and what is in view from the predicted pose."""
        look, seen = self.look, _SURE[:0] if self.visibility is None else self.visibility
        found = greatest_density(kept.beam.score, kept.unpaired, look.rates[:], look.strange, look.prices, seen)
        return look.heading.log_weight + found


def _worth_searching(scan: Scan, looks: list[_Look], margin: float) -> tuple[list[_Part], list[float]]:
    """The parts in which a first look finds a hypothesis that is not hopeless beside the best, and the margin of each:
    what is dropped at once scores so much less than the best of all parts."""
    if len(looks) == 1:
        return [looks[0].part(scan)], [margin]
    best, found = -math.inf, []
    for look in sorted(looks, key=lambda look: -look.at_most):
        if look.at_most <= best - margin:
            break
        part = look.part(scan)
        kept = part.search(FIRST_LOOK, margin)
        score = look.heading.log_weight + float(kept.beam.score.max())
        found.append((score, part.log_density(kept), part))
        best = max(best, score)
    most = max(density for _, density, _ in found)
    behind = [most - density - DOUBT for _, density, _ in found]
    chosen = [k for k, (score, _, _) in enumerate(found) if score > best - margin and behind[k] < margin]
    chosen = chosen or [int(np.argmin(behind))]  # a score knows no price of what is compatible with nothing
    return [found[k][2] for k in chosen], [margin - max(behind[k], 0.0) for k in chosen]


@compiled
def greatest_density(
    scores: Array,
    unpaired: IntArray,
    rates: tuple[float, float, float],
    strange: int,
    prices: Array,
    visibility: Array,
) -> float:
    """Of the hypotheses (b,) that a search has kept, by one P_D and what is in view from the predicted pose."""
    (detection, _, density), missed, most = rates, 0.0, -math.inf
    for v in visibility:
        missed += math.log1p(-detection * v)
    for b in range(len(scores)):
        most = max(most, scores[b] - math.log(density) * (unpaired[b] - strange) + prices[unpaired[b]])
    return missed + most


@compiled
def greatest_score(noise: Array, starts: IntArray, rates: tuple[float, float, float]) -> float:
    """What no hypothesis of a search exceeds: the best of each measurement, in view for sure and without an error."""
    detection, _, density = rates
    gain, unpaired, total = math.log(detection) - math.log1p(-detection), math.log(density), 0.0
    for i in range(len(starts) - 1):
        if starts[i + 1] > starts[i]:
            total += max(unpaired, gain + greatest_log_density(noise[i]))
    return total


def _joined(arrays: list[Any]) -> Any:
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)


@compiled
def summed(
    hypotheses: IntArray, fit: Array, seen: Array, prior: Array, features: int
) -> tuple[Array, Array, Array, Array, Array]:
    """Of the hypotheses the log densities and weights (b,), P_D summed over; the log weights of P_D (d,); and the sums
    of the weights of the hypotheses that make each pairing (m, k), and that leave each measurement unpaired (m,)."""
    count, values = seen.shape
    scores, by_value = np.empty(count), np.full(values, -math.inf)
    for b in range(count):
        scores[b] = -math.inf
        for d in range(values):
            density = fit[b] + seen[b, d] + prior[d]
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
    return scores, weights, by_value - by_value.max(), pairings, unpaired
