"""The most probable hypothesis: where JCBB asks for the most pairings, this asks for the greatest density.

A hypothesis H over a scan has the density (up to a constant)

    N(ν_H; 0, S_H) · λ^unpaired · Π over paired j of P_D v_j · Π over the other predicted j of (1 − P_D v_j)

with λ [1/m²] the density of what is not in the map, clutter and new features together, P_D the probability that the
detector reports a feature in view, and v_j the probability that feature j is in view from where the hypothesis itself
puts the robot (`Prediction.visibility`), or from the predicted pose where the view does not move (`view_moves`). Where
nobody can tell, nothing is concluded from what was not seen: factors are P_D for paired and 1 for other features.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from slam_gym.association.compatibility import chi2_gate, joint_distance
from slam_gym.association.tracking.beam import Beam, Prices, updated
from slam_gym.association.tracking.beam import search as beam_search
from slam_gym.association.tracking.near_first import Found, near_first
from slam_gym.association.tracking.path import support_of
from slam_gym.association.tree import Tree, as_hypothesis
from slam_gym.types import UNPAIRED, Array, Effort, Hypothesis, IntArray, Posterior, Prediction, Scan

_MIN_AREA = 1.0  # [m²]
_HARDLY = 1e-3  # a feature of less visibility at the predicted pose is not asked for again


class _Ranking(NamedTuple):
    scores: Array  # (b,) log densities, descending
    best: list[IntArray]  # rows (m,) of the best two hypotheses


@dataclass(frozen=True, slots=True)
class _Model:
    detection: float
    unseen: float
    unpaired: float  # log λ
    width: int
    margin: float
    gains: Array  # (k,) what pairing each predicted feature adds
    constant: float  # log density of pairing none of them


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
    density itself turns down what is improbable, so no other test is made. Measurements whose candidates find most
    support (the other measurements that still have a candidate once the pose is updated with that one pairing) are
    decided first. `posterior` holds the density, its fraction of those of the final beam, and the runner-up;
    `effort.limit_hit` says that the beam's width turned hypotheses away. A locality is used as in `jcbb`.

    Arguments:
        detection: P_D.
        clutter_density, new_density: [1/m²] of spurious measurements and of features not mapped yet.
        unseen: least v_j that is believed of a paired feature: what is in view may be mistaken.
        width: hypotheses kept at each level.
        margin: hypotheses this much less probable than the best, in log density, are dropped at once.

    Raises ValueError as `individual` does; for probabilities not between 0 and 1, densities that are not positive, a
    width below 1, a margin that is not positive, and a visibility that is no probability.
    """
    _check(detection, unseen, clutter_density, new_density, width, margin)
    visibility, gate = _checked_visibility(prediction), candidate_gate(prediction.confidence)
    gains, constant = _gains(prediction, visibility, detection, unseen)
    model = _Model(detection, unseen, math.log(clutter_density + new_density), width, margin, gains, constant)

    def search(tree: Tree) -> Found[_Ranking]:
        return _search(tree, model, chi2_gate(2, gate), visibility)

    found = near_first(scan, prediction, search, gate)
    scores, best = found.extra
    fractions = np.exp(scores - scores[0])
    fractions /= fractions.sum()
    distance = joint_distance(scan, prediction, found.rows).squared
    second = as_hypothesis(prediction, best[1], 0.0, found.effort).features
    runner_up = float(fractions[1]) if len(fractions) > 1 else 0.0
    posterior = Posterior(float(scores[0]), float(fractions[0]), second, runner_up)
    return replace(as_hypothesis(prediction, found.rows, distance, found.effort), posterior=posterior)


def candidate_gate(confidence: float) -> float:
    """Confidence of the individual gate that `map_hypothesis` takes its candidates from."""
    return 1.0 - 0.1 * (1.0 - confidence)


@dataclass
class MostProbable:
    """`map_hypothesis` that learns from scan to scan how dense what is not in the map lies.

    Called as any associator. The density λ is (prior + Σ unpaired) / (prior / density + Σ area), each scan weighing
    `memory` of the next, so that it follows a robot from known into unknown space. The area of a scan is `area`, or
    that of the box around its measurements. `options` go to `map_hypothesis`.
    """

    density: float = 0.02  # [1/m²] λ to begin with, and now
    prior: float = 1.0  # unpaired measurements that this is worth
    memory: float = 0.95
    area: float | None = None  # [m²] in the sensor's view
    options: dict[str, float | int | str | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not (0.0 < self.density < math.inf and 0.0 < self.prior < math.inf):
            raise ValueError(f"MostProbable: density {self.density} and prior {self.prior} must be positive")
        if not 0.0 <= self.memory <= 1.0:
            raise ValueError(f"MostProbable.memory: {self.memory} is not between 0 and 1")
        if self.area is not None and not 0.0 < self.area < math.inf:
            raise ValueError(f"MostProbable.area: {self.area} m² is not positive")
        self._start = (self.prior, self.prior / self.density)
        self._unpaired = self._seen = 0.0

    def __call__(self, scan: Scan, prediction: Prediction) -> Hypothesis:
        options = {"clutter_density": 0.5 * self.density, "new_density": 0.5 * self.density} | self.options
        answer = map_hypothesis(scan, prediction, **options)  # type: ignore[arg-type]
        self._unpaired = self.memory * self._unpaired + float((answer.features == UNPAIRED).sum())
        self._seen = self.memory * self._seen + self._area(scan)
        self.density = (self._start[0] + self._unpaired) / (self._start[1] + self._seen)
        return answer

    def _area(self, scan: Scan) -> float:
        if self.area is not None:
            return self.area
        return max(float(np.prod(np.ptp(scan.points, axis=0))), _MIN_AREA) if len(scan) else 0.0


def _check(detection: float, unseen: float, clutter: float, new: float, width: int, margin: float) -> None:
    if not 0.0 < detection < 1.0:
        raise ValueError(f"detection: {detection} is not between 0 and 1")
    if not 0.0 < unseen <= 1.0:
        raise ValueError(f"unseen: {unseen} is not in (0, 1]")
    if not (clutter >= 0.0 and new >= 0.0 and 0.0 < clutter + new < math.inf):
        raise ValueError(f"clutter_density, new_density: {clutter} and {new} per m²: neither negative, not both 0")
    if width < 1:
        raise ValueError(f"width: {width} is less than 1")
    if not margin > 0.0:
        raise ValueError(f"margin: {margin} is not positive")


def _checked_visibility(prediction: Prediction) -> Array | None:
    """Visibility (k,) from the predicted pose."""
    v = prediction.visibility()
    if v is not None and (v.shape != (len(prediction),) or not ((v >= 0.0) & (v <= 1.0)).all()):
        raise ValueError(f"prediction.visibility: {len(prediction)} probabilities expected, got {v.tolist()}")
    return v


def _gains(prediction: Prediction, visibility: Array | None, detection: float, unseen: float) -> tuple[Array, float]:
    """What pairing each predicted feature adds to the log density (k,), and that of pairing none of them.

    Where the view moves with the hypothesis, what is in view is weighed afterwards (`_in_view`).
    """
    if visibility is None or prediction.view_moves:
        return np.full(len(prediction), math.log(detection)), 0.0
    missed = np.log1p(-detection * visibility)
    return np.log(detection * np.maximum(visibility, unseen)) - missed, float(missed.sum())


def _search(tree: Tree, model: _Model, gate: float, visibility: Array | None) -> Found[_Ranking]:
    """The hypotheses of the beam. Levels without a candidate are `*` in all of them."""
    candidates, pairings, g = tree.candidates, tree.pairings, tree.pairings.given
    order = some = np.flatnonzero(np.diff(candidates.starts))
    if len(some):
        support = support_of(pairings, gate)[g:]
        order = some[np.argsort(-np.maximum.reduceat(support, candidates.starts[some]), kind="stable")]
    levels = g + np.column_stack([candidates.starts[order], candidates.starts[order + 1]])
    gains = model.gains[tree.rows]
    prices = Prices(gains, model.unpaired, model.width, model.margin)
    found = beam_search(pairings, levels, prices)
    beam = found.beam
    scores = beam.score + float(gains[:g].sum()) + model.constant + model.unpaired * (tree.levels - len(some))
    if visibility is not None and tree.prediction.view_moves:
        scores += _in_view(tree, beam, visibility, model)
    ranking = np.argsort(-scores, kind="stable")
    best = [tree.given.copy(), np.full(len(tree.given), UNPAIRED)]
    for rows, rank in zip(best, ranking):
        rows[:] = tree.given
        paired = beam.chosen[rank][beam.chosen[rank] != UNPAIRED]
        rows[pairings.measured[paired]] = tree.rows[pairings.slots[paired]]
    effort = Effort(found.nodes, candidates.tests, found.tests, found.cut)
    return Found(best[0], effort, _Ranking(scores[ranking], best))


def _in_view(tree: Tree, beam: Beam, visibility: Array, model: _Model) -> Array:
    """What each hypothesis (b,) gains or loses by what should be in view from where it puts the robot."""
    prediction, detection = tree.prediction, model.detection
    possible = visibility > _HARDLY
    possible[tree.rows] = False
    rows = np.concatenate((tree.rows, np.flatnonzero(possible)))
    positions = prediction.positions[rows]
    covariance = prediction.joint(rows) if len(rows) else np.empty((0, 0))
    moved = updated(tree.pairings._replace(covariance=covariance), beam, positions)
    out = np.empty(len(beam.score))
    for b, p in enumerate(beam.pairings.tolist()):
        v = prediction.visibility(moved.positions[b], moved.covariances[b])
        assert v is not None
        missed, slots = np.log1p(-detection * v), tree.pairings.slots[beam.paths.pairings[b, :p]]
        out[b] = missed.sum() - missed[slots].sum() + np.log(np.maximum(v[slots], model.unseen)).sum()
    return out
