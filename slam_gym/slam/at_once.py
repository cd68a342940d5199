"""Steps with an associator of the package that need no Python between prediction and update: see `whole_step`."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any, cast

import numpy as np

from slam_gym.association import jcbb, learned_associator, marginal, nearest_neighbour, singles
from slam_gym.association.compatibility import chi2_gate, joint_gates, plain
from slam_gym.association.learned.associator import learned_odds
from slam_gym.association.learned.inputs import run_so_far
from slam_gym.association.tracking.marginal import posterior_of
from slam_gym.association.tracking.marginals import DETECTIONS, NOTHING_SEEN, experience_after
from slam_gym.association.tracking.scan_hypotheses import candidate_gate
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.foresight import Outlook, room_for
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.navigation.visibility import ViewsFrom
from slam_gym.slam.kernels import Learned, ScanArrays, Settings
from slam_gym.slam.marginal_step import marginal_step
from slam_gym.slam.whole_step import ANSWERED, JCBB, LEFT_ALONE, NEAREST, PREDICTED, SINGLES, Nature, whole_step
from slam_gym.types import (
    UNPAIRED,
    Array,
    Associator,
    Effort,
    Expectation,
    Experience,
    Hypothesis,
    IntArray,
    Odometry,
    Prediction,
    Scan,
    View,
)
from slam_gym.validation import check_shapes

MARGINAL, LEARNED = SINGLES + 1, SINGLES + 2  # forms of associators that `marginal_step` takes
_FORMS: tuple[tuple[Associator, int], ...] = (
    (jcbb, JCBB), (nearest_neighbour, NEAREST), (singles, SINGLES), (marginal, MARGINAL), (learned_associator, LEARNED),
)  # fmt: skip
_NETWORK = tuple(np.empty(shape) for shape in (0, 0, 0, 0, (0, 0), 0, (0, 0), 0, 0))  # that nothing was learned by
_TOLD_NOTHING = (0.0, 0.0)


Attempt = tuple[Expectation, Hypothesis | None, Learned | None]
"""How far a step came: what it expected; None: the associator has something to refuse; None: the scan was not learned
from yet."""


def form_of(associate: Associator) -> int | None:
    """The number by which `whole_step` knows an associator; None: not at all."""
    for known, form in _FORMS:
        if associate is known:
            return form
    return None


def may_be_at_once(form: int, view_from: Callable[[Array], View] | None, experience: Experience | None) -> bool:
    """Whether compiled functions know what the associator may ask for: those that weigh what is in view must be able
    to look there themselves, and the others have no use for experience."""
    return isinstance(view_from, ViewsFrom) if weighs_all(form) else experience is None


def weighs_all(form: int) -> bool:
    """Whether the associator weighs all hypotheses, and says what it learns from scan to scan."""
    return form in (MARGINAL, LEARNED)


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
    experience: Experience | None,
) -> Attempt | None:
    """`whole_step`, or `marginal_step`, with a map and its graph, in which there is room for the scan.

    None where it did nothing. `recent`: features that recent scans paired, and the row in which those of this scan are
    to be entered; `experience` is that of the associator.
    """
    if form in (MARGINAL, LEARNED):
        return _by_marginals(
            m, graph, recent, odometry, scan, form == LEARNED, nature, settings, cast(ViewsFrom, view_from), experience
        )
    count, room, pose, gates = (
        len(scan.points),
        room_for(m.n),
        np.empty(4),
        joint_gates(len(scan.points), m.spec.confidence),
    )
    features, ids, created = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count, np.bool_)
    ended = LEFT_ALONE
    while ended == LEFT_ALONE:
        ended, k, what, added, paired, distance, nodes, tests, joint_tests, limit_hit = whole_step(
            form, m.arrays, (m.n, m.step, m.next_id), graph.arrays, *recent, (odometry.motion, odometry.covariance),
            arrays_of(scan), nature, gates, settings, room, pose, (features, ids, created),
        )  # fmt: skip
        if ended == LEFT_ALONE:
            if not what:
                return None
            graph.widen(what)
    outlook = Outlook(room, k, pose, m.spec, graph if nature[1] else None, view_from)
    if ended == PREDICTED:
        return _standing(m, outlook), None, None
    effort = Effort(nodes, tests, joint_tests, limit_hit)
    hypothesis = Hypothesis(features, distance, 2 * paired, effort, exclusive=form == JCBB)
    if ended == ANSWERED:
        return _standing(m, outlook), hypothesis, None
    return outlook, hypothesis, (ended, what, added, ids, created)


def _standing(m: StochasticMap, outlook: Outlook) -> Prediction:
    """The prediction of a map that has moved, but not learned yet."""
    m.moved()
    return m.foreseen(outlook)


def _by_marginals(
    m: StochasticMap,
    graph: CovisibilityGraph,
    recent: tuple[IntArray, int],
    odometry: Odometry,
    scan: Scan,
    learned: bool,
    nature: Nature,
    settings: Settings,
    view_from: ViewsFrom,
    experience: Experience | None,
) -> Attempt | None:
    """`marginal_step`; see `attempt`."""
    count, room, pose, known = len(scan.points), room_for(m.n), np.empty(4), experience or NOTHING_SEEN
    features, ids, runner_up = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count, np.int64)
    created, new, by_value = np.empty(count, np.bool_), np.empty(count, np.bool_), np.empty(len(DETECTIONS))
    probabilities, unpaired = np.empty(count), np.empty(count)
    (rule, network), told = _rule(m.spec.confidence, learned), run_so_far(experience) if learned else _TOLD_NOTHING
    out = features, ids, created, probabilities, new, runner_up, unpaired, by_value
    past, ended = (known.unpaired, known.area, DETECTIONS, plain(known.detections), *told), LEFT_ALONE
    while ended == LEFT_ALONE:
        ended, k, what, added, figures, effort = marginal_step(
            m.arrays, (m.n, m.step, m.next_id), graph.arrays, *recent, (odometry.motion, odometry.covariance),
            arrays_of(scan), nature, chi2_gate(2, m.spec.confidence), settings, room, pose, view_from.arrays, past,
            rule, network, out,
        )  # fmt: skip
        if ended == LEFT_ALONE:
            if not what:
                return None
            graph.widen(what)
    outlook = Outlook(room, k, pose, m.spec, graph if nature[1] else None, view_from, experience)
    if ended == PREDICTED:
        return _standing(m, outlook), None, None
    distance, own, second, total, area = figures
    paired = count - int(np.count_nonzero(features == UNPAIRED))
    hypothesis = Hypothesis(
        features, distance, 2 * paired, Effort(*effort),
        posterior_of(own, second, total, runner_up, probabilities, unpaired), new=new,
        experience=experience_after(known, unpaired, area, by_value),
    )  # fmt: skip
    if ended == ANSWERED:
        return _standing(m, outlook), hypothesis, None
    return outlook, hypothesis, (ended, what, added, ids, created)


@functools.cache
def _rule(confidence: float, learned: bool) -> tuple[Any, Any]:
    """What `marginal_step` takes as its rule and its network: what `marginal` or `learned_associator` has by itself."""
    told = defaults_of(marginal) | (defaults_of(learned_associator) if learned else {})
    cost, provisional = told["cost"], told["provisional_cost"]
    least = cost if provisional is None else min(cost, provisional)
    prices = [price / (price + 1.0) for price in (cost, cost, least)]
    gate = chi2_gate(2, candidate_gate(confidence))
    rule = (*prices, told["unseen"], told["width"], told["margin"], gate)
    return rule, learned_odds(told["weights"]).network[:] if learned else _NETWORK


def defaults_of(function: Callable[..., Any]) -> dict[str, Any]:
    """The arguments that may be left out, with what they are then."""
    every = inspect.signature(function).parameters.values()
    return {one.name: one.default for one in every if one.default is not inspect.Parameter.empty}


def arrays_of(scan: Scan) -> ScanArrays:
    """A scan as compiled functions take it."""
    return scan.points, scan.covariances, scan.sizes, scan.size_variances, scan.kinds
