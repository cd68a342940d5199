"""Feature-based SLAM with a stochastic map, one step on one page: predict, associate, update, add, maintain."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, field, replace

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association import resolve_associator
from slam_gym.association.compatibility import chi2_gate
from slam_gym.association.prediction import (
    Associator,
    Prediction,
    SlamStep,
    StartRule,
    foreseen,
    local_arrays,
    refused_odometry,
)
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.map_joining import UNKNOWN_POSE
from slam_gym.mapping.measurement import rows_for
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap, bad_measurement, refused_update
from slam_gym.navigation.visibility import ViewsFrom
from slam_gym.slam import learn, predict
from slam_gym.slam.atlas import Atlas, AtlasSpec
from slam_gym.slam.learn import Settings
from slam_gym.slam.places.fusion import NO_PAIRS, MappedArea
from slam_gym.slam.relocate import Relocate
from slam_gym.slam.tracker import Tracker
from slam_gym.types import (
    NO_ID,
    UNPAIRED,
    Array,
    BoolArray,
    Effort,
    Experience,
    Hypothesis,
    IntArray,
    Odometry,
    Relocation,
    Scan,
)
from slam_gym.validation import check_hypothesis, check_inputs, check_scan, check_settings

_NO_FEATURES = np.empty(0, np.int64)
_STILL = Odometry(np.zeros(3), np.zeros((3, 3)))


@dataclass(frozen=True)
class SlamSpec:
    """Settings of a SLAM run."""

    map: MapSpec = field(default_factory=MapSpec)
    reach: float | None = None  # [m] features predicted so near are offered to the associator; None: as far as was seen
    new_confidence: float | None = None  # of the gate that a new feature must miss everything by; None: as `map`
    locality: bool = True  # offer covisibility localities to the associator
    recent: int = 5  # [scans] whose pairings define the locality to look in first
    lost_fraction: float = 0.3  # a scan that pairs less of the features that should be in view is doubted …
    lost_scans: int = 5  # … and so many of them in a row have lost the robot
    min_expected: int = 3  # features that should be in view, without which no scan is doubted
    max_chance_probability: float = 1.0  # that all pairings with old features are accidental; above, they are rejected
    start_features_from_rejected: bool = False  # a measurement whose pairing was rejected starts a feature

    def __post_init__(self) -> None:
        check_settings(self)


class Slam:
    """A robot's map and pose estimate, and the step that updates them.

    Arguments:
        spec: settings.
        view_from: what the sensor should have in view from a pose, which associators and the tracker ask for.
        relocate: finds a robot that is lost (`slam_gym.slam.relocate.relocate_by`). A scan that pairs too little of
            what should be in view is then doubted, and not learned from. After too many of them in a row the robot is
            lost, and searched for scan after scan. None: every scan is learned from.
        atlas: closes loops, and starts and joins maps of a robot that stays lost (`slam_gym.slam.atlas`).

    Raises ValueError for an atlas without `relocate`.
    """

    def __init__(
        self,
        spec: SlamSpec | None = None,
        view_from: ViewsFrom | None = None,
        *,
        relocate: Relocate | None = None,
        atlas: AtlasSpec | None = None,
    ) -> None:
        self.spec = spec or SlamSpec()
        self.view_from, self.relocator = view_from, relocate
        self.tracker: Tracker | None = None
        self.atlas: Atlas | None = None
        if relocate is not None:
            self.tracker = Tracker(self.spec.lost_fraction, self.spec.lost_scans, self.spec.min_expected)
        if atlas is not None:
            if relocate is None:
                raise ValueError("atlas: a robot that is not searched for when it is lost has no use for one")
            self.atlas = Atlas(
                atlas, relocate, self.spec.max_chance_probability, self.spec.start_features_from_rejected
            )
        self.map = StochasticMap(self.spec.map)
        self.covisibility = CovisibilityGraph()
        self.fused = NO_PAIRS  # (k, 2) ids of features that became one in the last step, the one that is kept first
        self._recent = np.full((self.spec.recent, 32), UNPAIRED)  # features seen in each of the last scans, in turns
        self._learned = 0  # scans
        self._farthest = 0.0  # [m] of any measurement so far
        self._experience: Experience | None = None  # what the associator has learned so far
        self._warned = False
        given, self._gate = self.spec.new_confidence, chi2_gate(2, self.spec.map.confidence)
        # χ² gate within which a new feature must not be compatible with anything
        self._new_gate = chi2_gate(2, self.spec.map.confidence if given is None else given)

    def __repr__(self) -> str:
        return f"Slam: {self.map!r}"

    def step(self, odometry: Odometry, scan: Scan, associator: str | Associator = "jcbb") -> SlamStep:
        """The step of Castellanos, Neira and Tardós (2006): predict, associate, update, add, maintain.

        `associator` is a name, `"module:function"` or a callable. Raises ValueError, before anything is changed, as
        `predict`, and for an unknown associator; and as `learn` once the motion has been predicted.
        """
        associate = resolve_associator(associator)
        prediction = self.predict(odometry, scan)
        hypothesis = associate(scan, prediction)
        return self.learn(scan, prediction, hypothesis)

    def predict(self, odometry: Odometry, scan: Scan) -> Prediction:
        """Move by `odometry`; what `scan` should show from there, with the localities to search first.

        Raises ValueError, nothing changed, for non-finite numbers and covariances that are none.
        """
        check_inputs(odometry, scan)
        most = math.inf if self.atlas is None else self.atlas.most_accidental(self._experience)
        return self._predict(odometry, scan, most)

    def learn(self, scan: Scan, prediction: Prediction, hypothesis: Hypothesis) -> SlamStep:
        """What follows the associator's answer: the map learns from the scan, unless that is not believed.

        Raises ValueError for a hypothesis that does not fit scan and map; only the motion has been predicted then.
        """
        hypothesis, self.fused = check_hypothesis(hypothesis, len(scan), self.map.n), NO_PAIRS
        if self.tracker is not None and not self.tracker.believes(scan, prediction, hypothesis):
            return self.close_loops(self.relocate(scan, prediction), scan)
        rule = StartRule.of(hypothesis)
        if self.tracker is not None and self.atlas is not None:
            believed = hypothesis
            hypothesis, rule = self.atlas.accepted(scan, prediction, hypothesis, self._new_gate)
            if hypothesis is not believed:
                self.tracker.accept(hypothesis)  # what is rejected is not expected to be seen again
        return self.close_loops(self.update(scan, prediction, hypothesis, rule), scan)

    def update(
        self, scan: Scan, prediction: Prediction, hypothesis: Hypothesis, rule: StartRule = StartRule.FITS_NOTHING
    ) -> SlamStep:
        """Update the map with the pairings, add what is new, and drop what was not confirmed in time.

        New is what the associator says. Where it does not say, a measurement starts a feature if it is unpaired *and*
        individually compatible with nothing in the map: what is compatible but unpaired is more likely a mapped feature
        than a new one, and is discarded. A gate of confidence γ turns away 1 − γ of the right pairings, and each would
        start a duplicate: where scans come by the hundred, the rule deserves a wider gate (`new_confidence`).
        """
        m, graph, count = self.map, self.covisibility, len(scan.points)
        m.make_room(count)
        graph.make_room(count)
        is_decided, recent, ids = hypothesis.new is not None, self._row_for(count), np.empty(count, np.int64)
        created = np.array(hypothesis.new) if is_decided else np.empty(count, np.bool_)
        decisions, expected = (hypothesis.features, created, is_decided, ids), prediction.expected
        ended = learn.NARROW
        while ended == learn.NARROW:
            ended, what, added = learn.learn(
                m.arrays, m.numbers, graph.arrays, recent, scan.arrays, decisions, expected, self._settings()
            )
            if ended == learn.NARROW:
                graph.widen(what)
        self._experience = hypothesis.experience or self._experience
        m.learned(added)
        graph.learned(added)
        if ended != learn.DONE:
            raise self._refusal(ended, what, scan, hypothesis.features)
        if added and self.spec.reach is not None:
            self._warn_of_reach(scan, created, self.spec.reach)
        self._learned += 1
        removed = self._forget(what) if what else _NO_FEATURES
        m.end_of_step()
        return SlamStep(prediction, hypothesis, ids, created, removed, rule)

    def relocate(self, scan: Scan, prediction: Prediction) -> SlamStep:
        """The step of a scan that is not believed. The map learns nothing, unless the robot is lost and found by it.

        The robot is then moved to the pose found, with a covariance that says nothing, and the update with the pairings
        leaves it with what they tell. One that stays lost for too long goes on in another map.
        Raises ValueError, the robot unmoved, for an answer that cannot be.
        """
        assert self.tracker is not None and self.relocator is not None
        nothing = Hypothesis(np.full(len(scan), UNPAIRED), 0.0, 0, Effort())
        found = None
        if self.tracker.lost:
            found = self.relocator(scan, self.map, self.covisibility, self.reach, self.view_from)
        if found is not None:
            return self._go_on_from(found, scan, self.tracker)
        if self.atlas is not None and self.atlas.gives_up(self.tracker):
            removed = self._begin_map(self.atlas, self.tracker)
            return replace(self.update(scan, self.predict(_STILL, scan), nothing), removed=removed)
        self.map.end_of_step()
        return SlamStep(prediction, nothing, np.full(len(scan), NO_ID), np.zeros(len(scan), np.bool_), _NO_FEATURES)

    def close_loops(self, step: SlamStep, scan: Scan) -> SlamStep:
        """The step, once what the atlas finds to be the same is one."""
        if self.atlas is None or self.doubted:
            return step
        fusion = self.atlas.fusion(MappedArea(self.map, self.covisibility), step, scan, self.reach)
        if fusion is None:
            return step
        self.map, self.covisibility, self.fused = fusion.map, fusion.covisibility, fusion.ids
        self._renumber(fusion.became)
        if self.tracker is not None and len(fusion.returned):
            self.tracker.relocations += 1
        gone = np.concatenate([step.removed, fusion.ids[:, 1]])
        return replace(step, removed=gone, returned=fusion.returned)

    @property
    def reach(self) -> float:
        """[m] within which features are predicted: as specified, or as far as anything was measured so far."""
        return self._farthest if self.spec.reach is None else self.spec.reach

    @property
    def maps(self) -> tuple[StochasticMap, ...]:
        """The active map, then the inactive ones of the atlas, in the coordinates that they were left with."""
        return (self.map,) if self.atlas is None else (self.map, *[area.map for area in self.atlas.inactive])

    @property
    def lost(self) -> bool:
        """The robot is not where the map has it, and waits for relocation. Never, without `relocate`."""
        return self.tracker is not None and self.tracker.lost

    @property
    def doubted(self) -> bool:
        """The last scan was not believed. Never, without `relocate`."""
        return self.tracker is not None and self.tracker.doubted > 0

    @property
    def relocations(self) -> int:
        """How often the robot was found again so far."""
        return 0 if self.tracker is None else self.tracker.relocations

    def _predict(self, odometry: Odometry, scan: Scan, most_accidental: float) -> Prediction:
        """Of the features in reach; old ones in whose gates more accidental matches are expected are left out."""
        m, rows, pose = self.map, rows_for(self.map.n), np.empty(4)
        motion, measured, reach = (odometry.motion, odometry.covariance), (scan.points, scan.covariances), self.reach
        if self.spec.reach is None:
            reach = max(reach, _farthest(*measured, np.ones(len(scan), np.bool_), 3.0))
        rule = reach, m.spec.second_order, self._gate, most_accidental
        locality = (*local_arrays(self.covisibility if self.spec.locality else None), self._recent.ravel())
        k = predict.predict(m.arrays, (m.n, m.step), motion, measured, rule, locality, pose, rows)
        if k == predict.BAD_SCAN:
            check_scan(scan)
        if k == predict.BAD_ODOMETRY:
            raise refused_odometry(odometry)
        m.moved()
        self._farthest = reach
        return foreseen(m, rows, k, pose, locality, self.view_from, experience=self._experience)

    def _go_on_from(self, found: Relocation, scan: Scan, tracker: Tracker) -> SlamStep:
        """The step of a scan that says where the robot is. Raises ValueError, the robot unmoved, where it cannot be."""
        answer = Hypothesis(found.features, found.joint_distance, 2 * found.pairings, found.effort)
        hypothesis = check_hypothesis(answer, len(scan), self.map.n)
        self.map.place(found.pose, UNKNOWN_POSE)
        tracker.accept(hypothesis)
        tracker.relocations += 1
        everything = self._predict(_STILL, scan, math.inf)  # nothing is known of the pose: all would be ambiguous
        return self.update(scan, everything, hypothesis)

    def _begin_map(self, atlas: Atlas, tracker: Tracker) -> IntArray:
        """Go on in an empty map; the ids of the features that are left behind."""
        removed = self.map.ids
        self.map, self.covisibility = atlas.next_map(self.map, self.covisibility), CovisibilityGraph()
        self._recent.fill(UNPAIRED)
        tracker.forget()
        return removed

    def _settings(self) -> Settings:
        """What `learn.learn` takes as its settings."""
        spec = self.spec.map
        before = -1 if spec.unconfirmed_age is None else self.map.step - spec.unconfirmed_age
        return spec.iterations, float(spec.settled), spec.right_invariant, self._new_gate, spec.confirmations, before

    def _refusal(self, ended: int, what: int, scan: Scan, features: IntArray) -> ValueError:
        """Why `learn.learn` did not come to its end."""
        if ended == learn.REFUSED:
            return refused_update(what, scan, features, self.map.n)
        if ended == learn.NOT_ADDED:
            return bad_measurement(scan, what)
        return ValueError(f"scan.covariances[{what}] leaves the innovation covariance singular")

    def _row_for(self, count: int) -> IntArray:
        """Where to enter the features of this scan of so many measurements, in place of those of the oldest one."""
        rows, width = self._recent.shape
        if count > width:
            self._recent = np.pad(self._recent, ((0, 0), (0, count - width)), constant_values=UNPAIRED)
        row: IntArray = self._recent[self._learned % rows]
        return row

    def _warn_of_reach(self, scan: Scan, new: BoolArray, reach: float) -> None:
        """Once, where one of the `new` measurements (m,) starts a feature so far away that it is never found again."""
        beyond = 0.0 if self._warned else _farthest(scan.points, scan.covariances, new, -6.0)
        if beyond <= reach:
            return
        self._warned = True
        warnings.warn(
            f"SlamSpec.reach={reach} m, but a scan measures at {beyond:.1f} m and more: features so far "
            "away are started anew with every scan and never found again; with reach=None it is taken from the scans",
            stacklevel=4,
        )

    def _forget(self, due: int) -> IntArray:
        """Drop the features that are due; everything indexed by feature is renumbered. Returns their ids."""
        m, graph = self.map, self.covisibility
        became, removed = np.empty(m.n, np.int64), np.empty(due, np.int64)
        *_, confirmations, before = self._settings()
        learn.forget(m.arrays, m.n, graph.arrays, (confirmations, before), became, removed)
        m.learned(-due)
        graph.learned(-due)
        self._renumber(became)
        return removed

    def _renumber(self, became: IntArray) -> None:
        """What is remembered by feature follows the map, in which each of n features `became` (n,) another, or none."""
        self._recent = np.append(became, UNPAIRED)[self._recent]
        if self.tracker is not None:
            self.tracker.renumber(became)


@compiled
def _farthest(points: Array, covariances: Array, chosen: BoolArray, sigmas: float) -> float:
    """[m] The greatest ‖z‖ + `sigmas` · σ of the `chosen` measurements (m,), σ² being the trace of the covariance."""
    farthest = 0.0
    for i in range(len(points)):
        if not chosen[i]:
            continue
        sigma = math.sqrt(covariances[i, 0, 0] + covariances[i, 1, 1])
        farthest = max(farthest, math.sqrt(points[i, 0] ** 2 + points[i, 1] ** 2) + sigmas * sigma)
    return farthest
