"""Steps with an associator of the package that need no Python between prediction and update: see `whole_step`."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from slam_gym.association import jcbb, nearest_neighbour, singles
from slam_gym.association.compatibility import joint_gates
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.foresight import room_for
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.slam.kernels import Learned, ScanArrays, Settings
from slam_gym.slam.whole_step import ANSWERED, JCBB, LEFT_ALONE, NEAREST, PREDICTED, SINGLES, Nature, whole_step
from slam_gym.types import UNPAIRED, Array, Associator, Effort, Hypothesis, IntArray, Odometry, Prediction, Scan, View
from slam_gym.validation import check_shapes

_FORMS: tuple[tuple[Associator, int], ...] = ((jcbb, JCBB), (nearest_neighbour, NEAREST), (singles, SINGLES))


class Attempt(NamedTuple):
    """How far a step came."""

    prediction: Prediction
    hypothesis: Hypothesis | None  # None: the associator has something to refuse
    learned: Learned | None  # None: the scan was not learned from yet


def form_of(associate: Associator) -> int | None:
    """The number by which `whole_step` knows an associator; None: not at all."""
    for known, form in _FORMS:
        if associate is known:
            return form
    return None


def are_plain(odometry: Odometry, scan: Scan) -> bool:
    """Whether compiled functions take the arrays as they are; others are the page's business.

    Raises ValueError as `check_shapes`.
    """
    check_shapes(scan)
    arrays = odometry.motion, odometry.covariance, *arrays_of(scan)
    return all([array.flags.carray for array in arrays])


def attempt(
    m: StochasticMap,
    graph: CovisibilityGraph,
    recent: tuple[IntArray, int],
    odometry: Odometry,
    scan: Scan,
    form: int,
    nature: Nature,
    settings: Settings,
    view_from: Callable[[Array], View] | None,
) -> Attempt | None:
    """`whole_step` with a map and its graph, in which there is room for the scan; None where it did nothing.

    `recent`: features that recent scans paired, and the row in which those of this scan are to be entered.
    """
    count, room, pose, gates = len(scan.points), room_for(m.n), np.empty(4), joint_gates(len(scan), m.spec.confidence)
    features, ids, created = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count, np.bool_)
    ended = LEFT_ALONE
    while ended == LEFT_ALONE:
        ended, k, what, added, distance, nodes, tests, joint_tests, limit_hit = whole_step(
            form, m.arrays, (m.n, m.step, m.next_id), graph.arrays, *recent, (odometry.motion, odometry.covariance),
            arrays_of(scan), nature, gates, settings, room, pose, (features, ids, created),
        )  # fmt: skip
        if ended == LEFT_ALONE:
            if not what:
                return None
            graph.widen(what)
    stands, view = ended in (PREDICTED, ANSWERED), None if view_from is None else view_from(pose[:3])
    if stands:
        m.moved()
    prediction = m.foreseen(room, k, pose.item(3), graph if nature[1] else None, view, stands)
    if ended == PREDICTED:
        return Attempt(prediction, None, None)
    paired = count - int(np.count_nonzero(features == UNPAIRED))
    effort = Effort(nodes, tests, joint_tests, limit_hit)
    hypothesis = Hypothesis(features, distance, 2 * paired, effort, exclusive=form == JCBB)
    return Attempt(prediction, hypothesis, None if ended == ANSWERED else Learned(ended, what, added, ids, created))


def arrays_of(scan: Scan) -> ScanArrays:
    """A scan as compiled functions take it."""
    return scan.points, scan.covariances, scan.sizes, scan.size_variances, scan.kinds
