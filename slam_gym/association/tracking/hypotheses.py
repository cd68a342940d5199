"""The k best hypotheses of a scan, as a beam search finds them, and what they are weighed by.

A hypothesis H over a scan has the density (up to a constant)

    N(ν_H; 0, S_H) · λ^unpaired · Π over paired j of P_D v_j · Π over the other predicted j of (1 − P_D v_j)

with λ [1/m²] the density of what is not in the map, clutter and new features together, P_D the probability that the
detector reports a feature in view, and v_j the probability that feature j is in view from where the hypothesis itself
puts the robot. Where nobody can tell what is in view, nothing is concluded from what was not seen: factors are P_D for
paired and 1 for other features.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.prediction import Expected, visibility
from slam_gym.association.tracking.beam import Beam, Prices, updated
from slam_gym.association.tracking.beam import search as beam_search
from slam_gym.association.tracking.headings import Part, joint_in
from slam_gym.association.tracking.path import path_of, support_of
from slam_gym.association.tree import Pairings, write_rows
from slam_gym.types import UNPAIRED, Array, IntArray

_HARDLY = 1e-3  # a feature of less visibility at the predicted pose is not asked for again
_MIN_AREA = 1.0  # [m²] of a scan


class Rates(NamedTuple):
    """What the search takes for true: its prices for pairing and for not pairing."""

    detection: float  # P_D
    unseen: float  # least v_j that is believed of a paired feature: what is in view may be mistaken
    density: float  # [1/m²] λ


class Limits(NamedTuple):
    """What bounds a search."""

    gate: float  # χ² of candidates
    width: int  # hypotheses kept at each level
    margin: float  # none is kept that scores so much less than the best


class Searched(NamedTuple):
    """The hypotheses that a search kept, in no order that counts."""

    beam: Beam
    rows: IntArray  # (b, m) row of the prediction that each pairs with each measurement, or UNPAIRED
    fit: Array  # (b,) log N(ν_H; 0, S_H), and the odds of its pairings
    unpaired: IntArray  # (b,) measurements that they pair with nothing
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


@compiled
def search_tree(
    pairings: Pairings,
    starts: IntArray,
    rows: IntArray,
    visible: Array,
    odds: Array,
    rates: Rates,
    limits: Limits,
) -> Searched:
    """The hypotheses of greatest density, by what is in view from the predicted pose.

    Measurements whose candidates find most support (the other measurements that still have a candidate once the pose is
    updated with that one pairing) are decided first; those without a candidate are `*` in all hypotheses.

    Arguments:
        starts: (l + 1,) where each measurement's pairings begin, after those given.
        rows: (u,) row of the prediction of each slot.
        visible: (k,) probability of being in view from the predicted pose; (0,): nobody can tell.
        odds: (c,) of each pairing, which the model does not know of; (0,): none.
    """
    gains = np.full(len(pairings.slots), math.log(rates.detection))
    for c in range(len(gains) if len(visible) > 0 else 0):
        v = visible[rows[pairings.slots[c]]]
        gains[c] += math.log(max(v, rates.unseen)) - math.log1p(-rates.detection * v)
    levels = _levels(pairings, starts, limits.gate)
    offered = gains + odds if len(odds) > 0 else gains
    prices = Prices(offered, math.log(rates.density), limits.width, limits.margin)
    found = beam_search(pairings, levels, prices)
    beam = found.beam
    fit, unpaired = beam.score.copy(), np.empty(len(beam.score), np.int64)
    decided = np.empty((len(fit), len(pairings.noise)), np.int64)
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
def views(
    expected: Expected, part: Part, pairings: Pairings, rows: IntArray, found: Searched, visible: Array, together: float
) -> tuple[Views, int]:
    """What is in view from where each hypothesis puts the robot, and the first feature at fault, or −1.

    Hypotheses that put every feature within `together` [m] of where another puts it share its view. So do all of them
    where the features are predicted as well as that, or where what is in view does not depend on the pose.
    """
    beam, group = found.beam, np.zeros(len(found.fit), np.int64)
    if len(visible) == 0:
        return Views(group, np.empty((0, 0)), rows), -1
    if len(expected.visible) > 0 or not expected.view_moves or all_below(part.covariances, rows, together * together):
        return Views(group, visible.copy().reshape(1, -1), rows), -1
    possible = visible > _HARDLY
    possible[rows] = False
    both = np.concatenate((rows, np.flatnonzero(possible)))
    joint = joint_in(expected, part, both)
    wider = Pairings(
        pairings.slots, pairings.measured, pairings.innovations, pairings.noise, joint, pairings.local, pairings.given
    )
    positions, covariances = updated(wider, beam, part.positions[both])
    first = grouped(positions, np.argsort(-beam.score, kind="mergesort"), together, group)
    width = len(first) * len(both)
    seen, fault = visibility(expected, positions[first].reshape(width, 2), covariances[first].reshape(width, 2, 2))
    return Views(group, seen.reshape(len(first), len(both)), np.arange(len(rows))), fault


@compiled
def all_below(covariances: Array, rows: IntArray, variance: float) -> bool:
    """Whether the positions at `rows` are all predicted with less than a variance, in x and in y."""
    for j in rows:
        if not (covariances[j, 0, 0] < variance and covariances[j, 1, 1] < variance):
            return False
    return variance > 0.0


@compiled
def weighed_by_view(found: Searched, slots: IntArray, seen: Views, detections: Array, unseen: float) -> Array:
    """log Π P_D v_j · Π (1 − P_D v_j) of each hypothesis, for each P_D of `detections`: (b, d)."""
    pairings, made, (group, visible, columns) = found.beam.pairings, found.beam.made, seen
    out, (groups, features) = np.empty((len(made), len(detections))), visible.shape
    missed, paired = np.empty(features), np.empty((groups, len(columns)))
    for g in range(groups):
        for s in range(len(columns)):
            paired[g, s] = math.log(max(visible[g, columns[s]], unseen))
    for d in range(len(detections)):
        P = detections[d]
        log_P = math.log(P)
        if groups == 0:
            for b in range(len(made)):
                out[b, d] = 0.0 + pairings[b] * log_P
        for g in range(groups):
            none = 0.0
            for j in range(features):
                missed[j] = math.log1p(-P * visible[g, j])
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
