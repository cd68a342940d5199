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
from slam_gym.association.compatibility import plain
from slam_gym.association.tracking.beam import Beam, BeamArrays, Moved, Prices, plainly, updated
from slam_gym.association.tracking.beam import search as beam_search
from slam_gym.association.tracking.path import Path, path_of, support_of
from slam_gym.association.tree import PairingArrays, Pairings, Tree, write_rows
from slam_gym.types import UNPAIRED, Array, Effort, IntArray, Prediction

HARDLY = 1e-3  # a feature of less visibility at the predicted pose is not asked for again
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
    rows: IntArray  # (b, m) row of the prediction that each pairs with each measurement, or UNPAIRED
    fit: Array  # (b,) log N(ν_H; 0, S_H), and the odds of its pairings
    unpaired: IntArray  # (b,) measurements that they pair with nothing
    effort: Effort


class Searched(NamedTuple):
    """`Kept` but for the tree, its effort in figures."""

    beam: Beam
    rows: IntArray  # (b, m)
    fit: Array  # (b,)
    unpaired: IntArray  # (b,)
    nodes: int
    tests: int  # joint tests
    cut: bool  # the beam was full


class Views(NamedTuple):
    """What each hypothesis has in view: hypotheses of one group are taken for as good as at one place."""

    group: IntArray  # (b,)
    visibility: Array  # (groups, q) of the features of the tree and of others; (0, 0) where nobody can tell
    columns: IntArray  # (u,) where the features of the tree are among those, by slot


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
    if v is not None and not (v.shape == (len(prediction),) and _are_probabilities(plain(v))):
        raise ValueError(f"prediction.visibility: {len(prediction)} probabilities expected, got {v.tolist()}")
    return v


@compiled
def _are_probabilities(values: Array) -> bool:
    faults = 0
    for value in values:
        faults += not 0.0 <= value <= 1.0
    return faults == 0


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
    seen = _NOBODY if visibility is None else visibility
    found = _search(
        tree.pairings[:], tree.candidates.starts, tree.given, tree.rows, seen, odds, rates[:], gate, width, margin
    )
    beam, rows, fit, unpaired, nodes, tests, cut = found
    return Kept(
        tree, Beam(*beam[:4], Path(*beam[4:])), rows, fit, unpaired, Effort(nodes, tree.candidates.tests, tests, cut)
    )


def some(kept: Kept, chosen: IntArray) -> Kept:
    """The hypotheses `chosen` (c,), ascending."""
    beam = kept.beam
    fewer = Beam(beam.score[chosen], beam.pairings[chosen], beam.made[chosen], beam.nodes[chosen], beam.joined)
    return Kept(kept.tree, fewer, kept.rows[chosen], kept.fit[chosen], kept.unpaired[chosen], kept.effort)


def views(kept: Kept, visibility: Array | None, together: float = 0.0) -> Views:
    """What is in view from where each hypothesis puts the robot.

    Hypotheses that put every feature within `together` [m] of where another puts it share its view. So do all of them
    where the features are predicted as well as that.
    """
    tree, beam = kept.tree, kept.beam
    group = np.zeros(len(beam.score), np.int64)
    if visibility is None:
        return Views(group, _NOBODY_KNOWS, tree.rows)
    prediction, rows = tree.prediction, tree.rows
    if not prediction.view_moves or all_below(plain(prediction.covariances), rows, together**2):
        return Views(group, visibility.reshape(1, -1), rows)
    possible = visibility > HARDLY
    possible[rows] = False
    rows = np.concatenate((rows, np.flatnonzero(possible)))
    moved = moved_by(kept, rows)
    first = grouped(moved.positions, np.argsort(-beam.score, kind="stable"), together, group)
    positions, covariances = moved.positions[first].reshape(-1, 2), moved.covariances[first].reshape(-1, 2, 2)
    seen = prediction.visibility(positions, covariances)
    assert seen is not None
    return Views(group, seen.reshape(len(first), len(rows)), np.arange(len(tree.rows)))


def moved_by(kept: Kept, rows: IntArray) -> Moved:
    """Where each hypothesis puts the features at `rows` (r,), which begin with those of the tree."""
    prediction = kept.tree.prediction
    covariance = prediction.joint(rows) if len(rows) else np.empty((0, 0))
    arrays = kept.tree.pairings._replace(covariance=covariance)[:]
    return Moved(*updated(arrays, kept.beam, prediction.positions[rows]))


@compiled
def all_below(covariances: Array, rows: IntArray, variance: float) -> bool:
    """Whether the positions at `rows` are all predicted with less than a variance, in x and in y."""
    for j in rows:
        if not (covariances[j, 0, 0] < variance and covariances[j, 1, 1] < variance):
            return False
    return variance > 0.0


def log_densities(kept: Kept, seen: Views, detections: Array, unseen: float) -> Array:
    """log Π P_D v_j · Π (1 − P_D v_j) of each hypothesis, for each P_D of `detections`: (b, d)."""
    beam, slots = kept.beam, kept.tree.pairings.slots
    return weighed_by_view(beam.pairings, beam.made, slots, *seen, detections, unseen)


@compiled
def weighed_by_view(
    pairings: IntArray,
    made: IntArray,
    slots: IntArray,
    group: IntArray,
    visibility: Array,
    columns: IntArray,
    detections: Array,
    unseen: float,
) -> Array:
    out, (groups, features) = np.empty((len(made), len(detections))), visibility.shape
    missed, paired = np.empty(features), np.empty((groups, len(columns)))
    for g in range(groups):
        for s in range(len(columns)):
            paired[g, s] = math.log(max(visibility[g, columns[s]], unseen))
    for d in range(len(detections)):
        P = detections[d]
        log_P = math.log(P)
        if groups == 0:
            for b in range(len(made)):
                out[b, d] = 0.0 + pairings[b] * log_P
        for g in range(groups):
            none = 0.0
            for j in range(features):
                missed[j] = math.log1p(-P * visibility[g, j])
                none += missed[j]
            for b in range(len(made)):
                if group[b] != g:
                    continue
                out[b, d] = none + pairings[b] * log_P
                for q in range(pairings[b]):
                    s = slots[made[b, q]]
                    out[b, d] += paired[g, s] - missed[columns[s]]
    return out


@compiled
def _search(
    arrays: PairingArrays,
    starts: IntArray,
    given: IntArray,
    rows: IntArray,
    visibility: Array,
    odds: Array,
    rates_given: tuple[float, float, float],
    gate: float,
    width: int,
    margin: float,
) -> tuple[BeamArrays, IntArray, Array, IntArray, int, int, bool]:
    """`search_tree` in plain tuples."""
    found = search_tree(
        Pairings(*arrays), starts, given, rows, visibility, odds, Rates(*rates_given), gate, width, margin
    )
    return (
        plainly(found.beam), found.rows, found.fit, found.unpaired, found.nodes, found.tests, found.cut,
    )  # fmt: skip


@compiled
def search_tree(
    pairings: Pairings,
    starts: IntArray,
    given: IntArray,
    rows: IntArray,
    visibility: Array,
    odds: Array,
    rates: Rates,
    gate: float,
    width: int,
    margin: float,
) -> Searched:
    """`search`, of compiled functions. The measurements' pairings begin after those given, at `starts` (l + 1,). An
    empty `visibility` (k,) says nothing, nor do empty `odds` (c,)."""
    gains = np.full(len(pairings.slots), math.log(rates.detection))
    for c in range(len(gains) if len(visibility) > 0 else 0):
        v = visibility[rows[pairings.slots[c]]]
        gains[c] += math.log(max(v, rates.unseen)) - math.log1p(-rates.detection * v)
    levels = _levels(pairings, starts, gate)
    offered = gains + odds if len(odds) > 0 else gains
    prices = Prices(offered, math.log(rates.density), width, margin)
    found = beam_search(pairings, levels, prices)
    beam = found.beam
    fit, unpaired = beam.score.copy(), np.empty(len(beam.score), np.int64)
    decided = np.empty((len(fit), len(given)), np.int64)
    for b in range(len(fit)):
        made = beam.pairings[b] - pairings.given
        unpaired[b] = len(starts) - 1 - made
        fit[b] -= (len(levels) - made) * prices.unpaired
        for q in range(pairings.given, beam.pairings[b]):
            fit[b] -= gains[beam.made[b, q]]
        decided[b] = UNPAIRED
        write_rows(pairings, beam.made[b, : beam.pairings[b]], rows, decided[b])
    return Searched(beam, decided, fit, unpaired, found.nodes, found.tests, found.cut)


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
def grouped(positions: Array, order: IntArray, together: float, group: IntArray) -> IntArray:
    """Enter the group of each hypothesis by the features (b, k, 2) where it puts them; the first in order of each."""
    first, count = np.empty(len(positions), np.int64), 0
    for b in order:
        group[b] = -1
        for g in range(count):
            other, near = first[g], True
            for k in range(positions.shape[1]):
                x, y = positions[b, k, 0] - positions[other, k, 0], positions[b, k, 1] - positions[other, k, 1]
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
    """[m²] that a scan has shown, 0 without any measurement: the box around the measurements (m, 2), and no less than
    a sector from the robot to the farthest of them, of one radian to either side.

    A box about one or two measurements is far too small, and what is seldom there would seem to be everywhere.
    """
    if len(points) == 0:
        return 0.0
    left, right, bottom, top = points[0, 0], points[0, 0], points[0, 1], points[0, 1]
    farthest = 0.0  # squared
    for i in range(len(points)):
        x, y = points[i]
        left, right, bottom, top = min(left, x), max(right, x), min(bottom, y), max(top, y)
        farthest = max(farthest, x * x + y * y)
    return float(max((right - left) * (top - bottom), farthest, _MIN_AREA))
