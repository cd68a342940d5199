"""The interpretation tree as a learner sees it: one walk from the root to a leaf, decision by decision."""

from __future__ import annotations

import math
from typing import Literal, get_args

import numpy as np

from slam_gym.association.compatibility import Candidates, individual
from slam_gym.association.tracking.conditioning import condition, legal, outlook, unconditioned
from slam_gym.association.tracking.observation import Observation, encode
from slam_gym.association.tree import as_hypothesis, interpretation_tree
from slam_gym.types import NONE, Array, BoolArray, Effort, Hypothesis, IntArray, Prediction, Scan

Order = Literal["as_scanned", "nearest_first", "fewest_candidates"]
"""In which order measurements are decided: as the scan has them; by distance from the robot; those first that have the
fewest individually compatible features (but some), which decides what is plain before what is ambiguous."""

Compatibility = Literal["joint", "individual"]
"""What makes a branch legal: that the path stays jointly compatible and takes no feature twice; or D²_ij alone."""

ORDERS: tuple[str, ...] = get_args(Order)
COMPATIBILITIES: tuple[str, ...] = get_args(Compatibility)


class Walk:
    """A walk of the interpretation tree of one scan. It stands before a level with a choice, or at a leaf (`done`).

    Action a < K pairs the current `measurement` with `rows[a]`, action K is `*`. On offer are the K legal candidates of
    least D²_ij, nearest first, so that the mask, which is the compatibility test of the path, is true for the first of
    them and for `*`. `hidden` tells how many more were legal. Levels with `*` alone are played by the walk itself.

    Arguments:
        candidates: K.
        order: see `Order`.
        confidence: of the individual and the joint test.
        compatibility: see `Compatibility`.

    Raises ValueError as `individual` does, and for arguments that are none of the known ones.
    """

    def __init__(
        self,
        scan: Scan,
        prediction: Prediction,
        *,
        candidates: int = 5,
        order: Order = "as_scanned",
        confidence: float = 0.99,
        compatibility: Compatibility = "joint",
    ) -> None:
        check_arguments(candidates, order, compatibility)
        self.K, self.joint = candidates, compatibility == "joint"
        self.candidates = _in_order(scan, prediction, order, confidence)
        self.tree = interpretation_tree(scan, prediction, self.candidates, confidence)
        self.level = 0  # the level that decides next
        self.pairings = 0
        self.distance = 0.0  # D²_H
        self.chosen = np.full(self.tree.levels, NONE)  # candidate taken at each level, NONE for `*`
        self.hidden = 0  # legal candidates of the current measurement that are not on offer
        self.hid = False  # so far, some level had any
        self.mask = np.zeros(candidates + 1, np.bool_)  # (K + 1,) which actions are legal
        self._tests = 0
        self._path = np.empty(self.tree.levels, np.int64)  # candidates of the pairings, first to last
        self._w, self._error, self._schur, self._total = unconditioned(
            self.tree.slots, self.candidates.innovations, self.candidates.measured, scan.covariances,
            self.tree.covariance, self.tree.levels,
        )  # fmt: skip
        self._local: BoolArray | None = None
        self._taken = np.zeros(len(self.tree.rows), np.bool_)
        self._proceed()

    @property
    def done(self) -> bool:
        """Nothing is left to decide."""
        return self.level == self.tree.levels

    @property
    def measurement(self) -> int:
        """The measurement to decide now. Raises ValueError at a leaf."""
        if self.done:
            raise ValueError(f"the walk is done: all {self.tree.levels} measurements are decided")
        return int(self.candidates.measurements[self.level])

    @property
    def rows(self) -> IntArray:
        """(k,) rows of the prediction on offer, k ≤ K, by ascending D²_ij."""
        return self.tree.rows[self.tree.slots[self.offered]]

    @property
    def individual_distances(self) -> Array:
        """(k,) D²_ij of what is on offer."""
        return self.candidates.distances[self.offered]

    @property
    def joint_distances(self) -> Array:
        """(k,) D²_H with each of those on offer added to the path."""
        return self.distance + self._total[self.offered]

    @property
    def decided(self) -> IntArray:
        """(m,) row of the prediction paired with each measurement; NONE for `*` and for what is undecided."""
        rows = np.full(len(self.tree.scan.points), NONE)
        paired = self.chosen != NONE
        rows[self.candidates.measurements[paired]] = self.tree.rows[self.tree.slots[self.chosen[paired]]]
        return rows

    def action_of(self, row: int) -> int | None:
        """The action that pairs the current measurement with `row` of the prediction (NONE: `*`); None if there is
        no such on offer."""
        if row == NONE:
            return self.K
        found = np.flatnonzero(self.rows == row)
        return int(found[0]) if len(found) else None

    def observation(self) -> Observation:
        """What a policy decides on: flat float32 vectors in [−1, 1], see `walk_observation`. Fresh arrays."""
        return encode(self)

    def take(self, action: int) -> None:
        """Decide the current measurement. Raises ValueError for an action that is not legal, and at a leaf."""
        if self.done or not 0 <= action <= self.K or not self.mask[action]:
            raise ValueError(f"action {action!r} is not legal; mask: {self.mask.tolist()}")
        if action < self.K:
            self._pair(int(self.offered[action]))
        self.level += 1
        self._proceed()

    def hypothesis(self) -> Hypothesis:
        """The answer that the path amounts to, with `*` for what is undecided."""
        effort = Effort(self.level, self.candidates.tests, self._tests)
        return as_hypothesis(self.tree.prediction, self.decided, self.distance, effort, exclusive=self.joint)

    def outlook(self) -> tuple[IntArray, IntArray, int, int]:
        """See `conditioning.outlook`: support and rivals (k,) of those on offer, support of none of them, levels left.

        A feature that is taken supports nothing, and only what would be jointly compatible does.
        """
        first = int(self.candidates.starts[self.level + 1])
        return outlook(
            self.offered, first, self.tree.slots, self.candidates.measured, self.tree.covariance, self._w, self._error,
            self._schur, self._total, self._taken, self.pairings, self.distance, self.tree.gates,
        )  # fmt: skip

    @property
    def path(self) -> IntArray:
        """(p,) candidates paired so far, first to last."""
        return self._path[: self.pairings]

    def local(self) -> BoolArray:
        """(u, u) which of the tree's slots are local to each other. Raises ValueError without locality."""
        if self._local is None:
            if self.tree.prediction.local is None:
                raise ValueError("the prediction has no locality")
            self._local = self.tree.prediction.local(self.tree.rows)
        return self._local

    def _pair(self, c: int) -> None:
        self.chosen[self.level] = self._path[self.pairings] = c
        self.distance += float(self._total[c])
        self._taken[self.tree.slots[c]] = True
        first = int(self.candidates.starts[self.level + 1])
        condition(
            c, first, self.pairings, self.tree.slots, self.tree.covariance, self._w, self._error, self._schur,
            self._total,
        )  # fmt: skip
        self.pairings += 1

    def _proceed(self) -> None:
        """On to the next level with a choice; `*` alone is played."""
        while self.level < self.tree.levels:
            first, last = self.candidates.starts[self.level], self.candidates.starts[self.level + 1]
            if first < last:
                self._tests += last - first
                gate = float(self.tree.gates[self.pairings + 1]) if self.joint else math.inf
                found = legal(first, last, self.tree.slots, self._taken, self.joint, self._total, gate - self.distance)
                if len(found):
                    self.offered = found[: self.K]
                    self.hidden = len(found) - len(self.offered)
                    self.hid |= self.hidden > 0
                    self.mask = np.arange(self.K + 1) < len(self.offered)
                    self.mask[self.K] = True
                    return
            self.level += 1
        self.offered, self.hidden = np.empty(0, np.int64), 0
        self.mask = np.zeros(self.K + 1, np.bool_)


def check_arguments(candidates: int, order: str, compatibility: str) -> None:
    """Raises ValueError, listing what is known, for arguments that no walk can have."""
    if candidates < 1:
        raise ValueError(f"candidates: {candidates} is less than 1")
    if order not in ORDERS:
        raise ValueError(f"order={order!r}; known: {', '.join(ORDERS)}")
    if compatibility not in COMPATIBILITIES:
        raise ValueError(f"compatibility={compatibility!r}; known: {', '.join(COMPATIBILITIES)}")


def _in_order(scan: Scan, prediction: Prediction, order: str, confidence: float) -> Candidates:
    if order == "as_scanned" or not len(scan):
        return individual(scan, prediction, confidence)
    if order == "nearest_first":
        key = np.hypot(scan.points[:, 0], scan.points[:, 1])
    else:
        counts = np.diff(individual(scan, prediction, confidence).starts)
        key = np.where(counts > 0, counts, len(prediction) + 1).astype(np.float64)
    return individual(scan, prediction, confidence, measurements=np.argsort(key, kind="stable"))
