"""The k best hypotheses of a scan, found by beam search, and their weights.

A hypothesis H over a scan has the density (up to a constant)

    N(ν_H; 0, S_H) · λ^unpaired · Π over paired j of P_D v_j · Π over the other predicted j of (1 − P_D v_j)

with λ [1/m²] the density of measurements of nothing in the map (clutter and new features together), P_D the probability
that the detector reports a feature in view, and v_j the probability that feature j is in view from the pose that the
hypothesis itself implies, and faces the robot (`mapping.measurement`); walls, and the direction of the robot, are those
of the predicted pose. Where visibility is unknown, nothing is concluded from features that were not seen: the factors
are P_D for paired and 1 for other features.

The normalised densities of all hypotheses (`weighed`) yield the marginal probability of every pairing, as in joint
probabilistic data association: the sum of the weights of the hypotheses that make it.

Where the robot is nearly lost, everything is compatible with everything. The work for a scan is therefore bounded: only
the nearest candidates of each measurement are kept, `MOST_CANDIDATES` in all, and the beam is as wide as `JOINT_TESTS`
and `MEMORY` allow. `effort.limit_hit` is set where a bound may have excluded anything. A measurement that may have lost
candidates starts no feature.
"""

import math
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.compatibility import chi2_gate
from slam_gym.association.prediction import Expected, Prediction
from slam_gym.association.tracking.beam import Beam, updated
from slam_gym.association.tracking.beam import search as beam_search
from slam_gym.association.tracking.headings import Part, joint_in
from slam_gym.association.tracking.near_first import Offer
from slam_gym.association.tree import Node, Pairings, condition, is_local, pivot_of, read, root_of, squared
from slam_gym.navigation.visibility import probabilities_in_view
from slam_gym.types import UNPAIRED, Array, IntArray, Scan
from slam_gym.validation import check_count

UNSEEN = 0.05  # least v_j of a paired feature: the visibility may be wrong
SAME_VIEW = 0.1  # [m] hypotheses that differ by less share their visibilities
MOST_CANDIDATES = 1_000  # pairings of a scan that are considered
JOINT_TESTS = 300_000  # for a scan
_DEEP = 32  # pairings, up to which all joint tests are taken to cost the same
MEMORY = 1 << 27  # [bytes] for the pairings of all hypotheses, each conditioned on those before it
_INVISIBLE = 1e-3  # features less likely to be seen from the predicted pose are not looked up from others
_MIN_AREA = 1.0  # [m²] least area of a scan


class Limits(NamedTuple):
    """The bounds of a search."""

    gate: float  # χ² of candidates
    width: int  # hypotheses kept at each level
    margin: float  # hypotheses that score this much less than the best are dropped
    most: int  # candidates of each measurement, the nearest


class ScanProblem(NamedTuple):
    """The problem of a search: the pairings of a scan with the features in reach, in one heading."""

    part: Part
    offer: Offer
    levels: IntArray  # (l, 2) first and end index of the pairings of each measurement with any, in order of decision
    visible: Array  # (k,) probability of being in view from the predicted pose; (0,): unknown
    detection: float  # P_D
    density: float  # [1/m²] λ of measurements of nothing in the map


class SearchResult(NamedTuple):
    """The hypotheses that a search kept, in no particular order."""

    beam: Beam
    rows: IntArray  # (b, m) row of the prediction that each hypothesis pairs with each measurement, or UNPAIRED
    fit: Array  # (b,) log N(ν_H; 0, S_H), plus the log odds of its pairings
    unpaired: IntArray  # (b,) number of measurements left unpaired
    nodes: int
    tests: int  # joint tests
    cut: bool  # whether the beam was full


class Weighed(NamedTuple):
    """The hypotheses of one or several searches, and sums over all of them."""

    hypotheses: IntArray  # (b, m) row of the prediction that each pairs with each measurement, or UNPAIRED
    scores: Array  # (b,) log densities, summed over P_D
    weights: Array  # (b,) normalised densities
    by_value: Array  # (d,) log weights of the values of P_D
    pairings: Array  # (m, k) p_ij
    unpaired: Array  # (m,) probability that each measurement comes from nothing in the map


PosteriorFields = tuple[float, float, IntArray, float, Array, Array]
"""The fields of `Posterior`, as compiled code returns them."""

LimitFields = tuple[float, int, float, int]
"""The fields of `Limits`, as compiled code takes them."""


def limits_of(scan: Scan, prediction: Prediction, width: int, margin: float) -> LimitFields:
    """The fields of `Limits`. The confidence of the gate is ten times as close to 1 as that of the prediction, 0.999
    for 0.99, since improbable pairings have a low density anyway. Raises ValueError for bounds out of range."""
    check_count("width", width)
    if not margin > 0.0:
        raise ValueError(f"margin: {margin} is not positive")
    most = max(MOST_CANDIDATES // max(len(scan), 1), 1)
    return chi2_gate(2, 1.0 - 0.1 * (1.0 - prediction.confidence)), width, float(margin), most


@compiled
def affordable(width: int, problems: list[ScanProblem]) -> int:
    """The width of the beam: `width`, or what `JOINT_TESTS` and `MEMORY` allow if all these problems are searched.

    A test below many pairings costs more: it conditions one on all of them."""
    tests, size = 1, 1
    for problem in problems:
        offer = problem.offer
        nodes = len(problem.levels) + offer.pairings.fixed + 1
        place = min(nodes, len(offer.rows) + offer.pairings.fixed + 1)
        tests += len(offer.pairings.slots) * max(nodes // _DEEP, 1) ** 2
        size += 32 * place * nodes  # bytes of the w of a hypothesis
    return max(min(width, JOINT_TESTS // tests, MEMORY // size), 1)


@compiled
def search_tree(problem: ScanProblem, odds: Array, width: int, margin: float) -> SearchResult:
    """The hypotheses of greatest density, seen from the predicted pose, with extra log odds (c,) of pairings, or none
    (0,).

    Measurements without a candidate are `*` in all hypotheses. `width` and `margin` as in `Limits`.
    """
    (pairings, starts, rows, _), detection, visible = problem.offer, problem.detection, problem.visible
    gains = np.full(len(pairings.slots), math.log(detection))
    for c in range(len(gains) if len(visible) > 0 else 0):
        v = visible[rows[pairings.slots[c]]]
        gains[c] += math.log(max(v, UNSEEN)) - math.log1p(-detection * v)
    offered, star = gains + odds if len(odds) > 0 else gains, math.log(problem.density)
    beam, nodes, tests, cut = beam_search(pairings, problem.levels, offered, star, width, margin)
    fit, unpaired = beam.score.copy(), np.empty(len(beam.score), np.int64)
    decided = np.full((len(fit), len(pairings.noise)), UNPAIRED)
    for b in range(len(fit)):
        paired = beam.pairings[b] - pairings.fixed
        unpaired[b] = len(starts) - 1 - paired
        fit[b] -= (len(problem.levels) - paired) * star
        for q in range(pairings.fixed, beam.pairings[b]):
            fit[b] -= gains[beam.made[b, q]]
        for c in beam.made[b, : beam.pairings[b]]:
            decided[b, pairings.measured[c]] = rows[pairings.slots[c]]
    return SearchResult(beam, decided, fit, unpaired, nodes, tests, cut)


@compiled
def levels_of(pairings: Pairings, starts: IntArray, gate: float) -> IntArray:
    """`ScanProblem.levels`: measurements whose candidates have most support come first. Support is the number of other
    measurements with a candidate within the gate after an update with that single pairing."""
    root, count, others = root_of(pairings), 0, np.count_nonzero(starts[1:] > starts[:-1]) - 1
    order_keys, levels = np.zeros(len(starts) - 1, np.int64), np.empty((len(starts) - 1, 2), np.int64)
    for i in range(len(starts) - 1):
        first, last = pairings.fixed + starts[i], pairings.fixed + starts[i + 1]
        for c in range(first, last):
            if order_keys[count] > -others:
                order_keys[count] = min(order_keys[count], -_support(pairings, root, c, gate))
        if first < last:
            levels[count, 0], levels[count, 1] = first, last
            count += 1
    return levels[np.argsort(order_keys[:count], kind="mergesort")]


@compiled
def _support(pairings: Pairings, root: Node, anchor: int, gate: float) -> int:
    """The support of a pairing."""
    p, slots, measured = pairings.fixed, pairings.slots, pairings.measured
    if root.added[anchor] == math.inf:
        return 0
    pivot, support, last = pivot_of(slots[anchor], read(root.innovations, anchor)), 0, measured[anchor]
    for c in range(p, len(slots)):
        if measured[c] == last or measured[c] == measured[anchor] or slots[c] == slots[anchor]:
            continue
        if not is_local(pairings.local, slots[anchor], slots[c]):
            continue
        e = condition(pairings.covariance, root.w, pivot, anchor, p, c, slots[c], read(root.innovations, c))
        if squared(e) < gate:
            support, last = support + 1, measured[c]
    return support


@compiled
def _views(expected: Expected, problem: ScanProblem, beam: Beam, together: float) -> tuple[IntArray, Array, IntArray]:
    """Group hypotheses that imply the same view: the group (b,) of each hypothesis; the visibility (groups, q) of the
    features of the tree and of others for each group, (0, 0) where unknown; and the columns of the features of the tree
    (u,) by slot.

    Hypotheses share a view where they place every feature within `together` [m] of each other. All share one where the
    features are predicted that precisely, or where visibility does not depend on the pose.
    """
    part, rows, visible = problem.part, problem.offer.rows, problem.visible
    group, narrow = np.zeros(len(beam.score), np.int64), together > 0.0
    if len(visible) == 0:
        return group, np.empty((0, 0)), rows
    for j in rows:
        narrow &= max(part.covariances[j, 0, 0], part.covariances[j, 1, 1]) < together * together
    if len(expected.visible) > 0 or not expected.view_moves or narrow:
        return group, visible.copy().reshape(1, -1), rows
    possible = visible > _INVISIBLE
    possible[rows] = False
    both = np.concatenate((rows, np.flatnonzero(possible)))
    joint, slots = joint_in(expected, part, both), problem.offer.pairings.slots
    positions, covariances = updated(joint, slots, beam, part.positions[both])
    leaders = _grouped(positions, np.argsort(-beam.score, kind="mergesort"), together, group)
    width = len(leaders) * len(both)
    means, spreads = positions[leaders].reshape(width, 2), covariances[leaders].reshape(width, 2, 2)
    in_view = probabilities_in_view(means, spreads, expected.sight, expected.pose[:3])
    return group, expected.facing[both] * in_view.reshape(len(leaders), len(both)), np.arange(len(rows))


@compiled
def weighed_by_view(expected: Expected, problem: ScanProblem, beam: Beam, detections: Array, together: float) -> Array:
    """log Π P_D v_j · Π (1 − P_D v_j) (b, d) of each hypothesis, for each P_D of `detections`.

    Hypotheses that place every feature within `together` [m] of each other share a view.
    """
    slots, pairings, made = problem.offer.pairings.slots, beam.pairings, beam.made
    group, visible, columns = _views(expected, problem, beam, together)
    out, (groups, features) = np.empty((len(made), len(detections))), visible.shape
    missed, paired = np.empty(features), np.empty((groups, len(columns)))
    for g in range(groups):
        for s in range(len(columns)):
            paired[g, s] = math.log(max(visible[g, columns[s]], UNSEEN))
    for d in range(len(detections)):
        P = detections[d]
        log_P = math.log(P)
        for b in range(len(made)):
            out[b, d] = pairings[b] * log_P
        for g in range(groups):
            none_seen = 0.0
            for j in range(features):
                missed[j] = math.log1p(-P * visible[g, j])
                none_seen += missed[j]
            for b in range(len(made)):
                if group[b] != g:
                    continue
                out[b, d] += none_seen
                for q in range(pairings[b]):
                    s = slots[made[b, q]]
                    out[b, d] += paired[g, s] - missed[columns[s]]
    return out


@compiled
def _grouped(positions: Array, order: IntArray, together: float, group: IntArray) -> IntArray:
    """Write the `group` of each hypothesis, by its feature positions (b, k, 2); return the first one of each group."""
    first, count = np.empty(len(positions), np.int64), 0
    for b in order:
        group[b] = -1
        for g in range(count):
            other, same = first[g], True
            for k in range(positions.shape[1]):
                x, y = positions[b, k, 0] - positions[other, k, 0], positions[b, k, 1] - positions[other, k, 1]
                if not x * x + y * y < together * together:
                    same = False
                    break
            if same:
                group[b] = g
                break
        if group[b] < 0:
            group[b], first[count] = count, b
            count += 1
    return first[:count]


@compiled
def weighed(hypotheses: IntArray, fit: Array, view_terms: Array, prior: Array, features: int) -> Weighed:
    """The probability of every pairing, over all `hypotheses` (b, m) and all values of P_D with log weights `prior`
    (d,), by log densities `fit` (b,) and their visibility terms (b, d)."""
    count, values = view_terms.shape
    scores, by_value = np.empty(count), np.full(values, -math.inf)
    for b in range(count):
        scores[b] = -math.inf
        for d in range(values):
            density = fit[b] + view_terms[b, d] + prior[d]
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
    return Weighed(hypotheses, scores, weights, by_value - by_value.max(), pairings, unpaired)


@compiled
def posterior_of(expected: Expected, sums: Weighed, rows: IntArray) -> PosteriorFields:
    """Posterior of the decision `rows` (m,), and of the most probable other decision among the hypotheses.

    Hypotheses of several headings may make the same decision. Their weights are added to the first of them; the
    decision itself comes first of all.
    """
    decisions = np.concatenate((rows.copy().reshape(1, -1), sums.hypotheses))
    keys, weights = np.zeros(len(decisions), np.int64), np.zeros(len(decisions))
    for b in range(len(decisions)):
        for row in decisions[b]:
            keys[b] = keys[b] * 1_000_003 + row  # a hash, to compare few pairs in full
        first = 0
        while keys[first] != keys[b] or (first < b and (decisions[first] != decisions[b]).any()):
            first += 1
        if b > 0:
            weights[first] += sums.weights[b - 1]
    second = 1 + np.argmax(weights[1:])
    runner_up, marginals = np.full(len(rows), UNPAIRED), sums.unpaired.copy()
    for i in range(len(rows)):
        if weights[second] > 0.0 and decisions[second, i] != UNPAIRED:
            runner_up[i] = expected.features[decisions[second, i]]
        if rows[i] != UNPAIRED:
            marginals[i] = min(sums.pairings[i, rows[i]], 1.0)
    most = sums.scores.max()
    total = most + math.log(np.exp(sums.scores - most).sum())
    log_density = total + math.log(weights[0]) if weights[0] > 0.0 else -math.inf
    return log_density, weights[0], runner_up, weights[second], marginals, sums.unpaired


@compiled
def scan_area(points: Array) -> float:
    """[m²] area that a scan covers; 0 without measurements. It is that of the bounding box of the measurements (m, 2),
    but at least that of a sector of one radian to either side, from the robot to the farthest measurement.

    The bounding box of one or two measurements is far too small, which would make rare objects look frequent.
    """
    if len(points) == 0:
        return 0.0
    left, right, bottom, top = points[0, 0], points[0, 0], points[0, 1], points[0, 1]
    farthest = 0.0  # squared
    for x, y in points:
        left, right, bottom, top = min(left, x), max(right, x), min(bottom, y), max(top, y)
        farthest = max(farthest, x * x + y * y)
    return float(max((right - left) * (top - bottom), farthest, _MIN_AREA))
