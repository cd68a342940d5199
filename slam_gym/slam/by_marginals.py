"""The decision of `marginal`, learned odds or not, in compiled code, where all that it asks for lies in arrays.

It is `association.tracking.marginals` out of the same parts, for speed. There, a prediction is asked what is in view
and how features vary together; here both are worked out on the spot.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.compatibility import distance_of, paired_rows
from slam_gym.association.learned.inputs import Known, Seen, numbers_of
from slam_gym.association.learned.network import Network, log_odds
from slam_gym.association.tracking.beam import updated
from slam_gym.association.tracking.marginal import decided
from slam_gym.association.tracking.marginals import (
    AREA,
    DOUBT,
    FIRST_LOOK,
    TOGETHER,
    UNPAIRED_BEFORE,
    expected_detections,
    greatest_density,
    summed,
)
from slam_gym.association.tracking.scan_hypotheses import (
    HARDLY,
    Searched,
    Views,
    all_below,
    grouped,
    scan_area,
    search_tree,
    weighed_by_view,
)
from slam_gym.association.tree import Pairings
from slam_gym.mapping.measurement import joint_covariance
from slam_gym.navigation.visibility import probabilities_in_view
from slam_gym.slam.kernels import ScanArrays
from slam_gym.slam.narrow_headings import Foreseen, Look, Scene, compatible, joint_in
from slam_gym.types import UNPAIRED, Array, BoolArray, IntArray


class Rule(NamedTuple):
    """What `marginal` is told."""

    threshold: float  # probability that starts a feature
    pairing: float  # … that pairs
    provisional: float  # … that pairs with a feature that is provisional
    unseen: float
    width: int
    margin: float
    gate: float  # χ² of candidates


class Past(NamedTuple):
    """What the run has shown."""

    unpaired: float
    area: float  # [m²]
    values: Array  # (d,) that P_D may have
    detections: Array  # (d,) log weights of those
    density: float  # what a learned model is told of that
    known: float


class Decisions(NamedTuple):
    """What `marginal` answers."""

    features: IntArray  # (m,) as the following
    probabilities: Array
    new: BoolArray
    runner_up: IntArray
    unpaired: Array
    by_value: Array  # (d,) log weights of P_D
    figures: tuple[float, float, float, float, float]  # D²; own and second weight, log of the sum; area [m²]
    effort: tuple[int, int, int, bool]  # nodes, individual and joint tests; whether the beam was full


class _Ready(NamedTuple):
    """What a search in it takes."""

    look: Look
    pairings: Pairings
    visibility: Array  # (k,)
    odds: Array  # (c,) or (0,)


class _Taken(NamedTuple):
    """What was searched for hypotheses, by how much it may be worse than the best, and what no other fits."""

    ready: _Ready
    margin: float


class _Gathered(NamedTuple):
    """The hypotheses of all narrow headings."""

    hypotheses: IntArray  # (b, m)
    fit: Array  # (b,) log density but for what is in view
    seen: Array  # (b, d) what that adds, for each P_D
    effort: tuple[int, int, int, bool]


@compiled
def decide_by_marginals(
    scan: ScanArrays, foreseen: Foreseen, scene: Scene, past: Past, rule: Rule, thresholds: Array, network: Network
) -> tuple[bool, Decisions]:
    """The decisions of `marginal` at these `thresholds` (k,), and whether they are any: False, where some number is
    none that it could work with."""
    points, noise = scan[0], scan[1]
    m, area = len(points), scan_area(points)
    a, b = UNPAIRED_BEFORE + past.unpaired, AREA + past.area + area
    detection, prices = expected_detections(past.values, past.detections, a, b, -1.0, m)
    looks = compatible(
        points, noise, foreseen, scene, rule.gate, rule.unseen, (detection, a, b), len(network.centre) > 0
    )
    taken = _worth_searching(looks, scan, foreseen, scene, past, rule, prices, network)
    kept = _gathered(taken, m, foreseen, scene, past, rule, prices)
    if len(kept.fit) == 0:
        nobody, none = np.empty(m), np.full(m, UNPAIRED)
        return False, Decisions(
            none, nobody, none == none, none, nobody, past.detections, (0.0, 0.0, 0.0, 0.0, area), kept.effort
        )
    scores, fractions, by_value, pairings, unpaired = summed(
        kept.hypotheses, kept.fit, kept.seen, past.detections, len(foreseen.features)
    )
    rows, features, probabilities, new, other, own, second, total, paired = decided(
        kept.hypotheses, fractions, scores, pairings, unpaired, foreseen.features, thresholds, rule.threshold
    )
    distance = 0.0
    if paired > 0:
        joint = joint_covariance(scene.x, scene.P, foreseen.features[paired_rows(rows)], scene.second_order)
        distance = distance_of(points, noise, foreseen.positions, rows, joint)
    figures = distance, own, second, total, area
    return not math.isnan(distance), Decisions(
        features, probabilities, new, other, unpaired, by_value, figures, kept.effort
    )


@compiled
def _gathered(
    taken: list[_Taken], m: int, foreseen: Foreseen, scene: Scene, past: Past, rule: Rule, prices: Array
) -> _Gathered:
    """The hypotheses of all that is searched; none, where a number is none to work with."""
    nodes, tests, joint_tests, cut, count, none = 0, 0, 0, False, 0, np.full(m, UNPAIRED)
    found: list[Searched] = []
    seen: list[Array] = []
    for k in range(len(taken)):
        ready = taken[k].ready
        kept = _searched(ready, none, rule, rule.width, taken[k].margin)
        valid, views = _views(ready, kept, scene, foreseen)
        if not valid:
            count = 0
            break
        slots, beam, told = ready.pairings.slots, kept.beam, (past.values, rule.unseen)
        group, visibility, columns = views
        seen.append(weighed_by_view(beam.pairings, beam.made, slots, group, visibility, columns, *told))
        found.append(kept)
        nodes, tests, joint_tests = nodes + kept.nodes, tests + ready.look.tests, joint_tests + kept.tests
        cut, count = cut or kept.cut, count + len(kept.fit)
    out = _Gathered(
        np.empty((count, m), np.int64), np.empty(count), np.empty((count, len(past.values))),
        (nodes, tests, joint_tests, cut),
    )  # fmt: skip
    b = 0
    for k in range(len(found)):
        rows, fit, unpaired = found[k].rows, found[k].fit, found[k].unpaired
        log_weight = taken[k].ready.look.part.log_weight
        for h in range(len(fit) if count > 0 else 0):
            out.hypotheses[b], out.seen[b] = rows[h], seen[k][h]
            out.fit[b] = log_weight + fit[h] + prices[unpaired[h]]
            b += 1
    return out


@compiled
def _ready(
    look: Look,
    scan: ScanArrays,
    foreseen: Foreseen,
    scene: Scene,
    past: Past,
    network: Network,
) -> tuple[bool, _Ready]:
    """A narrow heading, made ready for searches."""
    part, rows, odds = look.part, look.rows, np.empty(0)
    visibility, fault = probabilities_in_view(part.positions, part.covariances, *scene.sight, scene.pose[:3])
    joint = joint_in(scene, foreseen, part, rows)
    pairings = Pairings(look.slots, look.measured, look.innovations, scan[1], joint, np.empty((0, 0), np.bool_), 0)
    if len(network.centre) > 0:
        known = Known(
            part.positions, part.covariances, foreseen.sizes, foreseen.size_variances, foreseen.kinds, foreseen.ages,
            foreseen.sightings, visibility,
        )  # fmt: skip
        run = math.sqrt(max(part.variance, 0.0)), past.density, past.known
        seen = Seen(scan[0], scan[2], scan[3], scan[4])
        odds = log_odds(
            network,
            numbers_of(pairings, rows, seen, known, foreseen.near.astype(np.float64), run),
            look.measured,
            look.slots,
        )
    return fault < 0, _Ready(look, pairings, visibility, odds)


@compiled
def _searched(ready: _Ready, given: IntArray, rule: Rule, width: int, margin: float) -> Searched:
    look = ready.look
    return search_tree(
        ready.pairings, look.starts, given, look.rows, ready.visibility, ready.odds, look.rates, rule.gate, width,
        margin,
    )  # fmt: skip


@compiled
def _worth_searching(
    looks: list[Look],
    scan: ScanArrays,
    foreseen: Foreseen,
    scene: Scene,
    past: Past,
    rule: Rule,
    prices: Array,
    network: Network,
) -> list[_Taken]:
    """What `marginals` finds worth searching, with the margin of each; nothing, where a number is none to work with."""
    best, none = -math.inf, np.full(len(scan[0]), UNPAIRED)
    order, score, density = np.empty(len(looks)), np.empty(len(looks)), np.empty(len(looks))
    found: list[_Ready] = []
    alone: list[_Taken] = []
    for k in range(len(looks)):
        order[k] = -looks[k].at_most
    for k in np.argsort(order, kind="mergesort"):
        look = looks[k]
        if look.at_most <= best - rule.margin:
            break
        valid, ready = _ready(look, scan, foreseen, scene, past, network)
        if not valid:
            return alone
        n = len(found)
        found.append(ready)
        if len(looks) == 1:
            alone.append(_Taken(ready, rule.margin))
            return alone
        kept = _searched(ready, none, rule, FIRST_LOOK, rule.margin)
        rates, weight, scores = look.rates, look.part.log_weight, kept.beam.score
        score[n] = weight + scores.max()
        density[n] = weight + greatest_density(scores, kept.unpaired, rates[:], look.strange, prices, ready.visibility)
        best = max(best, score[n])
    return _chosen(found, score, density, best, rule.margin)


@compiled
def _chosen(found: list[_Ready], score: Array, density: Array, best: float, margin: float) -> list[_Taken]:
    """Those that a first look finds not hopeless beside the best; at least one of them, if there are any."""
    behind = np.full(len(found), -DOUBT)
    for k in range(len(found)):
        behind[k] += density[: len(found)].max() - density[k]
    out: list[_Taken] = []
    for k in range(len(found)):
        if score[k] > best - margin and behind[k] < margin:
            out.append(_Taken(found[k], margin - max(behind[k], 0.0)))
    if len(out) == 0 and len(found) > 0:  # a score knows no price of what is compatible with nothing
        k = int(np.argmin(behind))
        out.append(_Taken(found[k], margin - max(behind[k], 0.0)))
    return out


@compiled
def _views(ready: _Ready, found: Searched, scene: Scene, foreseen: Foreseen) -> tuple[bool, Views]:
    """`scan_hypotheses.views`, and whether there are any."""
    look, part, beam = ready.look, ready.look.part, found.beam
    rows, group, visibility = look.rows, np.zeros(len(found.fit), np.int64), ready.visibility
    if all_below(part.covariances, rows, TOGETHER * TOGETHER):
        return True, Views(group, visibility.copy().reshape(1, -1), rows)
    possible = visibility > HARDLY
    possible[rows] = False
    both = np.concatenate((rows, np.flatnonzero(possible)))
    joint, p = joint_in(scene, foreseen, part, both), ready.pairings
    arrays = (p.slots, p.measured, p.innovations, p.noise, joint, p.local, p.given)
    positions, covariances = updated(arrays, beam, part.positions[both])
    first = grouped(positions, np.argsort(-beam.score, kind="mergesort"), TOGETHER, group)
    width = len(first) * len(both)
    seen, fault = probabilities_in_view(
        positions[first].reshape(width, 2), covariances[first].reshape(width, 2, 2), *scene.sight, scene.pose[:3]
    )
    return fault < 0, Views(group, seen.reshape(len(first), len(both)), np.arange(len(rows)))
