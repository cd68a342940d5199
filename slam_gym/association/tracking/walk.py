"""The interpretation tree as a learner sees it: one walk from the root to a leaf, decision by decision.

A policy decides on flat float32 vectors, scaled into [−1, 1]. Values without a bound are squashed: v / (|v| + scale),
which is 0 at 0 and ±½ at ±scale.
"""

import functools
import math
from typing import Literal, get_args

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association import tree, walks
from slam_gym.association.compatibility import chi2_gate, individual
from slam_gym.association.prediction import Expected, Prediction, PredictionArrays
from slam_gym.association.tree import Innovation, Node, Pairings, add_pairing, interpretation_tree, read, root
from slam_gym.association.walks import ORDERS, Float32Array, Observation, Order, squash
from slam_gym.types import UNPAIRED, Array, BoolArray, Effort, Hypothesis, IntArray, Scan, ScanArrays
from slam_gym.validation import check_count, one_of

NEW_CONFIDENCE, FEWEST_PAIRED, SHARE_PAIRED = 0.99999, 5, 0.8
"""When a walk says which measurements start features, and by which gate: see `Walk.hypothesis`."""

Compatibility = Literal["joint", "individual"]
"""What makes a branch legal: that the path stays jointly compatible and takes no feature twice; or D²_ij alone."""

COMPATIBILITIES: tuple[str, ...] = get_args(Compatibility)

MEASUREMENT_FIELDS = walks.MEASURED_FIELDS
"""`measurement`: the one to decide now."""

CANDIDATE_FIELDS = (
    "legal",  # 1 where there is a candidate; where there is none, the row is 0
    "x", "y",  # where the map expected it, in R
    "innovation_x", "innovation_y",  # ν_ij
    "individual",  # D²_ij, by its gate
    "joint",  # D²_H if taken, by its gate
    "size",  # (a_i − a_j)² / (σ_i² + σ_j²), by 1; −1 where a size is unknown
    "covisible",  # fraction of the features paired so far that it is local to; without locality all are, to all
    "near",  # 1 where it was paired in a recent scan or is local to one that was, or where there is no locality
    "age",  # steps since it was first seen
    "sightings",  # scans that updated or started it; 0 if the prediction is not made from a map
    "confirmed",  # 1 where it has as many sightings as confirm a feature
    "rivals",  # later measurements that it could be paired with instead
    "spread",  # √det S_ij, given the path
    "evidence",  # log N(e; 0, S) given the path, over the density of measurements of nothing in the map
    "outlook",  # what taking it adds to the evidence of the levels left, each by its best pairing
    "odds",  # evidence and outlook together
    "margin",  # by which they exceed the best odds among the others on offer, `*` (0) included
)  # fmt: skip
"""`candidates`: K rows of these, by ascending D²_ij. All innovations of a scan share the error of the predicted pose,
most of all that of its heading: `outlook` tells whether the other measurements fall into place once a pairing has
corrected it."""

PATH_FIELDS = (
    "decided",  # fraction of the measurements
    "left",  # later levels with a candidate
    "pairings",  # so far
    "paired",  # fraction of the decided measurements
    "distance",  # D²_H, by its gate
    "compatible",  # individually compatible features of the measurement
    "hidden",  # legal candidates that are not on offer
    "heading",  # σ of the predicted heading
)
"""`path`: the decisions so far, and what is ahead."""

INNOVATION_SCALE = 0.3  # [m]
AGE_SCALE = 50.0  # [steps]
SPREAD_SCALE, HEADING_SCALE = 0.05, 0.05  # [m²], [rad]
ODDS_SCALE = 5.0
COUNT_SCALE, FEW_SCALE = 10.0, 3.0
CLUTTER_DENSITY = 0.02  # [1/m²] of measurements of nothing in the map, for `evidence`

_SEEN = -1  # in place of a level
_squash = compiled(squash)


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
        self.candidates = individual(scan, prediction, measurements=_in_order(scan, prediction, order))
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
        return self.candidates.rows[self.candidates.slots[self.offered]]

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
        return tree.decided(self.tree, self.node)

    def action_of(self, feature: int) -> int | None:
        """The action that pairs the current measurement with `feature` of the map (UNPAIRED: `*`); None if there is no
        such on offer."""
        if feature == UNPAIRED:
            return self.K
        found = np.flatnonzero(self.tree.prediction.features[self.rows] == feature)
        return int(found[0]) if len(found) else None

    def observation(self) -> Observation:
        """What a policy decides on: vectors of `MEASUREMENT_FIELDS`, `CANDIDATE_FIELDS` and `PATH_FIELDS`. Fresh
        arrays; 0 at a leaf."""
        if self.done:
            return nothing(self.K)
        scan, prediction, candidates, pairings, gates = self.tree
        (first, later), p, distance = self.tree.level(self.level), self.pairings, self.node.distance
        mapped = prediction.arrays, candidates.rows, prediction.confirmations, self._local
        on_offer, individual = (self.offered, later, self.K), candidates.distances
        shown, left = _encode(pairings, self.node, individual, gates, scan.arrays, mapped, on_offer)
        path = (
            self.level / self.tree.levels,
            squash(left, COUNT_SCALE),
            squash(p, COUNT_SCALE),
            p / max(self.level, 1),
            distance / (distance + float(gates[p])) if p > 0 else 0.0,
            squash(later - first, FEW_SCALE),
            squash(self.hidden, FEW_SCALE),
            squash(math.sqrt(max(prediction.heading_variance, 0.0)), HEADING_SCALE),
        )
        measurement = np.array(walks.measurement_shown(scan, self.measurement), np.float32)
        return {"measurement": measurement, "candidates": shown, "path": np.array(path, np.float32)}

    @functools.cached_property
    def _local(self) -> BoolArray:
        """(u, u) which of the features that the tree may pair are local to each other."""
        return self.tree.prediction.local(self.candidates.rows)

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
        return tree.hypothesis(self.tree, self.node, effort, exclusive=self.joint, new=new)

    def _new(self) -> BoolArray:
        """(m,) which measurements are unpaired and compatible with nothing, given the path."""
        scan, prediction, decided = self.tree.scan, self.tree.prediction, self.decided
        new: BoolArray = decided == UNPAIRED
        if not new.any():
            return new
        near = individual(scan, prediction, NEW_CONFIDENCE)
        pairings = interpretation_tree(scan, prediction, near).pairings
        node = tree.root_of(pairings)
        for c in np.flatnonzero(decided[near.measured] == near.rows[near.slots]):
            node = add_pairing(pairings, node, int(c), 0)
        new[near.measured[node.added < chi2_gate(2, NEW_CONFIDENCE)]] = False
        return new

    def _proceed(self) -> None:
        """On to the next level with a choice; `*` alone is played."""
        starts, node, levels = self.candidates.starts.tolist(), self.node, self.tree.levels
        self.offered, self.hidden = np.empty(0, np.int64), 0  # pairings, and the number of legal ones beyond K
        while self.level < levels:
            first, last = starts[self.level], starts[self.level + 1]
            self._tests += last - first
            if first < last:
                added, gate = node.added[first:last], math.inf
                if self.joint:
                    added = tree.added_by(self.tree.pairings, node.path, node.added, first, last)
                    gate = float(self.tree.gates[self.pairings + 1])
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


def _in_order(scan: Scan, prediction: Prediction, order: str) -> IntArray:
    def candidates() -> IntArray:
        counts = np.diff(individual(scan, prediction).starts)
        return np.where(counts > 0, counts, len(prediction) + 1)

    return walks.in_order(scan, order, candidates)


def nothing(candidates: int) -> Observation:
    """The observation where there is nothing to decide, with K = `candidates`: zeros."""
    rows = {"measurement": MEASUREMENT_FIELDS, "candidates": candidates * CANDIDATE_FIELDS, "path": PATH_FIELDS}
    return {name: np.zeros(len(fields), np.float32) for name, fields in rows.items()}


@compiled
def _encode(
    pairings: Pairings,
    node: Node,
    individual: Array,
    gates: Array,
    scan: ScanArrays,
    mapped: tuple[PredictionArrays, IntArray, int, BoolArray],
    on_offer: tuple[IntArray, int, int],
) -> tuple[Float32Array, int]:
    """K rows of `CANDIDATE_FIELDS`, flat; and the number of later levels with a candidate.

    `individual` (c,) are D²_ij of all pairings. `mapped`: the prediction, its row for each slot (u,), the sightings
    that confirm a feature, and which features are local to each other, by slot. `on_offer`: the pairings (k,), k ≤ K,
    where the pairings of later levels begin, and K.
    """
    (prediction, rows, confirmations, local), (offered, later, K), p = mapped, on_offer, len(node.path)
    rivals, evidence, outlook, left = _outlook(pairings, node, offered, later)
    expected, odds = Expected(*prediction), evidence + outlook
    candidates, sizes, variances = np.zeros((K, len(CANDIDATE_FIELDS)), np.float32), scan[2], scan[3]
    for k in range(len(offered)):
        c, row = offered[k], candidates[k]
        i, slot, joint = pairings.measured[c], pairings.slots[c], node.distance + node.added[c]
        j = rows[slot]
        row[0] = 1.0
        row[1] = _squash(expected.positions[j, 0], walks.POSITION_SCALE)
        row[2] = _squash(expected.positions[j, 1], walks.POSITION_SCALE)
        row[3] = _squash(pairings.innovations[c, 0], INNOVATION_SCALE)
        row[4] = _squash(pairings.innovations[c, 1], INNOVATION_SCALE)
        row[5], row[6] = individual[c] / (individual[c] + gates[1]), joint / (joint + gates[p + 1])
        difference = sizes[i] - expected.sizes[j]
        row[7] = _squash(difference * difference / (variances[i] + expected.size_variances[j]), 1.0)
        if math.isnan(row[7]):
            row[7] = -1.0
        covisible = 0
        for d in node.path:
            covisible += tree.is_local(local, slot, pairings.slots[d])
        row[8] = covisible / max(p, 1)
        row[9], row[10] = 1.0 if expected.near[j] else 0.0, _squash(float(expected.ages[j]), AGE_SCALE)
        row[11] = _squash(float(expected.sightings[j]), COUNT_SCALE)
        row[12] = 1.0 if expected.sightings[j] >= confirmations else 0.0
        row[13], e, best = _squash(float(rivals[k]), FEW_SCALE), read(node.innovations, c), 0.0
        for other in range(len(odds)):
            if other != k:
                best = max(best, odds[other])
        row[14] = _squash(math.sqrt(max(e.xx * e.yy - e.xy * e.xy, 0.0)), SPREAD_SCALE)
        row[15], row[16] = _squash(evidence[k], ODDS_SCALE), _squash(outlook[k], ODDS_SCALE)
        row[17], row[18] = _squash(odds[k], ODDS_SCALE), _squash(odds[k] - best, ODDS_SCALE)
    return candidates.ravel(), left


@compiled
def _outlook(pairings: Pairings, node: Node, offered: IntArray, later: int) -> tuple[IntArray, Array, Array, int]:
    """Of each pairing on offer: later pairings with the same feature, evidence and outlook, (k,) each; and the number
    of later levels with a candidate.

    Each pairing on offer conditions those of later levels; a feature that is taken adds nothing to them.
    """
    slots, measured, p, count = pairings.slots, pairings.measured, len(node.path), len(pairings.slots)
    free, without, best, left, level = np.empty(count, np.bool_), 0.0, 0.0, 0, _SEEN
    for c in range(later, count):
        if measured[c] != level:
            left, level, without, best = left + 1, measured[c], without + best, 0.0
        free[c] = tree.may_follow(pairings, node.path, p, c)
        if free[c]:
            best = max(best, _evidence(read(node.innovations, c)))
    without += best
    rivals, evidence, outlook = np.zeros(len(offered), np.int64), np.empty(len(offered)), np.empty(len(offered))
    for k in range(len(offered)):
        a, e = offered[k], read(node.innovations, offered[k])
        pivot, total, best, level = tree.pivot_of(slots[a], e), 0.0, 0.0, _SEEN
        for c in range(later, count):
            rivals[k] += slots[c] == slots[a]
            if measured[c] != level:
                level, total, best = measured[c], total + best, 0.0
            if free[c] and slots[c] != slots[a]:
                given = tree.condition(pairings.covariance, node.w, pivot, a, p, c, slots[c], read(node.innovations, c))
                best = max(best, _evidence(given))
        evidence[k], outlook[k] = _evidence(e), total + best - without
    return rivals, evidence, outlook, left


@compiled
def _evidence(e: Innovation) -> float:
    """log N(e; 0, S) − log λ, λ the density of measurements of nothing in the map; −inf where S is not positive."""
    determinant = e.xx * e.yy - e.xy * e.xy
    if not determinant > 0.0:
        return -math.inf
    return -0.5 * tree.squared(e) - 0.5 * math.log(determinant) - math.log(2.0 * math.pi * CLUTTER_DENSITY)
