"""The hypotheses of a scan that a beam search keeps, and what they are weighed by.

A hypothesis H over a scan has the density (up to a constant)

    N(ν_H; 0, S_H) · λ^unpaired · Π over paired j of P_D v_j · Π over the other predicted j of (1 − P_D v_j)

with λ [1/m²] the density of what is not in the map, clutter and new features together, P_D the probability that the
detector reports a feature in view, and v_j the probability that feature j is in view from where the hypothesis itself
puts the robot (`Prediction.visibility`), or from the predicted pose where the view does not move (`view_moves`). Where
nobody can tell, nothing is concluded from what was not seen: factors are P_D for paired and 1 for other features.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.tracking.beam import Beam, Prices, updated
from slam_gym.association.tracking.beam import search as beam_search
from slam_gym.association.tracking.path import path_of, support_of
from slam_gym.association.tree import Pairings, Tree
from slam_gym.types import UNPAIRED, Array, Effort, IntArray, Prediction

_HARDLY = 1e-3  # a feature of less visibility at the predicted pose is not asked for again
_NOBODY_KNOWS, _NOBODY = np.empty((0, 0)), np.empty(0)


_MIN_AREA = 1.0  # [m²] of a scan


class Rates(NamedTuple):
    """What the search takes for true: its prices for pairing and for not pairing."""

    detection: float  # P_D
    unseen: float  # least v_j that is believed of a paired feature: what is in view may be mistaken
    density: float  # [1/m²] λ


class Kept(NamedTuple):
    """The hypotheses that a search kept, in no order that counts."""

    tree: Tree
    beam: Beam
    fit: Array  # (b,) log N(ν_H; 0, S_H), and the odds of its pairings
    unpaired: IntArray  # (b,) measurements that they pair with nothing
    effort: Effort


class Views(NamedTuple):
    """What each hypothesis has in view: hypotheses of one group are taken for as good as at one place."""

    group: IntArray  # (b,)
    visibility: Array  # (groups, q) of the features of the tree by slot, then of others; (0, 0) where nobody can tell


def candidate_gate(confidence: float) -> float:
    """Confidence of the individual gate that candidates are taken from: ten times as sure, .999 for .99.

    The density itself turns down what is improbable, so that no other test is made.
    """
    return 1.0 - 0.1 * (1.0 - confidence)


def check_search(detection: float, unseen: float, width: int, margin: float) -> None:
    """Raises ValueError for what no search can be told."""
    if not 0.0 < detection < 1.0:
        raise ValueError(f"detection: {detection} is not between 0 and 1")
    if not 0.0 < unseen <= 1.0:
        raise ValueError(f"unseen: {unseen} is not in (0, 1]")
    if width < 1:
        raise ValueError(f"width: {width} is less than 1")
    if not margin > 0.0:
        raise ValueError(f"margin: {margin} is not positive")


def checked_visibility(prediction: Prediction) -> Array | None:
    """Visibility (k,) from the predicted pose; None where nobody can tell. ValueError for what is no probability."""
    v = prediction.visibility()
    if v is not None and (v.shape != (len(prediction),) or not ((v >= 0.0) & (v <= 1.0)).all()):
        raise ValueError(f"prediction.visibility: {len(prediction)} probabilities expected, got {v.tolist()}")
    return v


def search(
    tree: Tree,
    visibility: Array | None,
    rates: Rates,
    gate: float,
    width: int,
    margin: float,
    odds: Array = _NOBODY,
) -> Kept:
    """The hypotheses of greatest density, by what is in view from the predicted pose.

    `odds` (c,) of each pairing are what the model does not know of; none: nothing.

    Measurements whose candidates find most support (the other measurements that still have a candidate once the pose is
    updated with that one pairing) are decided first; those without a candidate are `*` in all hypotheses.
    """
    seen = _NOBODY if visibility is None else visibility[tree.rows]
    found = _search(tree.pairings, tree.candidates.starts, seen, rates, gate, width, margin, odds)
    beam, fit, unpaired, nodes, tests, cut = found
    return Kept(tree, beam, fit, unpaired, Effort(nodes, tree.candidates.tests, tests, cut))


def views(kept: Kept, visibility: Array | None, together: float = 0.0) -> Views:
    """What is in view from where each hypothesis puts the robot.

    Hypotheses that put every feature within `together` [m] of where another puts it share its view. So do all of them
    where the features are predicted as well as that.
    """
    tree, beam = kept.tree, kept.beam
    group = np.zeros(len(beam.score), np.int64)
    if visibility is None:
        return Views(group, _NOBODY_KNOWS)
    prediction, rows = tree.prediction, tree.rows
    variances = prediction.covariances[rows]
    if not prediction.view_moves or variances[:, (0, 1), (0, 1)].max(initial=0.0) < together**2:
        others = np.ones(len(prediction), np.bool_)
        others[rows] = False
        return Views(group, np.concatenate((visibility[rows], visibility[others]))[None])
    possible = visibility > _HARDLY
    possible[rows] = False
    rows = np.concatenate((rows, np.flatnonzero(possible)))
    covariance = prediction.joint(rows) if len(rows) else np.empty((0, 0))
    moved = updated(tree.pairings._replace(covariance=covariance), beam, prediction.positions[rows])
    first = _grouped(moved.positions, np.argsort(-beam.score, kind="stable"), together, group)
    seen = np.empty((len(first), len(rows)))
    for g, b in enumerate(first.tolist()):
        v = prediction.visibility(moved.positions[b], moved.covariances[b])
        assert v is not None
        seen[g] = v
    return Views(group, seen)


@compiled
def log_densities(pairings: Pairings, beam: Beam, seen: Views, detections: Array, unseen: float) -> Array:
    """log Π P_D v_j · Π (1 − P_D v_j) of each hypothesis, for each P_D of `detections`: (b, d)."""
    out = np.empty((len(beam.score), len(detections)))
    groups, features = seen.visibility.shape
    missed = np.empty((groups, features))
    for d in range(len(detections)):
        P = detections[d]
        none = np.zeros(max(groups, 1))
        for g in range(groups):
            for j in range(features):
                missed[g, j] = math.log1p(-P * seen.visibility[g, j])
                none[g] += missed[g, j]
        for b in range(len(beam.score)):
            g = seen.group[b]
            total = none[g] + beam.pairings[b] * math.log(P)
            if groups > 0:
                for q in range(beam.pairings[b]):
                    j = pairings.slots[beam.made[b, q]]
                    total += math.log(max(seen.visibility[g, j], unseen)) - missed[g, j]
            out[b, d] = total
    return out


def all_rows(kept: Kept) -> IntArray:
    """(b, m) row of the prediction that each hypothesis pairs with each measurement, or UNPAIRED."""
    return _rows(kept.tree.pairings, kept.beam, kept.tree.rows, len(kept.tree.given))


@compiled
def _rows(pairings: Pairings, beam: Beam, rows: IntArray, measurements: int) -> IntArray:
    out = np.full((len(beam.score), measurements), UNPAIRED)
    for b in range(len(out)):
        for q in range(beam.pairings[b]):
            c = beam.made[b, q]
            out[b, pairings.measured[c]] = rows[pairings.slots[c]]
    return out


@compiled
def _search(
    pairings: Pairings,
    starts: IntArray,
    visibility: Array,
    rates: Rates,
    gate: float,
    width: int,
    margin: float,
    odds: Array,
) -> tuple[Beam, Array, IntArray, int, int, bool]:
    """`Kept` but for the tree, its effort as nodes, tests and whether the beam was full; a plain tuple.

    The measurements' pairings begin after those given, at `starts` (l + 1,). An empty `visibility` (u,) says nothing,
    nor do empty `odds` (c,).
    """
    gains = np.full(len(pairings.slots), math.log(rates.detection))
    for c in range(len(gains) if len(visibility) > 0 else 0):
        v = visibility[pairings.slots[c]]
        gains[c] += math.log(max(v, rates.unseen)) - math.log1p(-rates.detection * v)
    levels = _levels(pairings, starts, gate)
    offered = gains + odds if len(odds) > 0 else gains
    prices = Prices(offered, math.log(rates.density), width, margin)
    found = beam_search(pairings, levels, prices)
    beam = found.beam
    fit, unpaired = beam.score.copy(), np.empty(len(beam.score), np.int64)
    for b in range(len(fit)):
        made = beam.pairings[b] - pairings.given
        unpaired[b] = len(starts) - 1 - made
        fit[b] -= (len(levels) - made) * prices.unpaired
        for q in range(pairings.given, beam.pairings[b]):
            fit[b] -= gains[beam.made[b, q]]
    return beam, fit, unpaired, found.nodes, found.tests, found.cut


@compiled
def _levels(pairings: Pairings, starts: IntArray, gate: float) -> IntArray:
    """(l, 2) where the pairings of each measurement that has any begin and end, in the order of decision."""
    path, some, others = path_of(pairings, 2), 0, np.count_nonzero(starts[1:] > starts[:-1]) - 1
    most, levels = np.zeros(len(starts) - 1, np.int64), np.empty((len(starts) - 1, 2), np.int64)
    for i in range(len(starts) - 1):
        first, last = pairings.given + starts[i], pairings.given + starts[i + 1]
        for c in range(first, last):
            if most[some] > -others:
                most[some] = min(most[some], -support_of(pairings, path, c, gate))
        if first < last:
            levels[some, 0], levels[some, 1] = first, last
            some += 1
    return levels[np.argsort(most[:some], kind="mergesort")]


@compiled
def _grouped(positions: Array, order: IntArray, together: float, group: IntArray) -> IntArray:
    """Enter the group of each hypothesis by the features (b, k, 2) where it puts them; the first in order of each."""
    first, count = np.empty(len(positions), np.int64), 0
    for b in order:
        group[b] = -1
        for g in range(count):
            other, near = first[g], True
            for k in range(positions.shape[1]):
                x, y = positions[b, k] - positions[other, k]
                if not x * x + y * y < together * together:
                    near = False
                    break
            if near:
                group[b] = g
                break
        if group[b] < 0:
            group[b], first[count] = count, b
            count += 1
    return first[:count]


@compiled
def scan_area(points: Array) -> float:
    """[m²] of the box around the measurements (m, 2), 0 without any."""
    if len(points) == 0:
        return 0.0
    left, right, bottom, top = points[0, 0], points[0, 0], points[0, 1], points[0, 1]
    for i in range(1, len(points)):
        left, right = min(left, points[i, 0]), max(right, points[i, 0])
        bottom, top = min(bottom, points[i, 1]), max(top, points[i, 1])
    return float(max((right - left) * (top - bottom), _MIN_AREA))
