"""Relocation as a walk of the interpretation tree: the actions of a walker and their effects.

One walk is one scan. At each level the walker pairs the current measurement with one of K candidates or with `*`;
`restart` returns to the root. Levels where only `*` is legal are passed automatically. At a leaf, and where the walker
restarts, the hypothesis is located and jointly tested, and the best so far is kept. At a leaf the walker may restart,
or stop (`*`): the best hypothesis is then the answer.
"""

from dataclasses import dataclass

import numpy as np

from slam_gym.association.acceptance import min_pairings
from slam_gym.association.relocation.constraints import map_arrays
from slam_gym.association.relocation.problem import INDEX, answer_of, nothing_found, offer, problem_of
from slam_gym.association.relocation.tree import RelocationBranches, branches, extend, root
from slam_gym.association.walks import ORDERS, Order
from slam_gym.types import UNPAIRED, BoolArray, IntArray, Landmarks, Locality, Relocation, Scan
from slam_gym.validation import check_count, one_of


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
        one_of("order", self.order, ORDERS)
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
        self.order = self._in_order()  # (m,) the measurements, level by level
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
        self.node = root(self.problem)
        self.compatible: bool | None = None  # at a leaf: whether the hypothesis passes the joint test
        self.offered: list[tuple[int, int]] = []  # of each level decided: candidates on offer, action taken
        self.problem.effort[INDEX.nodes] += 1
        self.problem.effort[INDEX.tries] += 1
        self.offer: RelocationBranches | None = None  # the ranked features for the measurement; None at a leaf
        self._go_on()

    def _in_order(self) -> IntArray:
        points = self.scan.points
        if self.spec.order == "as_scanned":
            return np.arange(len(points))
        far = np.hypot(points[:, 0], points[:, 1])
        few = self.problem.allowed.sum(axis=1)
        return np.argsort(far if self.spec.order == "nearest_first" else few, kind="stable")

    def _decide(self, action: int) -> None:
        feature = UNPAIRED if action == self.spec.star else int(self.shown[action])
        self.node = extend(self.problem, self.node, int(self.order[self.level]), feature)
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
            self.offer = branches(self.problem, self.node, int(self.order[self.level]))
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
