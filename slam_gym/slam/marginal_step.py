"""`Slam.asking_step` in one compiled call, where the associator is `marginal`, with learned odds or without.

As `whole_step`, which leaves to the page what this one does; they are compiled apart, for this one takes longer.
"""

from __future__ import annotations

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.learned.network import Network
from slam_gym.mapping.ekf import MapArrays
from slam_gym.mapping.foresight import Room
from slam_gym.navigation.visibility import SightArrays
from slam_gym.slam.by_marginals import Past, Rule, decide_by_marginals
from slam_gym.slam.kernels import GraphArrays, ScanArrays, Settings, learn
from slam_gym.slam.narrow_headings import Foreseen, Scene
from slam_gym.slam.whole_step import ANSWERED, LEFT_ALONE, PREDICTED, Nature, begin, is_plain
from slam_gym.types import Array, BoolArray, IntArray

Out = tuple[IntArray, IntArray, BoolArray, Array, BoolArray, IntArray, Array, Array]
"""What is told of the measurements (m,): decisions, ids, which started a feature, the probabilities of the decisions,
which are new, the runner-up, the probability that they are of nothing in the map; then (d,) the log weights of P_D."""


@compiled
def marginal_step(
    arrays: MapArrays,
    numbers: tuple[int, int, int],
    graph: GraphArrays,
    recent: IntArray,
    turn: int,
    odometry: tuple[Array, Array],
    scan: ScanArrays,
    nature: Nature,
    gate: float,
    settings: Settings,
    room: Room,
    pose: Array,
    sight: SightArrays,
    past: tuple[float, float, Array, Array, float, float],
    rule: tuple[float, float, float, float, int, float, float],
    network: tuple[Array, Array, Array, Array, Array, Array, Array, Array, Array],
    out: Out,
) -> tuple[int, int, int, int, tuple[float, float, float, float, float], tuple[int, int, int, bool]]:
    """`whole_step.whole_step` with `marginal` for associator; from the fifth on, what `Decisions` has as `figures` and
    `effort`. `past`, `rule` and `network` are those tuples, the last one of empty arrays where nothing is learned."""
    (n, step, next_id), (second_order, _, _, _, _, fraction, any_will_do) = numbers, nature
    features, ids, created, probabilities, new, runner_up, unpaired, by_value = out
    nothing, yes = ((0.0, 0.0, 0.0, 0.0, 0.0), (0, 0, 0, False)), turn >= 0
    k, needed = begin(arrays, numbers, graph, recent, odometry, scan, nature, gate, room, pose)
    if k < 0:
        return LEFT_ALONE, 0, needed, 0, *nothing
    known, sizes, near, positions, covariances, across = room
    foreseen = Foreseen(
        known[0, :k], sizes[0, :k], sizes[1, :k], known[1, :k], known[2, :k], known[3, :k], near[:k], positions[:k],
        covariances[:k], across[:k], pose[3],
    )  # fmt: skip
    told, thresholds = Rule(*rule), np.empty(k)
    for row in range(k):
        thresholds[row] = told.pairing if known[3, row] >= settings[4] else told.provisional
    scene = Scene(arrays[0], arrays[1], second_order, sight, pose)
    valid, answer = decide_by_marginals(scan, foreseen, scene, Past(*past), told, thresholds, Network(*network))
    if not valid:
        return PREDICTED, k, 0, 0, *nothing
    for i in range(len(features)):
        features[i], probabilities[i], new[i] = answer.features[i], answer.probabilities[i], answer.new[i]
        created[i], runner_up[i], unpaired[i] = answer.new[i], answer.runner_up[i], answer.unpaired[i]
    by_value[:] = answer.by_value
    if not is_plain(features, arrays[2], settings[4], fraction, any_will_do):
        return ANSWERED, k, 0, 0, answer.figures, answer.effort
    ended, what, added = learn(
        arrays, n, step, next_id, graph, recent[turn], scan, features, yes, created,
        (foreseen.positions, foreseen.covariances), settings, ids,
    )  # fmt: skip
    return ended, k, what, added, answer.figures, answer.effort
