"""SLAM whose loops close, and that starts a second map where it is lost: what stands around the step, one level up.

**Loops.** Old features that the way back has made ambiguous (so uncertain, seen from those the robot has just paired,
that others lie within their gates) are not offered to the associator: a scan pairs them wrongly now and then, and one
wrong scan decides where the map ends. They are left to `slam.loops`, which looks for the recent part of the map among
them. What it finds is made equal; features that this leaves twice are fused as soon as it is plain (`slam.twins`).
(Associators that weigh all hypotheses are offered them all the same, but for `SlamSpec.anew`.)

**First links.** Where a scan pairs a feature or two that the robot has not seen for long, a neighbour that nobody has
mapped may be what was measured, half a metre beside it: a door has two jambs, and 20 m away a gate is as wide. Such
pairings are learned from once there are so many that chance hardly brings them all (`kernels.hold_back`). A robot that
waits for them with few others in view is soon so uncertain that everything fits something, and learns nothing more:
with `SlamSpec.anew`, what is kept from pairing starts features, and the recent part of the map grows all the same.
Associators that weigh all hypotheses refuse by themselves what is ambiguous, and would starve if more was kept from
them; with `anew` nobody does, and they go by the same rules as all others, that for new features included.

**Second map.** A robot that was lost for some scans goes on in a map of its own. Its base stands where odometry has the
robot, so that coordinates remain roughly those of B; in it, the pose is known exactly. The recent part of this map is
looked for in those before. Once it is recognised, the maps are joined with a relation that says nothing, the pairs made
equal, and the robot goes on in one.

**Ids** run through all maps and are never given twice; of features that become one, the older id stays. The features of
a map that is left are `removed` in the `SlamStep` that says so, and `returned` when it is joined.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from slam_gym.association.compatibility import chi2_gate, plain
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.map_joining import equate
from slam_gym.mapping.map_state import successor
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.slam import kernels
from slam_gym.slam.at_once import Attempt, weighs_all
from slam_gym.slam.kernels import Learned
from slam_gym.slam.loops import NO_PAIRS, LoopSpec, find_loop, parts_of, recent_part
from slam_gym.slam.recognition import Joined, join_recognised, join_relocated
from slam_gym.slam.relocation import Relocate, RelocatingSlam
from slam_gym.slam.slam import Slam, SlamSpec, ViewFrom
from slam_gym.slam.twins import find_twins
from slam_gym.types import (
    UNPAIRED,
    BoolArray,
    Effort,
    Expectation,
    Hypothesis,
    IntArray,
    Odometry,
    Prediction,
    Scan,
    SlamStep,
)

_STILL = Odometry(np.zeros(3), np.zeros((3, 3)))


@dataclass(frozen=True)
class AtlasSpec:
    """What an atlas does beside relocation."""

    loops: LoopSpec | None = field(default_factory=LoopSpec)  # None: they are not looked for
    ambiguous: float = 0.5  # other features expected in the gate of an old one from which it is left to the loops
    patience: int | None = 3  # [scans] that a robot has been lost before it starts another map; None: it never does
    rejoin: int = 5  # [scans] from one attempt to recognise a map before to the next

    def __post_init__(self) -> None:
        if not self.ambiguous > 0.0:
            raise ValueError(f"AtlasSpec.ambiguous: {self.ambiguous} is no number > 0")
        if self.patience is not None and self.patience < 0:
            raise ValueError(f"AtlasSpec.patience: {self.patience} is negative")
        if self.rejoin < 1:
            raise ValueError(f"AtlasSpec.rejoin: {self.rejoin} is less than 1")


@dataclass(frozen=True, eq=False)
class Left:
    """A map that the robot does not know the way to."""

    map: StochasticMap
    covisibility: CovisibilityGraph


class AtlasSlam(RelocatingSlam):
    """`RelocatingSlam` whose loops close and whose maps are started, recognised and joined. See the head of this file.

    Arguments:
        spec, relocate, view_from: as for `RelocatingSlam`.
        atlas: settings.
    """

    def __init__(
        self,
        spec: SlamSpec | None,
        relocate: Relocate,
        view_from: ViewFrom | None = None,
        atlas: AtlasSpec | None = None,
    ) -> None:
        super().__init__(spec, relocate, view_from)
        self.atlas = atlas or AtlasSpec()
        self._ambiguous = math.inf if self.atlas.loops is None else self.atlas.ambiguous
        self._chance = 1.0 if self.atlas.loops is None else self.spec.chance
        self._alike = self.spec.anew and self._chance < 1.0  # one rule for all associators
        self.left: list[Left] = []  # maps before the current one that were not joined yet, oldest first
        self.loops: list[tuple[int, IntArray]] = []  # step and pairs (k, 2) of ids of each loop that was closed
        self.joins: list[tuple[int, IntArray]] = []  # the same of maps that were joined
        self.twins: list[tuple[int, IntArray]] = []  # the same of single features that were fused
        self._fused = NO_PAIRS  # ids, in the last step
        self._lost_for = 0  # scans
        self._look_everywhere = False  # for twins, since much has moved

    @property
    def maps(self) -> tuple[StochasticMap, ...]:
        """The current map, then those that are not joined with it, in the coordinates that they were left with."""
        return (self.map, *[left.map for left in self.left]) if self.left else (self.map,)

    @property
    def fused(self) -> IntArray:
        """(k, 2) ids of features that became one in the last step, the one that is kept first."""
        return self._fused.copy() if len(self._fused) else NO_PAIRS

    def predict_features(self, scan: Scan, odometry: Odometry | None = None) -> Prediction:
        """As `Slam` does, without old features that are ambiguous, unless the associator weighs all hypotheses.

        Such a one says what it learns from scan to scan. It refuses by itself what is ambiguous, and would take for new
        what it is not offered, which is what `SlamSpec.anew` wants.
        """
        prediction = super().predict_features(scan, odometry)
        if self.atlas.loops is None or (self._experience is not None and not self._alike):
            return prediction
        k = len(prediction)
        kept, gate = np.empty(k, np.int64), chi2_gate(2, prediction.confidence)
        left = kernels.unambiguous(
            prediction.near,
            prediction.positions,
            prediction.features,
            self.map.arrays,
            k * gate / self.reach**2,
            self.atlas.ambiguous,
            kept,
        )
        return prediction if left == k else prediction.rows(kept[:left])

    def _at_once(self, odometry: Odometry, scan: Scan, form: int, plain: bool) -> Attempt | None:
        """As `Slam` does; `marginal_step` knows no rule that keeps anything from who weighs all hypotheses."""
        return None if self._alike and weighs_all(form) else super()._at_once(odometry, scan, form, plain)

    def _believed(self, scan: Scan, prediction: Prediction, hypothesis: Hypothesis) -> Hypothesis:
        """The hypothesis without pairings with old features that may all be chance: see `kernels.hold_back`.

        Who weighs all hypotheses has refused by itself what is ambiguous; with `SlamSpec.anew` it only pairs, and new
        features start by the rule of the step.
        """
        weighs = hypothesis.experience is not None
        if weighs and not self._alike:
            return hypothesis
        features, m = np.array(hypothesis.features), self.map
        expected = prediction.features, prediction.near, prediction.positions, prediction.covariances
        gate = chi2_gate(2, prediction.confidence)
        held = kernels.hold_back(
            features, expected, m.arrays[2], scan.covariances, gate, m.spec.confirmations, self._chance
        )
        new = None if weighs else hypothesis.new
        if held and self.spec.anew:
            new = self._new_beside(scan, prediction, features)
        return replace(hypothesis, features=features, dof=hypothesis.dof - 2 * held, new=new)

    def _new_beside(self, scan: Scan, prediction: Prediction, features: IntArray) -> BoolArray:
        """(m,) measurements that start a feature by the rule of the step where old features are not believed."""
        new, near = np.empty(len(scan), np.bool_), prediction.near
        expected = plain(prediction.positions[near]), plain(prediction.covariances[near])
        gate = self._settings()[3]
        kernels.fit_nothing(plain(scan.points), plain(scan.covariances), features, expected, gate, new)
        return new

    def _conclude(
        self, scan: Scan, expected: Expectation, hypothesis: Hypothesis, learned: Learned | None = None
    ) -> SlamStep:
        """As `RelocatingSlam` does, then what the atlas makes of it."""
        self._fused = NO_PAIRS
        step = super()._conclude(scan, expected, hypothesis, learned)
        self._lost_for = self._lost_for + 1 if self.tracker.lost else 0
        if self.tracker.doubted:
            return step
        if self.left and self.map.step % self.atlas.rejoin == 0:
            step = self._rejoin(step, scan)
        loops = self.atlas.loops
        return step if loops is None or self.map.step % loops.every else self._close(step, loops)

    def _close(self, step: SlamStep, spec: LoopSpec) -> SlamStep:
        """The step, with the loop closed that is found now, and duplicates fused that are plain."""
        parts, removed = parts_of(self.map, self.covisibility, spec), [step.removed]
        pairs = NO_PAIRS if parts is None else find_loop(self.map, self.covisibility, parts, spec)
        if len(pairs):
            self.loops.append((self.map.step, self.map.ids[pairs]))
            removed.append(self._fuse(pairs))
        everywhere, self._look_everywhere = self._look_everywhere or len(pairs) > 0, False
        twins = find_twins(self.map, self.covisibility, self.map.step if everywhere else spec.recent)
        if len(twins):
            self.twins.append((self.map.step, self.map.ids[twins]))
            removed.append(self._fuse(twins))
        return replace(step, removed=np.concatenate(removed)) if len(removed) > 1 else step

    def _fuse(self, pairs: IntArray) -> IntArray:
        """Make the features of each pair (k, 2) one; the ids (k,) of the second ones, which are gone."""
        self._became_one(self.map.ids[pairs])
        gone = self.map.ids[pairs[:, 1]]
        became = np.arange(self.map.n)
        became[pairs[:, 1]] = pairs[:, 0]
        kept = np.delete(np.arange(self.map.n), pairs[:, 1])
        self.map, self.covisibility = equate(self.map, pairs), self.covisibility.fused(*pairs.T)
        self._renumber(np.searchsorted(kept, became))
        return gone

    def _became_one(self, ids: IntArray) -> None:
        """Remember pairs (k, 2) of ids; what was kept until now may be what goes."""
        later = dict(zip(ids[:, 1].tolist(), ids[:, 0].tolist()))
        before = [(later.get(kept, kept), gone) for kept, gone in self._fused.tolist()]
        self._fused = np.array(before + ids.tolist(), np.int64).reshape(-1, 2)

    def _learn_nothing(self, prediction: Prediction, scan: Scan) -> SlamStep:
        """The step of a scan that is not believed: once there were too many, another map begins with it."""
        patience = self.atlas.patience
        if patience is None or not self.lost or self._lost_for < patience:
            return super()._learn_nothing(prediction, scan)
        removed = self._begin()
        nothing = Hypothesis(np.full(len(scan), UNPAIRED), 0.0, 0, Effort())
        return replace(self._learn(scan, self.predict_features(scan, _STILL), nothing), removed=removed)

    def _begin(self) -> IntArray:
        """Leave the current map for a new one; the ids that are left. A map too small to be recognised is dropped."""
        m, loops = self.map, self.atlas.loops or LoopSpec()
        if int((~m.provisional).sum()) >= loops.min_pairs:
            self.left.append(Left(m, self.covisibility))
        self.map, self.covisibility = successor(m), CovisibilityGraph()
        self.map.place(m.pose, np.zeros((3, 3)))
        self._recent.fill(UNPAIRED)
        self.tracker.forget()
        return m.ids

    def _rejoin(self, step: SlamStep, scan: Scan) -> SlamStep:
        """The step, with the maps joined if one is recognised in the other, by its recent part or by the scan."""
        spec = self.atlas.loops or LoopSpec()
        recent = recent_part(self.map, self.covisibility, spec)
        for position, left in enumerate(self.left):
            both = left.map, left.covisibility, self.map, self.covisibility
            joined = join_recognised(*both, recent, spec) if len(recent) >= spec.min_pairs else None
            found = self.relocate(self._in(left), scan) if joined is None else None
            if found is not None:
                joined = join_relocated(*both, found, self._behind(step), spec)
            if joined is not None:
                del self.left[position]
                return self._joined(step, left, joined)
        return step

    def _in(self, left: Left) -> Slam:
        """What a relocation is asked of a map that was left. Nobody tells what would be in view there."""
        there = Slam(self.spec)
        there.map, there.covisibility, there._farthest = left.map, left.covisibility, self._farthest
        return there

    def _behind(self, step: SlamStep) -> IntArray:
        """(m,) feature of the current map that each measurement has updated or started, or UNPAIRED."""
        index = {feature: position for position, feature in enumerate(self.map.ids.tolist())}
        return np.array([index.get(feature, UNPAIRED) for feature in step.ids.tolist()], np.int64)

    def _joined(self, step: SlamStep, left: Left, joined: Joined) -> SlamStep:
        """The step with which the current map becomes one with a map before."""
        older = left.map.n
        self.joins.append((self.map.step, joined.ids))
        self._became_one(joined.ids)
        self._relocations += 1
        self.map, self.covisibility = joined.map, joined.covisibility
        self._renumber(joined.became[older:])
        self._look_everywhere = True
        gone = joined.ids[:, 1]
        return replace(step, removed=np.concatenate([step.removed, gone]), returned=left.map.ids)


def slam_of(
    spec: SlamSpec | None = None,
    relocate: Relocate | None = None,
    view_from: ViewFrom | None = None,
    atlas: AtlasSpec | None = None,
) -> Slam:
    """The SLAM of these settings: with `relocate` it finds a lost robot again, with `atlas` besides it is an atlas.

    Raises ValueError for an atlas without `relocate`.
    """
    if relocate is None:
        if atlas is not None:
            raise ValueError("atlas: a robot that is not looked for when it is lost has no use for one")
        return Slam(spec, view_from)
    return RelocatingSlam(spec, relocate, view_from) if atlas is None else AtlasSlam(spec, relocate, view_from, atlas)
