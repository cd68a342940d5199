"""The most probable hypothesis: where JCBB asks for the most pairings, this asks for the greatest density.

What the density of a hypothesis is, `scan_hypotheses` says.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from slam_gym.association.compatibility import chi2_gate, joint_distance
from slam_gym.association.tracking.near_first import Found, near_first
from slam_gym.association.tracking.scan_hypotheses import (
    Kept,
    Rates,
    candidate_gate,
    check_search,
    checked_visibility,
    log_densities,
    some,
    views,
)
from slam_gym.association.tracking.scan_hypotheses import search as hypotheses_of
from slam_gym.association.tree import Tree, as_hypothesis
from slam_gym.types import UNPAIRED, Array, Hypothesis, IntArray, Posterior, Prediction, Scan

_TOGETHER = 0.1  # [m] hypotheses that differ by less share what is in view …
_COUNTS = 1.0 / 3.0  # … but for those less probable than the best by no more than this fraction of the margin


class _Ranking(NamedTuple):
    scores: Array  # (b,) log densities, descending
    best: list[IntArray]  # rows (m,) of the best two hypotheses
    marginals: Array  # (m,) of the decisions of the best
    unpaired: Array  # (m,) that each measurement is of nothing in the map


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

    Candidates are the pairings within an individual gate ten times as sure as that of the prediction, .999 for .99: the
    density itself turns down what is improbable, so no other test is made. `posterior` holds the density, its fraction
    of those of the final beam, the runner-up, and the marginals; `effort.limit_hit` says that the beam's width turned
    hypotheses away. A locality is used as in `jcbb`.

    Arguments:
        detection: P_D.
        clutter_density, new_density: [1/m²] of spurious measurements and of features not mapped yet.
        unseen: least v_j that is believed of a paired feature: what is in view may be mistaken.
        width: hypotheses kept at each level.
        margin: hypotheses this much less probable than the best, in log density, are dropped at once.

    Raises ValueError as `individual` does; for probabilities not between 0 and 1, densities that are not positive, a
    width below 1, a margin that is not positive, and a visibility that is no probability.
    """
    check_search(detection, unseen, width, margin)
    _check_densities(clutter_density, new_density)
    visibility, gate = checked_visibility(prediction), candidate_gate(prediction.confidence)
    rates = Rates(detection, unseen, clutter_density + new_density)

    def search(tree: Tree) -> Found[_Ranking]:
        kept = hypotheses_of(tree, visibility, rates, chi2_gate(2, gate), width, margin)
        return _ranked(kept, visibility, rates, _COUNTS * margin)

    found = near_first(scan, prediction, search, gate)
    scores, best, marginals, unpaired = found.extra
    fractions = _fractions(scores)
    distance = joint_distance(scan, prediction, found.rows).squared
    second = as_hypothesis(prediction, best[1], 0.0, found.effort).features
    runner_up = float(fractions[1]) if len(fractions) > 1 else 0.0
    posterior = Posterior(float(scores[0]), float(fractions[0]), second, runner_up, marginals, unpaired)
    return replace(as_hypothesis(prediction, found.rows, distance, found.effort), posterior=posterior)


def _check_densities(clutter: float, new: float) -> None:
    if not (clutter >= 0.0 and new >= 0.0 and 0.0 < clutter + new < math.inf):
        raise ValueError(f"clutter_density, new_density: {clutter} and {new} per m²: neither negative, not both 0")


def _ranked(kept: Kept, visibility: Array | None, rates: Rates, counts: float) -> Found[_Ranking]:
    """The hypotheses by their density. Those less probable than the best by more than `counts` may share a view."""
    scores = _log_densities(kept, visibility, rates, _TOGETHER)
    if visibility is not None and kept.tree.prediction.view_moves:
        chosen = np.flatnonzero(scores > scores.max() - counts)
        scores[chosen] = _log_densities(some(kept, chosen), visibility, rates, 0.0)
    ranking = np.argsort(-scores, kind="stable")
    rows, weights = kept.rows[ranking], _fractions(scores[ranking])
    runner_up = rows[1] if len(rows) > 1 else np.full(kept.rows.shape[1], UNPAIRED)
    marginals, unpaired = weights @ (rows == rows[0]), weights @ (rows == UNPAIRED)
    return Found(rows[0], kept.effort, _Ranking(scores[ranking], [rows[0], runner_up], marginals, unpaired))


def _log_densities(kept: Kept, visibility: Array | None, rates: Rates, together: float) -> Array:
    seen = log_densities(kept, views(kept, visibility, together), np.array([rates.detection]), rates.unseen)
    densities: Array = kept.fit + math.log(rates.density) * kept.unpaired + seen[:, 0]
    return densities


def _fractions(scores: Array) -> Array:
    """(b,) of the densities, descending, in their sum."""
    fractions: Array = np.exp(scores - scores[0])
    fractions /= fractions.sum()
    return fractions
