"""Decide by marginals: pair a measurement only where all hypotheses together say so.

JCBB takes the most pairings and `map_hypothesis` the most probable hypothesis, and both commit themselves to every
pairing in it. But a wrong pairing spoils the map, while a refused one is a measurement less. With w_H the weight of
hypothesis H, its density (`scan_hypotheses`) over the sum of those of all hypotheses, measurement i is of feature j
with the marginal probability

    p_ij = Σ of w_H over the H that pair i with j.

If a wrong pairing costs c right ones, pairing is worth p − c (1 − p): more than nothing where p > τ = c / (c + 1).

Neither λ nor P_D is known. A priori λ is taken for Γ-distributed, as a₀ unpaired measurements in b₀ m² would leave it,
and P_D for one of a few values; what earlier scans of the run have shown (`Experience`) adds to a and b, and to the
weights of those values. Both are integrated out: a hypothesis that leaves u measurements unpaired, in a scan of area A,
has the density

    N(ν_H; 0, S_H) · Γ(a + u) / (b + A)^(a + u) · Σ over P_D of weight · Π P_D v_j · Π (1 − P_D v_j).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.special import gammaln

from slam_gym._compile import compiled
from slam_gym.association.compatibility import chi2_gate, individual, plain
from slam_gym.association.tracking.beam import Beam
from slam_gym.association.tracking.path import distance_of
from slam_gym.association.tracking.scan_hypotheses import (
    Kept,
    Rates,
    candidate_gate,
    check_search,
    checked_visibility,
    log_densities,
    rows_of,
    search,
    views,
)
from slam_gym.association.tree import Pairings, as_hypothesis, interpretation_tree
from slam_gym.types import UNPAIRED, Array, Experience, Hypothesis, IntArray, Posterior, Prediction, Scan

DETECTIONS = np.array([0.3, 0.5, 0.7, 0.85, 0.95])
"""Values of P_D that are weighed against each other."""

NOTHING_SEEN = Experience(0.0, 0.0, np.zeros(len(DETECTIONS)))
"""What is known before the first scan of a run."""

_UNPAIRED, _AREA = 1.0, 50.0  # a₀, b₀ [m²]: λ is some .02 before anything was seen
_MEMORY = 0.95  # what a scan counts in the next
_MIN_AREA = 1.0  # [m²] of a scan
_TOGETHER = 0.1  # [m] hypotheses that differ by less share what is in view


class Marginals(NamedTuple):
    """The probability of every pairing, over all hypotheses that a search kept."""

    kept: Kept
    weights: Array  # (b,) of the hypotheses, in sum 1
    log_densities: Array  # (b,) of the hypotheses
    pairings: Array  # (c,) p_ij of each candidate pairing
    unpaired: Array  # (m,) probability that each measurement is of nothing in the map
    experience: Experience  # with this scan

    @property
    def rows(self) -> IntArray:
        """(c,) row of the prediction of each candidate pairing."""
        return self.kept.tree.rows[self.kept.tree.pairings.slots]

    @property
    def measured(self) -> IntArray:
        """(c,) its measurement."""
        return self.kept.tree.pairings.measured


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
) -> Hypothesis:
    """Every pairing whose marginal probability makes it worth the risk.

    All features in reach are candidates, near or not: an alternative that is left out makes the others look certain.
    The `posterior` holds the marginals of the decisions; its probability is that of all decisions together, 0 where the
    search did not come across that hypothesis. `effort.limit_hit` says that the beam's width turned hypotheses away.
    `experience` is for the next prediction of the same run.

    Arguments:
        cost: what a wrong pairing costs, in right ones that are missed; at least 1, so that no feature is paired twice.
        detection: P_D; None: weighed by what the run has shown.
        density: [1/m²] λ of what is not in the map; None: likewise.
        unseen, width, margin: as in `map_hypothesis`.

    Raises ValueError as `map_hypothesis`, and for a cost that is less than 1 or not finite.
    """
    if not 1.0 <= cost < math.inf:
        raise ValueError(f"cost: {cost} is not a finite number of at least 1")
    found = marginals(scan, prediction, detection=detection, density=density, unseen=unseen, width=width, margin=margin)
    tree = found.kept.tree
    chosen, probabilities = _decisions(tree.pairings.measured, found.pairings, found.unpaired, cost / (cost + 1.0))
    rows = np.full(len(scan), UNPAIRED)
    rows[tree.pairings.measured[chosen]] = tree.rows[tree.pairings.slots[chosen]]
    answer = as_hypothesis(prediction, rows, distance_of(tree.pairings, chosen), found.kept.effort)
    posterior = _posterior(found, chosen, probabilities, prediction)
    return Hypothesis(
        answer.features, answer.joint_distance, answer.dof, answer.effort, posterior, experience=found.experience
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
) -> Marginals:
    """The probability of every pairing within the gate of `candidate_gate`. Arguments and errors: see `marginal`."""
    check_search(0.5 if detection is None else detection, unseen, width, margin)
    if density is not None and not 0.0 < density < math.inf:
        raise ValueError(f"density: {density} per m² is not positive")
    gate, known = candidate_gate(prediction.confidence), prediction.experience or NOTHING_SEEN
    candidates = individual(scan, prediction, gate)
    tree = interpretation_tree(scan, prediction, candidates)
    area, visibility = _area(scan), checked_visibility(prediction)
    # the search is told one λ and one P_D
    a, b = _UNPAIRED + known.unpaired, _AREA + known.area
    strange = int((candidates.starts[1:] == candidates.starts[:-1]).sum())
    values, weights = (
        (DETECTIONS, plain(known.detections)) if detection is None else (np.array([detection]), np.zeros(1))
    )
    mean = float(np.exp(weights - weights.max()) @ values / np.exp(weights - weights.max()).sum())
    rates = Rates(mean, unseen, (a + strange) / (b + area) if density is None else density)
    kept = search(tree, visibility, rates, chi2_gate(2, gate), width, margin)
    u = np.arange(len(scan) + 1)
    prices: Any = gammaln(a + u) - (a + u) * math.log(b + area) if density is None else u * math.log(density)
    seen = log_densities(tree.pairings, kept.beam, views(kept, visibility, _TOGETHER), values, unseen)
    scores, shares, posterior = _weighed(kept.fit, prices[kept.unpaired], seen, weights)
    unpaired = float(shares @ kept.unpaired)
    experience = Experience(
        _MEMORY * (known.unpaired + unpaired),
        _MEMORY * (known.area + area),
        known.detections if detection is not None or visibility is None else _MEMORY * posterior,
    )
    paired = _paired(tree.pairings, kept.beam, shares)
    left = np.maximum(1.0 - np.bincount(tree.pairings.measured, paired, len(scan)), 0.0)
    return Marginals(kept, shares, scores, paired, left, experience)


def _area(scan: Scan) -> float:
    """[m²] of the box around the measurements."""
    if not len(scan):
        return 0.0
    (left, bottom), (right, top) = scan.points.min(axis=0), scan.points.max(axis=0)
    return max(float((right - left) * (top - bottom)), _MIN_AREA)


def _posterior(found: Marginals, chosen: IntArray, probabilities: Array, prediction: Prediction) -> Posterior:
    """Of the decisions that take the pairings `chosen` (p,)."""
    beam, weights, densities = found.kept.beam, found.weights, found.log_densities
    own, second = _placed(beam, weights, chosen)
    rows = np.full(len(found.unpaired), UNPAIRED) if second < 0 else rows_of(found.kept, second)
    runner_up = as_hypothesis(prediction, rows, 0.0, found.kept.effort).features
    return Posterior(
        -math.inf if own < 0 else float(densities[own]),
        0.0 if own < 0 else float(weights[own]),
        runner_up,
        0.0 if second < 0 else float(weights[second]),
        marginals=probabilities,
        unpaired=found.unpaired,
    )


@compiled
def _weighed(fit: Array, prices: Array, seen: Array, prior: Array) -> tuple[Array, Array, Array]:
    """Of each hypothesis the log density and the weight (b,), P_D summed over; and the log weights of P_D (d,)."""
    hypotheses, values = seen.shape
    scores, by_value = np.empty(hypotheses), np.full(values, -math.inf)
    for b in range(hypotheses):
        scores[b] = -math.inf
        for d in range(values):
            density = fit[b] + prices[b] + seen[b, d] + prior[d]
            scores[b], by_value[d] = np.logaddexp(scores[b], density), np.logaddexp(by_value[d], density)
    weights = np.exp(scores - scores.max())
    return scores, weights / weights.sum(), by_value - by_value.max()


@compiled
def _paired(pairings: Pairings, beam: Beam, weights: Array) -> Array:
    """(c,) sum of the weights of the hypotheses that make each pairing."""
    out = np.zeros(len(pairings.slots))
    for b in range(len(weights)):
        for q in range(beam.pairings[b]):
            out[beam.paths.pairings[b, q]] += weights[b]
    return out


@compiled
def _decisions(measured: IntArray, paired: Array, unpaired: Array, threshold: float) -> tuple[IntArray, Array]:
    """The pairings worth making (p,), and the probability of what is decided of each measurement (m,)."""
    chosen, count, probabilities = np.empty(len(unpaired), np.int64), 0, unpaired.copy()
    for c in range(len(measured)):
        if paired[c] > threshold:
            chosen[count], probabilities[measured[c]] = c, paired[c]
            count += 1
    return chosen[:count], probabilities


@compiled
def _placed(beam: Beam, weights: Array, chosen: IntArray) -> tuple[int, int]:
    """The hypothesis that makes the pairings `chosen` and no others, and the most probable of the others; −1: none."""
    own, second = -1, -1
    for b in range(len(weights)):
        same = beam.pairings[b] == len(chosen)
        for q in range(beam.pairings[b]):
            same = same and (chosen == beam.paths.pairings[b, q]).any()
        if same:
            own = b
        elif second < 0 or weights[b] > weights[second]:
            second = b
    return own, second
