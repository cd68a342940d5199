"""Relocation as a walk of the interpretation tree: the actions of a walker and their effects.

One walk is one scan. At each level the walker pairs the current measurement with one of K candidates or with `*`;
`restart` returns to the root. Levels where only `*` is legal are passed automatically. At a leaf, and where the walker
restarts, the hypothesis is located and jointly tested, and the best so far is kept. At a leaf the walker may restart,
or stop (`*`): the best hypothesis is then the answer.
"""

from dataclasses import dataclass

import numpy as np

from slam_gym.association import walks
from slam_gym.association.acceptance import min_pairings
from slam_gym.association.relocation.constraints import Path, map_arrays
from slam_gym.association.relocation.problem import INDEX, answer_of, nothing_found, offer, problem_of
from slam_gym.association.relocation.tree import keep_what_follows, look_ahead
from slam_gym.association.walks import Observation, Order, squash
from slam_gym.types import UNPAIRED, Array, BoolArray, IntArray, Landmarks, Locality, Relocation, Scan
from slam_gym.validation import check_count, one_of

MEASUREMENT_FIELDS = ("present", *walks.MEASURED_FIELDS, "legal", "hidden")
"""Fields of the measurement to decide, in R. `legal`, `hidden`: numbers of legal candidates, and of those not shown."""

CANDIDATE_FIELDS = ("legal", "support", "bound", "mean", "worst", "size_difference", "covisibility")
"""Columns of `candidates`, best first. `support`: fraction of the undecided measurements that keep a legal feature
after this pairing; `bound`: fraction of the scan that the hypothesis could then pair; `mean`, `worst`: D² of its
distances to the pairings of the path; `size_difference` in σ; `covisibility`: fraction of the path's features that are
local to it."""

SCAN_FIELDS = ("present", "x", "y", "size", "decided", "paired", "candidates")
"""Columns of `scan`, one row for each measurement in the order of the levels."""

PATH_FIELDS = (
    "level",  # fraction of the measurements decided
    "pairings",  # fraction of the measurements paired
    "bound",  # fraction of the measurements that no hypothesis below this node exceeds
    "without",  # the bound below `*`
    "leaf",  # only stopping or restarting is left
    "compatible",  # the leaf passed the joint test
)
"""Fields of `path`: the decisions of this try, and what may follow."""

SEARCH_FIELDS = (
    "best",  # pairings of the best hypothesis so far, as a fraction
    "best_distance",  # its D² over its degrees of freedom
    "accepted",  # whether it would be accepted
    "needed",  # pairings required for acceptance, as a fraction
    "nodes_left",  # fraction of the node limit
    "tries",
)
"""Fields of `search`: the result of all tries so far."""

DISTANCE_SCALE = 2.0  # of D²
COUNT_SCALE = 4.0


@dataclass(frozen=True)
class WalkSpec:
    """Settings of a walk."""

    candidates: int = 8  # K on offer, those with most support
    order: Order = "fewest_candidates"
    node_limit: int = 300
    sizes: bool = True  # whether sizes are used
    confidence: float = 0.99  # of all constraints and of the joint test

    def __post_init__(self) -> None:
        check_count("candidates", self.candidates)
        check_count("node_limit", self.node_limit)
        one_of("order", self.order, walks.ORDERS)
        if not 0.0 < self.confidence < 1.0:
            raise ValueError(f"confidence: {self.confidence} is not between 0 and 1")

    @property
    def star(self) -> int:
        """The action `*`; at a leaf it stops the walk."""
        return self.candidates

    @property
    def restart(self) -> int:
        """The action that returns to the root."""
        return self.candidates + 1

    @property
    def actions(self) -> int:
        """Number of actions: K candidates, `*` and restart."""
        return self.candidates + 2


@dataclass(frozen=True, slots=True)
class RelocationNode:
    """The decisions that lead to a node, and the pairings that may still follow."""

    path: Path  # (p,) the pairings
    alive: BoolArray  # (m, n) pairings of undecided measurements that are legal after those of the path

    @property
    def pairings(self) -> int:
        """Number of pairings on the path."""
        return len(self.path.features)

    def bound_without(self, measurement: int | None) -> int:
        """Upper bound of the pairings of any hypothesis below this node that leaves `measurement`, if any, unpaired."""
        alive = self.alive
        if measurement is not None:
            alive = alive.copy()
            alive[measurement] = False
        return self.pairings + int(min(alive.any(axis=1).sum(), alive.any(axis=0).sum()))

    @property
    def hypothesis(self) -> IntArray:
        """Feature paired with each measurement (m,); UNPAIRED for `*` and for undecided measurements."""
        features = np.full(len(self.alive), UNPAIRED)
        features[self.path.measurements] = self.path.features
        return features


@dataclass(frozen=True, slots=True)
class RelocationBranches:
    """The features that a measurement may be paired with, by descending support, then ascending mean distance."""

    features: IntArray  # (b,)
    support: IntArray  # (b,) number of undecided other measurements that keep a legal feature after this pairing
    mean: Array  # (b,) mean (g_scan − g_map)² / (σ²_scan + σ²_map) of the distances to pairings of the path; 0 if none
    worst: Array  # (b,) their maximum
    local: Array  # (b,) fraction of the path's features that are local to this one; 1 without pairings


class RelocationWalk:
    """A walk through the tree of one scan, from the root until the walker stops or the node limit is reached.

    A node is counted at the root of every try and for every level decided, including levels passed automatically.
    Raises ValueError where scan, map or locality are bad.
    """

    def __init__(self, spec: WalkSpec, scan: Scan, landmarks: Landmarks, locality: Locality | None = None) -> None:
        if not spec.sizes:
            scan = Scan.from_points(scan.points, scan.covariances, kinds=scan.kinds)
        self.spec, self.scan, self.landmarks, self.locality = spec, scan, landmarks, locality
        self.problem = problem_of(scan, map_arrays(landmarks), locality, spec.confidence)
        self.problem.effort[INDEX.unary_tests] = self.problem.allowed.size
        self.needed = min_pairings(scan, landmarks, confidence=spec.confidence)
        self.done = False
        self._first_offer: RelocationBranches | None = None  # the same for every try
        self._kept = nothing_found(len(scan))
        self.order = walks.in_order(scan, spec.order, lambda: self.problem.allowed.sum(axis=1))  # (m,) level by level
        self.best = self.answer()
        self._begin()

    @property
    def level(self) -> int:
        """Number of measurements decided."""
        return len(self.offered)

    @property
    def measurement(self) -> int | None:
        """The measurement to decide; None at a leaf."""
        return None if self.at_leaf else int(self.order[self.level])

    @property
    def at_leaf(self) -> bool:
        """Whether only stopping or restarting is left."""
        return self.offer is None

    @property
    def shown(self) -> IntArray:
        """The features on offer, at most K; none at a leaf."""
        return self.order[:0] if self.offer is None else self.offer.features[: self.spec.candidates]

    @property
    def hidden(self) -> int:
        """Number of legal candidates that are not on offer because there are more than K."""
        return 0 if self.offer is None else len(self.offer.features) - len(self.shown)

    @property
    def nodes(self) -> int:
        """Number of nodes used so far."""
        return int(self.problem.effort[INDEX.nodes])

    @property
    def tries(self) -> int:
        """Number of walks from the root, including this one."""
        return int(self.problem.effort[INDEX.tries])

    @property
    def mask(self) -> BoolArray:
        """(K + 2,) the legal actions. `*` always is; restart is legal once the walker has made a decision."""
        legal = np.arange(self.spec.actions) < len(self.shown)
        legal[self.spec.star] = not self.done
        legal[self.spec.restart] = not self.done and any(shown for shown, _ in self.offered)
        return legal

    def action_of(self, feature: int) -> int | None:
        """The action that pairs the current measurement with `feature` (UNPAIRED: `*`); None if it is not on offer."""
        if feature == UNPAIRED:
            return self.spec.star
        matches = np.flatnonzero(self.shown == feature)
        return int(matches[0]) if len(matches) else None

    def take(self, action: int) -> None:
        """Carry out an action. Raises ValueError for an action that is not legal, and once the walk is done."""
        legal = self.mask
        if not (0 <= action < len(legal) and legal[action]):
            raise ValueError(f"action {action!r} is not legal; mask: {legal.tolist()}")
        if action == self.spec.restart:
            if not self.at_leaf:
                self._judge()
            self._begin()
        elif self.at_leaf:
            self.done = True
        else:
            self._decide(action)
            self._go_on()
        self.done |= self._spent

    def answer(self) -> Relocation:
        """The relocation by the best hypothesis so far, or without any pairing if there is none."""
        return answer_of(self._kept, self.problem, self.needed, 0.0)

    def _begin(self) -> None:
        """Start a new try from the root."""
        nothing = np.empty(0, np.int64)
        self.node = RelocationNode(Path(nothing, nothing), self.problem.allowed)
        self.compatible: bool | None = None  # at a leaf: whether the hypothesis passes the joint test
        self.offered: list[tuple[int, int]] = []  # of each level decided: candidates on offer, action taken
        self.problem.effort[INDEX.nodes] += 1
        self.problem.effort[INDEX.tries] += 1
        self.offer: RelocationBranches | None = None  # the ranked features for the measurement; None at a leaf
        self._go_on()

    def _decide(self, action: int) -> None:
        i, path, alive = self.order[self.level], self.node.path, self.node.alive.copy()
        alive[i] = False
        if action != self.spec.star:
            path = Path(np.append(path.measurements, i), np.append(path.features, self.shown[action]))
            keep_what_follows(self.problem, alive, path)
        self.node = RelocationNode(path, alive)
        self.offered.append((len(self.shown), action))
        self.problem.effort[INDEX.nodes] += 1

    def _go_on(self) -> None:
        """Pass the levels without a choice; then make the offer of the next level, or judge the leaf."""
        self.offer, m, at_root = None, len(self.scan), not self.offered
        while self.level < m and not self._spent and not self.node.alive[self.order[self.level]].any():
            self._decide(self.spec.star)
        if self._spent or self.level == m:
            self.problem.effort[INDEX.limit_hit] = self._spent
            self.compatible = self._judge()
        elif at_root and self._first_offer is not None:
            self.offer = self._first_offer
        else:
            i, alive = int(self.order[self.level]), self.node.alive
            features = np.flatnonzero(alive[i])
            support, figures = look_ahead(self.problem, alive, self.node.path, i, features)
            order = np.lexsort((figures[:, 0], -support))
            self.offer = RelocationBranches(features[order], support[order], *figures[order].T)
            self._first_offer = self._first_offer or self.offer

    @property
    def _spent(self) -> bool:
        return self.nodes >= self.spec.node_limit

    def _judge(self) -> bool:
        """Locate and test the hypothesis of the path, keep it if none has more pairings; return whether it passes."""
        self.problem.effort[INDEX.leaves] += 1
        holds = offer(self._kept, self.problem, self.node.path, self.node.pairings)
        if holds:
            self.best = self.answer()
        return holds


def walk_shapes(candidates: int, measurements: int) -> dict[str, tuple[int, int]]:
    """Rows and columns of each part of the observation, for K `candidates` and scans of at most `measurements`."""
    return {
        "measurement": (1, len(MEASUREMENT_FIELDS)),
        "candidates": (candidates, len(CANDIDATE_FIELDS)),
        "scan": (measurements, len(SCAN_FIELDS)),
        "path": (1, len(PATH_FIELDS)),
        "search": (1, len(SEARCH_FIELDS)),
    }


def observe_walk(walk: RelocationWalk, measurements: int) -> Observation:
    """The parts of `walk_shapes`, flat, in [−1, 1]. Of a longer scan, the first `measurements` levels are shown."""
    shapes = walk_shapes(walk.spec.candidates, measurements)
    parts = {name: np.zeros(shape, np.float32) for name, shape in shapes.items()}
    scan, node, offer, best, m = walk.scan, walk.node, walk.offer, walk.best, max(len(walk.scan), 1)
    if offer is not None:
        i, shown, support = int(walk.order[walk.level]), walk.shown, offer.support[: len(walk.shown)]
        counts = squash(len(offer.features), COUNT_SCALE), squash(walk.hidden, COUNT_SCALE)
        parts["measurement"][0] = 1.0, *walks.measurement_shown(scan, i), *counts
        variances = np.maximum(scan.size_variances[i] + walk.landmarks.size_variances[shown], 1e-12)
        difference = (scan.sizes[i] - walk.landmarks.sizes[shown]) / np.sqrt(variances)
        parts["candidates"][: len(shown)] = np.column_stack(
            [
                np.ones(len(shown)),
                support / max(m - walk.level - 1, 1),
                (node.pairings + 1 + support) / m,
                squash(offer.mean[: len(shown)], DISTANCE_SCALE),
                squash(offer.worst[: len(shown)], DISTANCE_SCALE),
                np.nan_to_num(squash(difference, 1.0)),
                offer.local[: len(shown)],
            ]
        )
    levels = walk.order[:measurements]
    parts["scan"][: len(levels)] = np.column_stack(
        [
            np.ones(len(levels)),
            squash(scan.points[levels], walks.POSITION_SCALE),
            squash(np.nan_to_num(scan.sizes[levels]), walks.SIZE_SCALE),
            np.arange(len(levels)) < walk.level,
            np.isin(levels, node.path.measurements),
            squash(node.alive[levels].sum(axis=1), COUNT_SCALE),
        ]
    )
    of_path = np.array([walk.level, node.pairings, node.bound_without(None), node.bound_without(walk.measurement)])
    parts["path"][0] = *(of_path / m), walk.at_leaf, bool(walk.compatible)
    distance, tries = best.joint_distance / max(best.dof, 1), squash(walk.tries - 1, COUNT_SCALE)
    needed, left = min(walk.needed / m, 1.0), 1.0 - walk.nodes / walk.spec.node_limit
    parts["search"][0] = best.pairings / m, squash(distance, DISTANCE_SCALE), best.accepted, needed, left, tries
    return {name: part.ravel() for name, part in parts.items()}
