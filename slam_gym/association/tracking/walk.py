"""The interpretation tree as a learner sees it: one walk from the root to a leaf, decision by decision."""

import functools
import math
from typing import Literal, get_args

import numpy as np

from slam_gym.association.compatibility import Candidates, chi2_gate, individual
from slam_gym.association.prediction import Prediction
from slam_gym.association.tracking.observation import Choice, encode, nothing
from slam_gym.association.tree import add_pairing, added_by, decided, hypothesis, interpretation_tree, root
from slam_gym.association.walks import ORDERS, Observation, Order
from slam_gym.types import UNPAIRED, Array, BoolArray, Effort, Hypothesis, IntArray, Scan
from slam_gym.validation import check_count, one_of

NEW_CONFIDENCE, FEWEST_PAIRED, SHARE_PAIRED = 0.99999, 5, 0.8
"""When a walk says which measurements start features, and by which gate: see `Walk.hypothesis`."""

Compatibility = Literal["joint", "individual"]
"""What makes a branch legal: that the path stays jointly compatible and takes no feature twice; or D²_ij alone."""

COMPATIBILITIES: tuple[str, ...] = get_args(Compatibility)


class Walk:
    """A walk of the interpretation tree of one scan. It stands before a level with a choice, or at a leaf (`done`).

    Action a < K pairs the current `measurement` with `rows[a]`, action K is `*`. On offer are the K legal candidates of
    least D²_ij, nearest first, so that the mask, which is the compatibility test of the path, is true for the first of
    them and for `*`. `hidden` tells how many more were legal. Levels with `*` alone are played by the walk itself.
    Confidence is that of the prediction.

    Arguments:
        candidates: K.
        order: see `Order`.
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
        compatibility: Compatibility = "joint",
    ) -> None:
        check_arguments(candidates, order, compatibility)
        self.K, self.joint = candidates, compatibility == "joint"
        self.candidates = _in_order(scan, prediction, order)
        self.tree = interpretation_tree(scan, prediction, self.candidates)
        self.node = root(self.tree)  # the pairings so far, and what may follow them
        self.level = 0  # the level that decides next
        self.chosen = np.full(self.tree.levels, UNPAIRED)  # candidate taken at each level, UNPAIRED for `*`
        self._tests = 0
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
    def pairings(self) -> int:
        """Number of pairings so far."""
        return len(self.node.path)

    @property
    def rows(self) -> IntArray:
        """(k,) rows of the prediction on offer, k ≤ K, by ascending D²_ij."""
        return self.tree.rows[self.candidates.slots[self.offered]]

    @property
    def individual_distances(self) -> Array:
        """(k,) D²_ij of what is on offer."""
        return self.candidates.distances[self.offered]

    @property
    def joint_distances(self) -> Array:
        """(k,) D²_H with each of those on offer added to the path."""
        return self.node.distance + self.node.added[self.offered]

    @property
    def decided(self) -> IntArray:
        """(m,) row of the prediction paired with each measurement; UNPAIRED for `*` and for what is undecided."""
        return decided(self.tree, self.node)

    def action_of(self, feature: int) -> int | None:
        """The action that pairs the current measurement with `feature` of the map (UNPAIRED: `*`); None if there is no
        such on offer."""
        if feature == UNPAIRED:
            return self.K
        found = np.flatnonzero(self.tree.prediction.features[self.rows] == feature)
        return int(found[0]) if len(found) else None

    def observation(self) -> Observation:
        """What a policy decides on: flat float32 vectors in [−1, 1], see `observation`. Fresh arrays; 0 at a leaf."""
        if self.done:
            return nothing(self.K)
        first, later = self.tree.level(self.level)
        choice = Choice(self.level, self.tree.levels, self.K, self.offered, self.hidden, later - first, later)
        return encode(self.tree, self.node, self._local, choice)

    @functools.cached_property
    def _local(self) -> BoolArray:
        """(u, u) which of the features that the tree may pair are local to each other; (0, 0): all are to all."""
        prediction = self.tree.prediction
        return prediction.local(self.tree.rows) if prediction.has_localities else self.tree.pairings.local

    def take(self, action: int) -> None:
        """Decide the current measurement. Raises ValueError for an action that is not legal, and at a leaf."""
        if self.done or not 0 <= action <= self.K or not self.mask[action]:
            raise ValueError(f"action {action!r} is not legal; mask: {self.mask.tolist()}")
        if action < self.K:
            c = int(self.offered[action])
            self.chosen[self.level] = c
            self.node = add_pairing(self.tree.pairings, self.node, c, int(self.candidates.starts[self.level + 1]))
        self.level += 1
        self._proceed()

    def hypothesis(self) -> Hypothesis:
        """The answer that the path amounts to, with `*` for what is undecided.

        At a leaf it says which measurements are new: those that are unpaired and, given all pairings of the path,
        compatible with no feature in reach (confidence `NEW_CONFIDENCE`). Without the pairings, a robot that hardly
        knows its heading finds every measurement compatible with some feature, and starts none. Where fewer than
        `FEWEST_PAIRED` measurements are paired, or less than `SHARE_PAIRED` of the scan, as in most wrong hypotheses,
        `new` is None: the rule of `Slam` decides, as it does where features may be taken twice.
        """
        effort = Effort(self.level, self.candidates.tests, self._tests)
        relied_on = self.joint and self.done and self.pairings >= max(FEWEST_PAIRED, SHARE_PAIRED * self.tree.levels)
        new = self._new() if relied_on else None
        return hypothesis(self.tree, self.node, effort, exclusive=self.joint, new=new)

    def _new(self) -> BoolArray:
        """(m,) which measurements are unpaired and compatible with nothing, given the path."""
        scan, prediction, decided = self.tree.scan, self.tree.prediction, self.decided
        new: BoolArray = decided == UNPAIRED
        if not new.any():
            return new
        near = individual(scan, prediction, NEW_CONFIDENCE)
        tree = interpretation_tree(scan, prediction, near)
        node = root(tree)
        for c in np.flatnonzero(decided[near.measured] == near.rows[near.slots]):
            node = add_pairing(tree.pairings, node, int(c), 0)
        new[near.measured[node.added < chi2_gate(2, NEW_CONFIDENCE)]] = False
        return new

    def _proceed(self) -> None:
        """On to the next level with a choice; `*` alone is played."""
        starts, node, tree = self.candidates.starts.tolist(), self.node, self.tree
        self.offered, self.hidden = np.empty(0, np.int64), 0  # pairings, and the number of legal ones beyond K
        while self.level < tree.levels:
            first, last = starts[self.level], starts[self.level + 1]
            self._tests += last - first
            if first < last:
                added, gate = node.added[first:last], math.inf
                if self.joint:
                    added = added_by(tree.pairings, node.path, node.added, first, last)
                    gate = float(tree.gates[self.pairings + 1])
                legal = first + np.flatnonzero(added < gate - node.distance)
                if len(legal):
                    self.offered, self.hidden = legal[: self.K], max(len(legal) - self.K, 0)
                    break
            self.level += 1
        self.mask = np.arange(self.K + 1) < len(self.offered)  # (K + 1,) which actions are legal
        self.mask[self.K] = not self.done


def check_arguments(candidates: int, order: str, compatibility: str) -> None:
    """Raises ValueError, listing what is known, for arguments that no walk can have."""
    check_count("candidates", candidates)
    one_of("order", order, ORDERS)
    one_of("compatibility", compatibility, COMPATIBILITIES)


def _in_order(scan: Scan, prediction: Prediction, order: str) -> Candidates:
    if order == "as_scanned" or not len(scan):
        return individual(scan, prediction)
    if order == "nearest_first":
        key = np.hypot(scan.points[:, 0], scan.points[:, 1])
    else:
        counts = np.diff(individual(scan, prediction).starts)
        key = np.where(counts > 0, counts, len(prediction) + 1).astype(np.float64)
    return individual(scan, prediction, measurements=np.argsort(key, kind="stable"))
