"""Feature-based SLAM with a stochastic map, one step on one page: predict, associate, update, add, maintain."""

from __future__ import annotations

import math
import warnings
from collections import deque
from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.association.compatibility import has_compatible
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.slam.asked import asked
from slam_gym.types import (
    NO_ID,
    UNPAIRED,
    Array,
    Associator,
    BoolArray,
    Experience,
    Hypothesis,
    IntArray,
    Odometry,
    Prediction,
    Scan,
    SlamStep,
    View,
)
from slam_gym.validation import check_hypothesis, check_scan

_NO_FEATURES = np.empty(0, np.int64)
_NO_PAIRS = np.empty((0, 2), np.int64)

ViewFrom = Callable[[Array], View]
"""From a pose (3,) in B to `Prediction.view`: what the sensor would have in view from there."""

AskingStep = Generator[Prediction, Hypothesis, SlamStep]
"""A step that somebody else associates for: yields the prediction, is sent the hypothesis, returns the step."""


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

    def __post_init__(self) -> None:
        if self.reach is not None and not 0.0 < self.reach < math.inf:
            raise ValueError(f"SlamSpec.reach: expected a finite length > 0 [m] or None, got {self.reach}")
        if self.new_confidence is not None and not 0.0 < self.new_confidence < 1.0:
            raise ValueError(f"SlamSpec.new_confidence: {self.new_confidence} is not between 0 and 1")
        if not 0.0 <= self.lost_fraction <= 1.0:
            raise ValueError(f"SlamSpec.lost_fraction: {self.lost_fraction} is not between 0 and 1")
        for name in ("recent", "lost_scans", "min_expected"):
            if getattr(self, name) < 1:
                raise ValueError(f"SlamSpec.{name}: {getattr(self, name)} is less than 1")


class Slam:
    """A robot's map and pose estimate, and the step that updates them.

    `view_from`, where it is given, tells associators what the sensor should have in view.
    """

    def __init__(self, spec: SlamSpec | None = None, view_from: ViewFrom | None = None) -> None:
        self.spec = spec or SlamSpec()
        self.view_from = view_from
        self.map = StochasticMap(self.spec.map)
        self.covisibility = CovisibilityGraph()
        self._recent: deque[IntArray] = deque(maxlen=self.spec.recent)  # features seen in each of the last scans
        self._farthest = 0.0  # [m] of any measurement so far
        self._experience: Experience | None = None  # what the associator has learned so far
        self._warned = False

    def __repr__(self) -> str:
        return f"Slam: {self.map!r}"

    def step(self, odometry: Odometry, scan: Scan, associator: str | Associator = "jcbb") -> SlamStep:
        """Move by `odometry`, then learn from `scan` as `associator` (a name, `"module:function"`, a callable) decides.

        Raises ValueError, before anything is changed, for non-finite numbers, covariances that are none and an unknown
        associator; and for a hypothesis that does not fit scan and map, when only the motion has been predicted.
        """
        return answered(self.asking_step(odometry, scan), scan, asked(associator))

    def asking_step(self, odometry: Odometry, scan: Scan) -> AskingStep:
        """The step of Castellanos, Neira and Tardós (2006), whoever associates: see `AskingStep`. Raises as `step`.

        A measurement starts a feature if it is unpaired *and* individually compatible with nothing in the map: what is
        compatible but unpaired is more likely a mapped feature than a new one, and is discarded.
        """
        check_scan(scan)
        # predict
        self.map.predict(odometry)
        prediction = self.predict_features(scan)
        # associate
        hypothesis = check_hypothesis((yield prediction), len(scan), self.map.n)
        self._experience = hypothesis.experience or self._experience
        # update
        self.map.update(scan, hypothesis.features)
        # add
        new = self.new_features(scan, prediction, hypothesis)
        created = self._add(scan, new) if len(new) else _NO_FEATURES
        # maintain
        seen = _Seen(*_seen(hypothesis.features, new, created, self.map.ids))
        self._remember(seen.features, len(created))
        removed = self._forget()
        self.map.end_of_step()
        return SlamStep(prediction, hypothesis, seen.ids, seen.created, removed)

    def predict_features(self, scan: Scan) -> Prediction:
        """What `scan` should show from the predicted pose, with the localities to search first."""
        recent = np.concatenate(self._recent) if self._recent else _NO_FEATURES
        graph = self.covisibility if self.spec.locality else None
        if self.spec.reach is None:
            self._farthest = max(self._farthest, _farthest(scan.points, scan.covariances, 3.0))
        view = None if self.view_from is None else self.view_from(self.map.pose)
        prediction = self.map.prediction(self.reach, graph, recent, view)
        return prediction if self._experience is None else replace(prediction, experience=self._experience)

    @property
    def reach(self) -> float:
        """[m] within which features are predicted: as specified, or as far as anything was measured so far."""
        return self._farthest if self.spec.reach is None else self.spec.reach

    @property
    def maps(self) -> tuple[StochasticMap, ...]:
        """The map; after it come others that a robot which was lost has left (see `slam_gym.slam.atlas`)."""
        return (self.map,)

    @property
    def lost(self) -> bool:
        """Never: nobody asks whether it is (see `slam_gym.slam.relocation.RelocatingSlam`)."""
        return False

    @property
    def doubted(self) -> bool:
        """Never, as `lost`."""
        return False

    @property
    def fused(self) -> IntArray:
        """(k, 2) ids of features that became one in the last step, the one that is kept first: none, as `lost`."""
        return _NO_PAIRS

    @property
    def relocations(self) -> int:
        """None, as `lost`."""
        return 0

    def new_features(self, scan: Scan, prediction: Prediction, hypothesis: Hypothesis) -> IntArray:
        """Measurements (a,) that start a feature, by the associator's own word or by the rule of the step.

        A gate of confidence γ turns away 1 − γ of the right pairings, and each would start a duplicate: where scans
        come by the hundred, the rule deserves a wider gate (`new_confidence`) than the pairings do.
        """
        if hypothesis.new is not None:
            return np.flatnonzero(hypothesis.new)
        left = np.flatnonzero(hypothesis.features == UNPAIRED)
        if not len(left):
            return left
        given = self.spec.new_confidence
        confidence = prediction.confidence if given is None else given
        return left[~has_compatible(scan, prediction, confidence, measurements=left)]

    def _add(self, scan: Scan, new: IntArray) -> IntArray:
        """Start a feature from each of the `new` measurements (a,); their indices in the map."""
        if self.spec.reach is not None:
            self._warn_of_reach(scan, new, self.spec.reach)
        return self.map.add(scan, new)

    def _warn_of_reach(self, scan: Scan, new: IntArray, reach: float) -> None:
        """Once, where one of the `new` measurements (a,) starts a feature so far away that it is never found again."""
        beyond = 0.0 if self._warned else _farthest(scan.points[new], scan.covariances[new], -6.0)
        if beyond <= reach:
            return
        self._warned = True
        warnings.warn(
            f"SlamSpec.reach={reach} m, but a scan measures at {beyond:.1f} m and more: features so far "
            "away are started anew with every scan and never found again; with reach=None it is taken from the scans",
            stacklevel=4,
        )

    def _remember(self, features: IntArray, created: int) -> None:
        """What this scan saw together; the last of the `features` (s,) are `created`."""
        self.covisibility.add(created)
        self.covisibility.see_together(features)
        self._recent.append(features)

    def _forget(self) -> IntArray:
        """Drop features that were never confirmed; everything indexed by feature is renumbered. Returns their ids."""
        unconfirmed = self.map.unconfirmed()
        if not len(unconfirmed):
            return _NO_FEATURES
        removed, became = self.map.ids[unconfirmed], np.full(self.map.n, UNPAIRED)
        kept = self.map.remove(unconfirmed)
        self.covisibility.keep(kept)
        became[kept] = np.arange(len(kept))
        self._renumber(became)
        return removed

    def _renumber(self, became: IntArray) -> None:
        """What is remembered by feature follows the map, in which each of n features `became` (n,) another, or none."""
        for position, features in enumerate(self._recent):
            still = became[features]
            self._recent[position] = still[still != UNPAIRED]


def answered(step: AskingStep, scan: Scan, associate: Associator) -> SlamStep:
    """The whole of a step that asks, `associate` giving the answer."""
    return send(step, associate(scan, next(step)))


def send(step: AskingStep, hypothesis: Hypothesis) -> SlamStep:
    """The rest of a step that asks, with the hypothesis that it is sent."""
    try:
        step.send(hypothesis)
    except StopIteration as end:
        done: SlamStep = end.value
        return done
    raise RuntimeError("the step asked twice")


class _Seen(NamedTuple):
    features: IntArray  # (s,) map features that the scan updated or started
    ids: IntArray  # (m,) id of the feature behind each measurement, or NO_ID
    created: BoolArray  # (m,) the measurement started it


@compiled
def _seen(
    features: IntArray, new: IntArray, created: IntArray, map_ids: IntArray
) -> tuple[IntArray, IntArray, BoolArray]:
    """`_Seen`, from the hypothesis `features` (m,) and the features `created` (a,) from the measurements `new` (a,)."""
    behind, made = features.copy(), np.zeros(len(features), np.bool_)
    for k in range(len(new)):
        behind[new[k]], made[new[k]] = created[k], True
    seen, ids, s = np.empty(len(features), np.int64), np.full(len(features), NO_ID), 0
    for i in range(len(features)):
        if behind[i] != UNPAIRED:
            seen[s], ids[i] = behind[i], map_ids[behind[i]]
            s += 1
    return seen[:s], ids, made


@compiled
def _farthest(points: Array, covariances: Array, sigmas: float) -> float:
    """[m] The greatest ‖z‖ + `sigmas` · σ of the measurements (m,), σ² being the trace of the covariance."""
    farthest = 0.0
    for i in range(len(points)):
        sigma = math.sqrt(covariances[i, 0, 0] + covariances[i, 1, 1])
        farthest = max(farthest, math.sqrt(points[i, 0] ** 2 + points[i, 1] ** 2) + sigmas * sigma)
    return farthest
