"""The most probable hypothesis: where JCBB asks for the most pairings, this asks for the greatest density.

A hypothesis H over a scan has the density (up to a constant)

    N(ν_H; 0, S_H) · λ^unpaired · Π over paired j of P_D v_j · Π over the other predicted j of (1 − P_D v_j)

with λ [1/m²] the density of what is not in the map, clutter and new features together, P_D the probability that the
detector reports a feature in view, and v_j the probability that feature j is in view: from where the hypothesis itself
puts the robot, if the prediction can tell (`Prediction.view`). Where
it is not known, nothing is concluded from what was not seen: factors are P_D for paired and 1 for other features.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from slam_gym.association.compatibility import chi2_gate, joint_distance
from slam_gym.association.tracking.beam import Beam, updated
from slam_gym.association.tracking.beam import search as beam_search
from slam_gym.association.tracking.stages import in_stages
from slam_gym.association.tracking.support import anchor_support, arrays, given
from slam_gym.association.tree import Tree, as_hypothesis
from slam_gym.types import NONE, Array, Effort, Hypothesis, IntArray, Posterior, Prediction, Scan

_LOG_TWO_PI = math.log(2.0 * math.pi)
_LEAST_AREA = 1.0  # [m²]
_HARDLY = 1e-3  # a feature of less visibility at the predicted pose is not asked for again

_Ranking = tuple[Array, list[IntArray]]  # scores (b,) descending, and rows (m,) of the best two hypotheses


@dataclass(frozen=True)
class _Model:
    gate: float  # χ² of the candidates
    detection: float
    unseen: float
    unpaired: float  # log λ
    gains: Array  # (k,) what pairing each predicted feature adds
    constant: float  # log density of pairing none of them
    width: int
    margin: float


def map_hypothesis(
    scan: Scan,
    prediction: Prediction,
    *,
    confidence: float = 0.99,
    detection: float = 0.9,
    clutter_density: float = 0.01,
    new_density: float = 0.01,
    unseen: float = 0.05,
    width: int = 100,
    margin: float = 25.0,
    locality: str | None = "covisibility",
) -> Hypothesis:
    """The most probable hypothesis that a beam search of the interpretation tree comes across.

    Candidates are the pairings within an individual gate ten times as sure as `confidence`, .999 for .99: the density
    itself turns down what is improbable, so no other test is made. Measurements whose candidates find most support (the
    other measurements that still have a candidate once the pose is updated with that one pairing) are decided first.
    `posterior` holds the density, its share among the hypotheses of the final beam, and the runner-up;
    `effort.limit_hit` says that the beam's width turned hypotheses away.

    Arguments:
        confidence: of the filter's gates.
        detection: P_D.
        clutter_density, new_density: [1/m²] of spurious measurements and of features not mapped yet.
        unseen: least v_j that is believed of a paired feature: what is in view may be mistaken.
        width: hypotheses kept at each level.
        margin: hypotheses this much less probable than the best, in log density, are dropped at once.
        locality: as in `jcbb`.

    Raises ValueError as `individual` does; for probabilities not between 0 and 1, densities that are not positive, a
    width below 1, a margin that is not positive, a visibility that is no probability, and an unknown locality.
    """
    _check(detection, unseen, clutter_density, new_density, width, margin)
    gains, constant = _gains(prediction, detection, unseen)
    unpaired, gate = math.log(clutter_density + new_density), candidate_gate(confidence)
    model = _Model(chi2_gate(2, gate), detection, unseen, unpaired, gains, constant, width, margin)

    def search(tree: Tree) -> tuple[IntArray, Effort, _Ranking]:
        return _search(tree, model)

    rows, effort, (scores, best) = in_stages(scan, prediction, search, gate=gate, confidence=gate, locality=locality)
    shares = np.exp(scores - scores[0])
    shares /= shares.sum()
    answer = as_hypothesis(prediction, rows, joint_distance(scan, prediction, rows)[0], effort)
    second = as_hypothesis(prediction, best[1], 0.0, effort).features
    posterior = Posterior(float(scores[0]), float(shares[0]), second, float(shares[1]) if len(shares) > 1 else 0.0)
    return Hypothesis(answer.features, answer.joint_distance, answer.dof, effort, posterior)


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
            raise ValueError(f"MostProbable.memory: {self.memory} is no share")
        if self.area is not None and not 0.0 < self.area < math.inf:
            raise ValueError(f"MostProbable.area: {self.area} m² is not positive")
        self._start = (self.prior, self.prior / self.density)
        self._unpaired = self._seen = 0.0

    def __call__(self, scan: Scan, prediction: Prediction) -> Hypothesis:
        options = {"clutter_density": 0.5 * self.density, "new_density": 0.5 * self.density} | self.options
        answer = map_hypothesis(scan, prediction, **options)  # type: ignore[arg-type]
        self._unpaired = self.memory * self._unpaired + float((answer.features == NONE).sum())
        self._seen = self.memory * self._seen + self._area(scan)
        self.density = (self._start[0] + self._unpaired) / (self._start[1] + self._seen)
        return answer

    def _area(self, scan: Scan) -> float:
        if self.area is not None:
            return self.area
        return max(float(np.prod(np.ptp(scan.points, axis=0))), _LEAST_AREA) if len(scan) else 0.0


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


def _gains(prediction: Prediction, detection: float, unseen: float) -> tuple[Array, float]:
    """What pairing each predicted feature adds to the log density (k,), and that of pairing none of them."""
    v = prediction.visibility()
    if v is not None and (v.shape != (len(prediction),) or not ((v >= 0.0) & (v <= 1.0)).all()):
        raise ValueError(f"prediction.visibility: {len(prediction)} probabilities expected, got {v.tolist()}")
    return np.full(len(prediction), math.log(detection)), 0.0


def _search(tree: Tree, model: _Model) -> tuple[IntArray, Effort, _Ranking]:
    """Rows of the best hypothesis, effort, and the ranking. Levels without a candidate are `*` in all of them."""
    candidates, g, gain = tree.candidates, tree.pairings_given, model.gains[tree.rows]
    some = np.flatnonzero(np.diff(candidates.starts))
    path, factor, whitened = given(tree, max(min(len(some), len(candidates.rows)), 1) + 1)
    order = some
    if len(some):
        support = anchor_support(path, factor, whitened, g, arrays(tree), model.gate)
        order = some[np.argsort(-np.maximum.reduceat(support, candidates.starts[some]), kind="stable")]
    levels = np.column_stack([candidates.starts[order], candidates.starts[order + 1]])
    found, nodes, tests, cut = beam_search(
        levels, arrays(tree), path, factor, whitened, g, gain, model.unpaired, model.width, model.margin
    )
    beam = Beam(*found)
    y, diagonal = whitened[: 2 * g], np.diagonal(factor)[: 2 * g]
    scores = beam.score - 0.5 * float(y @ y) - float(np.log(diagonal).sum()) - g * _LOG_TWO_PI
    scores += model.constant + float(gain[:g].sum()) + model.unpaired * (tree.levels - len(some))
    if tree.prediction.view is not None:
        scores += _in_view(tree, beam, tree.prediction.view, model)
    ranking = np.argsort(-scores, kind="stable")
    best = [tree.given.copy(), np.full(len(tree.given), NONE)]
    for rows, rank in zip(best, ranking):
        rows[:] = tree.given
        paired = beam.chosen[rank][beam.chosen[rank] != NONE]
        rows[candidates.measured[paired]] = tree.rows[tree.slots[paired]]
    effort = Effort(nodes=nodes, individual_tests=candidates.tests, joint_tests=tests, limit_hit=cut)
    return best[0], effort, (scores[ranking], best)


def _in_view(tree: Tree, beam: Beam, view: Callable[[Array, Array], Array], model: _Model) -> Array:
    """What each hypothesis (b,) gains or loses by what should be in view from where it puts the robot."""
    prediction, detection = tree.prediction, model.detection
    possible = view(prediction.positions, prediction.covariances) > _HARDLY
    possible[tree.rows] = False
    rows = np.concatenate((tree.rows, np.flatnonzero(possible)))
    positions, covariance = prediction.positions[rows], prediction.joint(rows) if len(rows) else np.empty((0, 0))
    out = np.empty(len(beam.score))
    for b in range(len(out)):
        slots = beam.path[b, : beam.pairings[b]]
        moved = updated(beam.path[b], beam.pairings[b], beam.factor[b], beam.whitened[b], positions, covariance)
        v = view(*moved)
        missed = np.log1p(-detection * v)
        out[b] = missed.sum() - missed[slots].sum() + np.log(np.maximum(v[slots], model.unseen)).sum()
    return out
