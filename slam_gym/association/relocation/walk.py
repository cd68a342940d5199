"""Relocation as a walk of the interpretation tree: what a walker may choose, and what it amounts to.

One walk is one scan. At each level the walker pairs the current measurement with one of K candidates or with `*`;
`restart` takes it back to the root. Levels where only `*` is legal are passed by without asking. At a leaf, and where
the walker restarts, the hypothesis is located and held against the joint test; the best so far is kept. From a leaf the
walker may restart, or stop (`*`): the best is then the answer.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from slam_gym.association.acceptance import min_pairings
from slam_gym.association.relocation.answer import answer_of, keep, nothing_found
from slam_gym.association.relocation.location import Located, locate
from slam_gym.association.relocation.tree import (
    JOINT,
    LEAVES,
    LIMIT,
    NODES,
    TRIES,
    UNARY,
    RelocationBranches,
    branches,
    extend,
    problem_of,
    root,
)
from slam_gym.types import UNPAIRED, BoolArray, IntArray, Landmarks, Locality, Relocation, Scan

RelocationOrder = Literal["fewest_candidates", "nearest_first", "as_scanned", "random"]
"""In which order measurements are decided: those first that the unary constraints leave fewest features; by distance
from the robot; as the scan has them, as `gcbb` does; dealt anew at every try."""


@dataclass(frozen=True)
class WalkSpec:
    """Settings of a walk."""

    candidates: int = 8  # K on offer, those with most support
    order: RelocationOrder = "fewest_candidates"
    node_limit: int = 300
    sizes: bool = True  # sizes are looked at
    confidence: float = 0.99  # of all constraints and of the joint test

    def __post_init__(self) -> None:
        for name in ("candidates", "node_limit"):
            value = getattr(self, name)
            if not (isinstance(value, int | np.integer) and value >= 1):
                raise ValueError(f"{name}: expected a whole number >= 1, got {value!r}")
        if self.order not in get_args(RelocationOrder):
            raise ValueError(f"order={self.order!r}; known: {', '.join(get_args(RelocationOrder))}")
        if not 0.0 < self.confidence < 1.0:
            raise ValueError(f"confidence: {self.confidence} is not between 0 and 1")

    @property
    def star(self) -> int:
        """The action `*`; at a leaf, to stop."""
        return self.candidates

    @property
    def restart(self) -> int:
        """The action that goes back to the root."""
        return self.candidates + 1

    @property
    def actions(self) -> int:
        """K candidates, `*`, restart."""
        return self.candidates + 2


@dataclass(frozen=True, slots=True)
class Leaf:
    """A hypothesis that was located."""

    features: IntArray  # (m,)
    located: Located
    compatible: bool  # it has a pose and passes the joint test there


class RelocationWalk:
    """A walk through the tree of one scan, from the root until the walker stops or the nodes are spent.

    Nodes are counted as every try leaves the root, and at every level decided, those passed by among them. `rng` deals
    the levels with `order="random"`, and is not touched otherwise. Raises ValueError where scan, map
    or locality are bad.
    """

    def __init__(
        self,
        spec: WalkSpec,
        scan: Scan,
        landmarks: Landmarks,
        locality: Locality | None = None,
        rng: np.random.Generator | None = None,
    ) -> None:
        if not spec.sizes:
            scan = Scan.from_points(scan.points, scan.covariances, kinds=scan.kinds)
        self.spec, self.scan, self.landmarks, self.locality = spec, scan, landmarks, locality
        self.problem = problem_of(scan, landmarks, locality, spec.confidence)
        self.needed = min_pairings(scan, landmarks, confidence=spec.confidence)
        self.counters = self.problem.effort
        self.counters[UNARY] = self.problem.allowed.size
        self.done = False
        self._rng = rng or np.random.default_rng(0)
        self._at_root: dict[int, RelocationBranches] = {}  # every try begins with the same offer
        self._kept = nothing_found(len(scan))
        self.best = self.answer()
        self._begin()

    # where the walk stands

    @property
    def level(self) -> int:
        """Measurements decided."""
        return len(self.path)

    @property
    def measurement(self) -> int | None:
        """The one to decide; None at a leaf."""
        return None if self.leaf else int(self.order[self.level])

    @property
    def offer(self) -> RelocationBranches | None:
        """What it may be paired with, by rank; the first K are on offer. None at a leaf."""
        return self._offer

    @property
    def hidden(self) -> int:
        """Legal candidates that are not on offer since there are more than K."""
        return 0 if self._offer is None else max(len(self._offer.features) - self.spec.candidates, 0)

    @property
    def nodes(self) -> int:
        """Spent so far."""
        return int(self.counters[NODES])

    @property
    def tries(self) -> int:
        """Walks from the root, this one included."""
        return int(self.counters[TRIES])

    @property
    def mask(self) -> BoolArray:
        """(K + 2,) the legal actions. `*` always is; restart, once the walker has decided something."""
        legal = np.zeros(self.spec.actions, np.bool_)
        if self._offer is not None:
            legal[: min(len(self._offer.features), self.spec.candidates)] = True
        legal[self.spec.star] = not self.done
        legal[self.spec.restart] = self._chosen > 0 and not self.done
        return legal

    def action_of(self, feature: int) -> int | None:
        """The action that pairs the current measurement with `feature` (UNPAIRED: `*`); None if it is not on offer."""
        if feature == UNPAIRED:
            return self.spec.star
        shown = self._offer.features[: self.spec.candidates] if self._offer else self.order[:0]
        found = np.flatnonzero(shown == feature)
        return int(found[0]) if len(found) else None

    # moving on

    def take(self, action: int) -> None:
        """Raises ValueError for an action that is not legal, and once the walk is done."""
        legal = self.mask
        if not (0 <= action < len(legal) and legal[action]):
            raise ValueError(f"action {action!r} is not legal; mask: {legal.tolist()}")
        if action == self.spec.restart:
            if self.leaf is None:
                self._judge()
            self._begin()
        elif self._offer is None:
            self.done = True
        else:
            self._chosen += 1
            self._decide(UNPAIRED if action == self.spec.star else int(self._offer.features[action]))
            self._go_on()
        self.done |= self._spent

    def answer(self) -> Relocation:
        """What the walk has come to: the best hypothesis, or none at all."""
        return answer_of(self._kept, self.problem, self.needed, 0.0)

    def _begin(self) -> None:
        """A new try, from the root."""
        self.order = self._deal()
        self.node = root(self.problem)
        self.leaf: Leaf | None = None
        self.path: list[int] = []  # features decided, level by level
        self.offered: list[tuple[int, int]] = []  # of each such level: candidates on offer, action taken
        self._chosen = 0  # decisions of this try that were the walker's own
        self.counters[NODES] += 1
        self.counters[TRIES] += 1
        self._go_on()

    def _deal(self) -> IntArray:
        points = self.scan.points
        if self.spec.order == "random":
            return self._rng.permutation(len(points))
        if self.spec.order == "as_scanned":
            return np.arange(len(points))
        far = np.hypot(points[:, 0], points[:, 1])
        few = self.problem.allowed.sum(axis=1)
        return np.argsort(far if self.spec.order == "nearest_first" else few, kind="stable")

    def _decide(self, feature: int) -> None:
        shown = 0 if self._offer is None else min(len(self._offer.features), self.spec.candidates)
        self.offered.append((shown, self.spec.star if feature == UNPAIRED else self.action_of(feature) or 0))
        self.node = extend(self.problem, self.node, int(self.order[self.level]), feature)
        self.path.append(feature)
        self.counters[NODES] += 1

    def _go_on(self) -> None:
        """Pass by the levels that leave no choice; make the offer of the next, or judge the leaf."""
        self._offer, m = None, len(self.scan)
        while self.level < m and not self._spent and not self.node.alive[self.order[self.level]].any():
            self._decide(UNPAIRED)
        if self._spent or self.level == m:
            self.counters[LIMIT] = self._spent
            self.leaf = self._judge()
        else:
            self._offer = self._branches(int(self.order[self.level]))

    def _branches(self, measurement: int) -> RelocationBranches:
        if self.level > 0:
            return branches(self.problem, self.node, measurement)
        if measurement not in self._at_root:
            self._at_root[measurement] = branches(self.problem, self.node, measurement)
        return self._at_root[measurement]

    @property
    def _spent(self) -> bool:
        return self.nodes >= self.spec.node_limit

    def _judge(self) -> Leaf:
        """Locate and test the hypothesis of the path; keep it if none has more pairings."""
        node, features, k = self.node, self.node.hypothesis, self.node.pairings
        located = locate(self.scan, self.landmarks, features)
        self.counters[LEAVES] += 1
        compatible = False
        if k >= 2:
            self.counters[JOINT] += 1
            compatible = bool(located.joint_distance < self.problem.joint_gates[k])
        if compatible:
            distance = located.joint_distance
            keep(self._kept, node.path, k, located.pose, located.covariance, distance)
            self.best = self.answer()
        return Leaf(features, located, compatible)
