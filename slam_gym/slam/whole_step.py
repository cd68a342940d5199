"""`Slam.asking_step` in one compiled call, where the associator is `jcbb`, `nearest_neighbour` or `singles`.

It is the page in `slam.slam` out of the same parts, for speed: calls and objects between them cost more than the
arithmetic. Whatever else may come (a number to be refused, a doubt about the pose) is left to the page, and the answer
says how far this one came.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._arrays import fill_from
from slam_gym._compile import compiled
from slam_gym.association.compatibility import distance_of, gate_pairings, paired_rows
from slam_gym.association.tracking.branch_and_bound import NODE_LIMIT, search_from_root
from slam_gym.association.tracking.nearest_neighbour import mutual, nearest
from slam_gym.mapping import ekf
from slam_gym.mapping.covisibility import among
from slam_gym.mapping.ekf import MapArrays
from slam_gym.mapping.foresight import Room, foresee, keep_rows
from slam_gym.mapping.measurement import joint_covariance
from slam_gym.slam.kernels import GraphArrays, ScanArrays, Settings, hold_back, learn, unambiguous
from slam_gym.types import UNPAIRED, Array, BoolArray, IntArray
from slam_gym.validation import first_bad_measurement

JCBB, NEAREST, SINGLES = range(3)  # forms of associators
LEFT_ALONE, PREDICTED, ANSWERED = -3, -2, -1  # how far it came, where it did not learn; else an answer of `learn`

Nature = tuple[bool, bool, float, float, float, float, bool]
"""Second order predictions; localities on offer; reach [m]; others in the gate of an old feature from which that is not
on offer; chance of being wrong above which pairings with old features are left to the page; fraction of the
measurements that must be paired if the scan is to be learned from at once; or whether any pairing will do."""


@compiled
def whole_step(
    form: int,
    arrays: MapArrays,
    numbers: tuple[int, int, int],
    graph: GraphArrays,
    recent: IntArray,
    turn: int,
    odometry: tuple[Array, Array],
    scan: ScanArrays,
    nature: Nature,
    gates: Array,
    settings: Settings,
    room: Room,
    pose: Array,
    out: tuple[IntArray, IntArray, BoolArray],
) -> tuple[int, int, int, int, int, float, int, int, int, bool]:
    """How far it came, the rows of the prediction, and of `learn` what there is to say and the features added; then of
    the associator its pairings, D²_H, nodes, individual and joint tests, and whether it met its limit.

    Where nothing was done, what there is to say is the width that the graph needs, or 0.

    Arguments:
        form: of the associator.
        numbers: features, steps and next id of the map.
        recent: (s, ≥ m) features of recent scans, or UNPAIRED; row `turn` is told those of this one.
        gates: (m + 1,) χ² gate of a hypothesis by its number of pairings.
        room: is told the prediction; `pose` (4,) the predicted one, and the variance of its heading.
        out: (m,) are told decisions, ids, and which measurements have started a feature.
    """
    (n, step, next_id), (second_order, offered, _, _, chance, fraction, any_will_do) = numbers, nature
    (neighbours, _, degrees), (x, P, counted, _), (features, ids, new) = graph, arrays, out
    known, _, near, positions, covariances, _ = room
    points, noise = scan[0], scan[1]
    m, local = len(points), neighbours if offered else neighbours[:0]
    no = m < 0  # what is called with literals is compiled for them once more
    k, needed = begin(arrays, numbers, graph, recent, odometry, scan, nature, gates[1], room, pose)
    if k < 0:
        return LEFT_ALONE, 0, needed, 0, 0, 0.0, 0, 0, 0, False
    expected = (known[0, :k], positions[:k], covariances[:k], near[:k])
    whole = (x, P, second_order, local, degrees, n)
    found = _decide(form, points, noise, expected, whole, gates, features)
    if not found.valid:
        return PREDICTED, k, 0, 0, 0, 0.0, 0, 0, 0, False
    answer = found.distance, found.nodes, found.individual_tests, found.joint_tests, found.limit_hit
    paired = 0
    for i in range(m):
        if features[i] != UNPAIRED:
            features[i] = known[0, features[i]]
            paired += 1
    if not is_plain(features, counted, settings[4], fraction, any_will_do):
        return ANSWERED, k, 0, 0, paired, *answer
    old = (known[0, :k], near[:k], positions[:k], covariances[:k])
    if chance < 1.0 and hold_back(features.copy(), old, counted, noise, gates[1], settings[4], chance):
        return ANSWERED, k, 0, 0, paired, *answer
    ended, what, added = learn(
        arrays, n, step, next_id, graph, recent[turn], scan, features, no, new, (expected[1], expected[2]),
        settings, ids,
    )  # fmt: skip
    return ended, k, what, added, paired, *answer


@compiled
def begin(
    arrays: MapArrays,
    numbers: tuple[int, int, int],
    graph: GraphArrays,
    recent: IntArray,
    odometry: tuple[Array, Array],
    scan: ScanArrays,
    nature: Nature,
    gate: float,
    room: Room,
    pose: Array,
) -> tuple[int, int]:
    """Predict; the rows of the prediction, and 0. Where nothing was done, −1, and the width that the graph needs or 0.

    `gate` is the χ² gate of a pairing; other arguments are those of `whole_step`.
    """
    (n, step, _), (second_order, offered, reach, ambiguous, _, _, _) = numbers, nature
    (neighbours, _, degrees), (x, P, _, _) = graph, arrays
    known, _, near, positions, _, _ = room
    m, local = len(scan[0]), neighbours if offered else neighbours[:0]
    yes = m >= 0  # what is called with literals is compiled for them once more
    _, fault = first_bad_measurement(scan[0], scan[1])
    needed = _widest(degrees, n) + m
    if fault or needed > neighbours.shape[1]:
        return -1, 0 if fault else needed
    k = foresee(arrays, n, step, yes, *odometry, reach, second_order, local, degrees, recent.ravel(), room)
    if k < 0:
        return -1, 0
    pose[0], pose[1], pose[2], pose[3] = x[0], x[1], x[2], P[2, 2]
    if ambiguous < math.inf:
        kept, worth = np.empty(k, np.int64), k * gate / (reach * reach)
        left = unambiguous(near[:k], positions[:k], known[0, :k], arrays, worth, ambiguous, kept)
        if left < k:
            keep_rows(room, kept[:left])
            k = left
    return k, 0


@compiled
def is_plain(features: IntArray, counted: IntArray, confirmations: int, fraction: float, any_will_do: bool) -> bool:
    """Whether the decisions (m,) pair so much with confirmed features that the scan is to be learned from at once."""
    paired = 0
    for feature in features:
        if feature != UNPAIRED:
            paired += counted[ekf.SEEN, feature] >= confirmations
    return paired >= fraction * len(features) or (any_will_do and paired > 0)


@compiled
def _widest(degrees: IntArray, n: int) -> int:
    """Neighbours of the node that has most."""
    most = 0
    for j in range(n):
        most = max(most, degrees[j])
    return most


class _Found(NamedTuple):
    """What an associator has decided, and what that took."""

    valid: bool  # False: some number is none that it could work with
    distance: float
    nodes: int
    individual_tests: int
    joint_tests: int
    limit_hit: bool


_Expected = tuple[IntArray, Array, Array, BoolArray]  # features, positions, covariances; which are near
_Whole = tuple[Array, Array, bool, IntArray, IntArray, int]  # x, P; second order; neighbours, degrees, nodes


@compiled
def _decide(
    form: int, points: Array, noise: Array, expected: _Expected, whole: _Whole, gates: Array, rows: IntArray
) -> _Found:
    """Enter in `rows` (m,) what the associator of this form pairs each measurement with, or UNPAIRED."""
    rows[:] = UNPAIRED
    if form == JCBB:
        found = _Found(True, 0.0, 0, 0, 0, False)
        for search in range(2):
            found = _searched(points, noise, expected, whole, gates, search == 0, found, rows)
            if not found.valid or len(whole[3]) == 0 or expected[3].all() or not (rows == UNPAIRED).any():
                break
        return found
    (features, positions, covariances, near), (x, P, second_order, _, _, _) = expected, whole
    every = np.arange(len(points))
    fault, _, starts, _, slots, _, _, offered, tests = gate_pairings(
        points, noise, positions, covariances, every, near[:0], gates[1]
    )
    if fault:
        return _Found(False, 0.0, 0, tests, 0, False)
    if form == NEAREST:
        fill_from(rows, nearest(len(points), starts, slots, offered))
    else:
        fill_from(rows, mutual(len(points), starts, slots, offered))
    distance, chosen = 0.0, paired_rows(rows)
    if len(chosen) > 0:
        distance = distance_of(points, noise, positions, rows, joint_covariance(x, P, features[chosen], second_order))
    return _Found(not math.isnan(distance), distance, len(rows), tests, 0, False)


@compiled
def _searched(
    points: Array,
    noise: Array,
    expected: _Expected,
    whole: _Whole,
    gates: Array,
    near: bool,
    before: _Found,
    rows: IntArray,
) -> _Found:
    """One of the two searches of `near_first`: what is `near`, or what is not for what was left unpaired before."""
    (features, positions, covariances, nearby), (x, P, second_order, neighbours, degrees, n) = expected, whole
    eligible = nearby if near else ~nearby
    if len(neighbours) == 0:
        eligible = eligible[:0]  # all of them
    fault, _, _, measured, slots, _, innovations, offered, tests = gate_pairings(
        points, noise, positions, covariances, np.flatnonzero(rows == UNPAIRED), eligible, gates[1]
    )
    tests += before.individual_tests
    if fault or not (near or len(slots) > 0):
        return _Found(fault == 0, before.distance, before.nodes, tests, before.joint_tests, before.limit_hit)
    paired = np.flatnonzero(rows != UNPAIRED)
    given = rows[paired]
    behind = np.concatenate((given, offered))
    local = np.empty((0, 0), np.bool_) if near else among(neighbours, degrees, n, features[behind])
    pairings = (
        np.concatenate((np.arange(len(given)), slots + len(given))),
        np.concatenate((paired, measured)),
        np.concatenate((points[paired] - positions[given], innovations)),
        noise,
        joint_covariance(x, P, features[behind], second_order),
        local,
        len(given),
    )
    distance, nodes, joint_tests, limit_hit = search_from_root(pairings, gates, int(NODE_LIMIT), None, behind, rows)
    joint_tests += before.joint_tests
    return _Found(True, distance, before.nodes + nodes, tests, joint_tests, before.limit_hit or limit_hit)
