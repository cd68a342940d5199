"""Feature-based SLAM with a stochastic map, one step on one page: predict, associate, update, add, maintain."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.compatibility import has_compatible
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.slam.lost import Tracking
from slam_gym.types import (
    NONE,
    Array,
    Associator,
    BoolArray,
    Effort,
    Hypothesis,
    IntArray,
    Nearby,
    Odometry,
    Prediction,
    Scan,
    SlamStep,
)
from slam_gym.validation import check_scan

_NO_FEATURES = np.empty(0, np.int64)

Relocate = Callable[["Slam", Scan], Hypothesis | None]
"""Called scan by scan while the robot is lost. It returns None and leaves the map alone, or moves the map's pose and
returns the hypothesis to go on with (`slam_gym.slam.relocation.relocate_by`)."""

Visible = Callable[[Array, Prediction], Array]
"""From the robot's pose (3,) in B and a prediction of k features: probability (k,) that the sensor has each in view."""


@dataclass(frozen=True)
class SlamSpec:
    """Settings of a SLAM run."""

    map: MapSpec = field(default_factory=MapSpec)
    reach: float = 6.0  # [m] features predicted within this distance are offered to the associator
    new_confidence: float | None = None  # of the gate that a new feature must miss everything by; None: as `map`
    locality: bool = True  # offer covisibility localities to the associator
    recent: int = 5  # [scans] whose pairings define the locality to look in first
    collapse: float = 0.3  # a scan that pairs a lesser share of the features that should be in view is doubted …
    collapse_scans: int = 5  # … and so many of them in a row have lost the robot
    collapse_least: int = 3  # features that should be in view, without which no scan is doubted

    def __post_init__(self) -> None:
        if not 0.0 < self.reach < math.inf:
            raise ValueError(f"SlamSpec.reach: expected a finite length > 0 [m], got {self.reach}")
        if self.new_confidence is not None and not 0.0 < self.new_confidence < 1.0:
            raise ValueError(f"SlamSpec.new_confidence: {self.new_confidence} is not between 0 and 1")
        if not 0.0 <= self.collapse <= 1.0:
            raise ValueError(f"SlamSpec.collapse: {self.collapse} is no share")
        for name in ("recent", "collapse_scans", "collapse_least"):
            if getattr(self, name) < 1:
                raise ValueError(f"SlamSpec.{name}: {getattr(self, name)} is less than 1")


class Slam:
    """A robot's map and pose estimate, and the step that updates them.

    `associate` decides where measurements come from. With `relocate`, scans that pair too little of what should be in
    view are not learned from, and it is asked where the robot is once there were too many of them in a row. `visible`
    tells what should be in view.
    """

    def __init__(
        self,
        spec: SlamSpec,
        associate: Associator,
        relocate: Relocate | None = None,
        visible: Visible | None = None,
    ) -> None:
        self.spec = spec
        self.associate = associate
        self.relocate = relocate
        self.visible = visible
        self.map = StochasticMap(spec.map)
        self.covisibility = CovisibilityGraph()
        self._recent: deque[IntArray] = deque(maxlen=spec.recent)
        self.tracking = Tracking(spec.collapse, spec.collapse_scans, spec.collapse_least)
        self.relocations = 0  # so far

    @property
    def lost(self) -> bool:
        """The robot is not where the map has it, and waits for relocation."""
        return self.tracking.lost

    def step(self, odometry: Odometry, scan: Scan, associate: Associator | None = None) -> SlamStep:
        """Move by `odometry`, then learn from `scan`. `associate` overrides the run's associator for this step.

        Raises ValueError, before anything is changed, for non-finite numbers or covariances that are not PSD; and for
        a hypothesis that does not fit scan and map, when only the motion has been predicted.
        """
        prediction = self.expect(odometry, scan)
        return self.learn(scan, prediction, (associate or self.associate)(scan, prediction))

    def expect(self, odometry: Odometry, scan: Scan) -> Prediction:
        """First half of a step: move by `odometry`; what `scan` should then show. Raises as `step`."""
        check_scan(scan)
        self.map.predict(odometry)
        return self.predict_features()

    def learn(self, scan: Scan, prediction: Prediction, hypothesis: Hypothesis) -> SlamStep:
        """Second half: the `hypothesis` on the scan that `prediction` was made for. Raises as `step`."""
        if self.relocate is not None and self._doubts(prediction, hypothesis):
            found = self.relocate(self, scan) if self.lost else None
            if found is None:
                return self._learn_nothing(prediction, scan)
            hypothesis, prediction = found, self.predict_features()
            self.tracking.believe(hypothesis)
            self.relocations += 1
        if len(hypothesis.features) != len(scan):
            raise ValueError(f"hypothesis.features: {len(hypothesis.features)} decisions for {len(scan)} measurements")
        new = self.new_features(scan, prediction, hypothesis)
        self.map.update(scan, hypothesis.features)
        created = self.map.add(scan, new) if len(new) else _NO_FEATURES
        return self._remember(prediction, hypothesis, new, created)

    def predict_features(self) -> Prediction:
        """What should be seen from the predicted pose, with the localities to search first."""
        prediction = self.map.prediction(self.spec.reach, self._locality if self.spec.locality else None)
        visible, pose = self.visible, self.map.pose
        if visible is None:
            return prediction

        def view(positions: Array, covariances: Array) -> Array:
            return visible(pose, replace(prediction, positions=positions, covariances=covariances))

        return replace(prediction, visibility=visible(pose, prediction), view=view)

    def _locality(self, features: IntArray) -> Nearby:
        """Near: what was paired in recent scans, and all that was ever seen together with it."""
        recent = np.concatenate(self._recent) if self._recent else _NO_FEATURES
        near = self.covisibility.local_to(recent)[features]
        return Nearby(near, lambda rows: self.covisibility.among(features[rows]))

    def new_features(self, scan: Scan, prediction: Prediction, hypothesis: Hypothesis) -> IntArray:
        """Measurements that start a feature: unpaired *and* individually compatible with nothing in the map.

        Those that are compatible but unpaired are discarded: they are more likely mapped features than new ones. A gate
        of confidence γ turns away 1 − γ of the right pairings, and each would start a duplicate: where scans come by
        the hundred, this test deserves a wider gate (`new_confidence`) than the pairings do.
        """
        given = self.spec.new_confidence
        confidence = self.spec.map.confidence if given is None else given
        unpaired = hypothesis.features == NONE
        if not unpaired.any():
            return _NO_FEATURES
        left = np.flatnonzero(unpaired)
        return left[~has_compatible(scan, prediction, confidence, measurements=left)]

    def _remember(self, prediction: Prediction, hypothesis: Hypothesis, new: IntArray, created: IntArray) -> SlamStep:
        """Covisibility of what was seen together, maintenance, and the record of the step."""
        seen, ids, made = _seen(hypothesis.features, new, created, self.map.ids)
        self.covisibility.add(len(created))
        self.covisibility.see_together(seen)
        self._recent.append(seen)
        return SlamStep(prediction, hypothesis, ids, made, self._maintain())

    def _maintain(self) -> IntArray:
        """Drop features that were never confirmed; everything indexed by feature is renumbered. Returns their ids."""
        unconfirmed = self.map.unconfirmed()
        removed = _NO_FEATURES
        if len(unconfirmed):
            removed = self.map.ids[unconfirmed]
            count = self.map.n
            kept = self.map.remove(unconfirmed)
            self.covisibility.keep(kept)
            renumbered = np.full(count, NONE, np.int64)
            renumbered[kept] = np.arange(len(kept))
            for position, features in enumerate(self._recent):
                still = renumbered[features]
                self._recent[position] = still[still != NONE]
        self.map.end_of_step()
        return removed

    def _doubts(self, prediction: Prediction, hypothesis: Hypothesis) -> bool:
        """Too few pairings where the map should have given more: the robot may have been carried away."""
        return self.tracking.doubts(prediction, hypothesis, ~self.map.provisional[prediction.features])

    def _learn_nothing(self, prediction: Prediction, scan: Scan) -> SlamStep:
        """The step of a scan that is not believed: the map stays as the odometry left it."""
        undecided = np.full(len(scan), NONE)
        self.map.end_of_step()
        hypothesis = Hypothesis(undecided, 0.0, 0, Effort())
        return SlamStep(prediction, hypothesis, undecided, np.zeros(len(scan), np.bool_), _NO_FEATURES)


@compiled
def _seen(
    features: IntArray, new: IntArray, created: IntArray, map_ids: IntArray
) -> tuple[IntArray, IntArray, BoolArray]:
    """Features (s,) that the scan updated or started; id (m,) behind each measurement, or NONE; which started one."""
    behind, made = features.copy(), np.zeros(len(features), np.bool_)
    for k in range(len(new)):
        behind[new[k]], made[new[k]] = created[k], True
    seen, ids, s = np.empty(len(features), np.int64), np.full(len(features), NONE), 0
    for i in range(len(features)):
        if behind[i] != NONE:
            seen[s], ids[i] = behind[i], map_ids[behind[i]]
            s += 1
    return seen[:s], ids, made
