"""Relocation. The tracker notices from the pairings of a scan, before the map learns, that the robot may be lost. A
search without a prior finds it again; its answer must explain the scan."""

import functools
import math
from collections.abc import Callable
from typing import Literal, get_args

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association import gcbb, max_clique, random_sampling, resolve_relocator
from slam_gym.association.acceptance import log_expected_pairings, min_pairings
from slam_gym.association.compatibility import chi2_gate
from slam_gym.association.prediction import Prediction, predict
from slam_gym.geometry import relative
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.locality import covisible, restricted, within
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.navigation.visibility import ViewsFrom
from slam_gym.types import (
    UNPAIRED,
    Array,
    BoolArray,
    Hypothesis,
    IntArray,
    Landmarks,
    Locality,
    Relocation,
    Relocator,
    Scan,
)

_CHANCE = 1e-6  # greatest probability of so many accidental pairings in a scan: the searches themselves admit 0.02
_EXPLAINED = 0.5  # fraction of the measurements, and of what should be in view, that a relocation must pair
_MARGIN = 3  # least number of pairings above those at any other place …
_SAME_PLACE = 0.5  # [m], [rad] … farther away than this: a place may be mapped twice
_EXPECTED = 0.5  # visibility from which a feature should be in view
_STILL_EXPECTED = 0.1  # … and visibility from which it should be, if the last scan paired it
_BELIEVED_AGAIN = 2.0  # factor on the pairings that a scan must have, while the robot is lost
_NEAREST = 1e-9  # [m]
_SLIP_CONFIDENCE = 0.9999  # of the joint test of pairings without slip
_SLIPPED = 0.8  # fraction of the measurements that must fit where the wheels have slipped and the view is unknown
_HARDLY_ACCIDENTAL = math.log(0.02)  # log of an expected number of accidental hypotheses with as many pairings …
_NOT_ACCIDENTAL = math.log(1e-4)  # … below which a scan ends a doubt …
_ACCIDENTAL_ALL = math.log(0.5)  # … and from which all pairings of a scan may be accidental
_ACCIDENTAL_SCANS = 8  # scans in a row whose pairings may be accidental: 5 occur on real logs that are mapped well
_BELIEVED = 0.5  # a scan with this fraction of its measurements paired is believed, whatever should be in view

SEARCH = "gcbb"
"""The default search for a lost robot."""

LocalityName = Literal["covisibility", "two-hop covisibility", "distance"]
LOCALITIES: tuple[LocalityName, ...] = get_args(LocalityName)

Relocate = Callable[[Scan, StochasticMap, CovisibilityGraph, float, ViewsFrom | None], Relocation | None]
"""Finds the robot: takes a scan, a map, its covisibility, the reach [m] of the sensor and, if known, what it has in
view from a pose; returns a relocation, or None where the scan does not determine the pose."""


class Tracker:
    """Counts the consecutive scans that do not show what the map predicts.

    A feature should be in view if it is confirmed, and either its visibility is at least one half, or the last scan
    that measured anything and was believed paired it, and nothing says that it has gone out of view since. Unless the
    robot is lost, the feature must also be near (`Prediction.near`): since the robot saw the others it has drifted, and
    a wall may hide them that is not where the map has it. `slam.negative_evidence` judges whether those are missing.
    A scan is doubted where

    - too few of the features that should be in view are paired, and most of the measurements are not paired either; or
    - right after a scan that was believed, hardly any measurement is paired. Where the view is known, pairings with
      features that are not confirmed yet count here, too: behind a door, nearly everything is new.

    Where the prediction tells what is in view, a scan of fewer than `min_expected` measurements is not counted as
    doubted: what should be in view may be hidden by something that is not mapped yet, and a few spurious measurements
    would then make the robot lost.

    Where the prediction does not tell what is in view, a scan that pairs a confirmed feature begins no doubt, unless
    most of many expected features are missing: on new ground, where one scan pairs less than the one before, a doubt
    would keep the map from learning the features that the next scans can be paired with. The sector in which anything
    was measured so far then stands for the view: a feature that the last scan paired and that the motion has put out of
    the sector is not expected. Nor is a scan doubted whose pairings chance hardly brings, whatever is missing
    (`acceptance.log_expected_pairings`): with a sensor of short range, most of what a scan pairs is out of view in the
    next. A doubt lasts until a scan pairs enough; a scan without measurements neither ends it nor adds another.

    So a robot that is lost among many features may pair some of them by chance in every scan, and never be doubted. If
    chance may explain all pairings of eight scans in a row that measure, and should show, six features or more, the
    robot is lost.

    So new features at the edge of the map cause no doubt as long as they come into view one by one, and neither do
    features that walls are known to hide.

    Arguments:
        fraction: fraction of the expected features, or of the measurements, that must be paired.
        scans: number of consecutive doubted scans after which the robot is lost.
        min_expected: least number of expected features, or of measurements, from which a doubt can follow.
    """

    def __init__(self, fraction: float, scans: int, min_expected: int) -> None:
        self.fraction, self.scans, self.min_expected = fraction, scans, min_expected
        self.doubted = 0  # consecutive doubted scans
        self.relocations = 0  # how often a lost robot was found again
        self.slips = 0  # how often the wheels have slipped
        self._last_paired: IntArray = np.empty(0, np.int64)
        # (m,) features paired by the last believed scan that measured anything, or UNPAIRED
        self._accidental = 0  # scans in a row whose pairings may all be accidental
        self._hardly_paired = 0  # scans in a row that were believed with less than half of their measurements paired
        self._least_cosine = 1.0  # of the bearings of all measurements so far …
        self._farthest = 0.0  # [m] … and the greatest of their distances

    @property
    def lost(self) -> bool:
        """Whether so many consecutive scans were doubted that the robot is lost."""
        return self.doubted >= self.scans

    def believes(self, scan: Scan, prediction: Prediction, hypothesis: Hypothesis) -> bool:
        """Whether the scan has enough pairings to be learned from; a scan that has not may count as doubted.

        Some pairings are accidental, so a lost robot needs twice the fraction, and twice the number, to be believed.
        """
        if self.doubted and len(scan) == 0:
            return False
        if not prediction.has_view:
            self.look(scan.points)
        if not self._is_believable(scan, prediction, hypothesis):
            if len(scan) >= self.min_expected or not prediction.has_view:
                self.doubted += 1
            return False
        if self._pairs_by_chance(scan, prediction, hypothesis):
            self.doubted, self._accidental = self.scans, 0  # lost
            return False
        is_paired = hypothesis.pairings >= _BELIEVED * len(scan)
        self._hardly_paired = 0 if is_paired else self._hardly_paired + 1
        self.accept(hypothesis)
        return True

    def suspects_slip(self, scan: Scan, prediction: Prediction, hypothesis: Hypothesis) -> bool:
        """Whether the last motion may be an outlier, as after slip: the scan is not believed.

        Where the view is unknown, doubts are less reliable. A slip is then also suspected where the pairings fit worse
        than errors of a normal motion explain, or a scan of more than `min_expected` measurements pairs less than half
        of them, unless the last `scans` scans did so, too.
        """
        measured = len(hypothesis.features)
        if self.lost or measured < self.min_expected:
            return False
        few = measured > self.min_expected and hypothesis.pairings < _BELIEVED * measured
        if not prediction.has_view and ((few and self._hardly_paired < self.scans) or not _fits(hypothesis)):
            return True
        return not self._is_believable(scan, prediction, hypothesis)

    def confirms_slip(
        self, scan: Scan, before: tuple[Prediction, Hypothesis], after: tuple[Prediction, Hypothesis]
    ) -> bool:
        """Whether the hypothesis `after`, for a prediction with slip, is jointly compatible, and pairs half of the scan
        with confirmed features and no less than the one `before`.

        Where the view is unknown, and gates are wider, it must pair most of the scan. If the pairings `before` are
        believed and fit, chance must also bring those `after` less often than them, and hardly ever.
        """
        (prediction, hypothesis), measured = after, len(after[1].features)
        established = _pairings_with(*prediction.counted, prediction.confirmations, hypothesis.features)
        paired = int(np.count_nonzero(before[1].features != UNPAIRED))
        if established < max(self.min_expected, paired, _EXPLAINED * measured) or not _fits(hypothesis):
            return False
        if prediction.has_view:
            return True
        if hypothesis.pairings < _SLIPPED * measured:
            return False
        if not _fits(before[1]) or not self._is_believable(scan, *before):
            return True
        by_chance = log_expected_pairings(scan, before[0], before[1].features)
        return log_expected_pairings(scan, prediction, hypothesis.features) < min(by_chance, _HARDLY_ACCIDENTAL)

    def look(self, points: Array) -> None:
        """Learn from measurements (m, 2) [m] in R how far the sensor can look, ahead and to either side."""
        distances = np.hypot(points[:, 0], points[:, 1])
        ahead = points[:, 0] / np.maximum(distances, _NEAREST)
        self._least_cosine = min(float(ahead.min(initial=1.0)), self._least_cosine)
        self._farthest = max(float(distances.max(initial=0.0)), self._farthest)

    def in_sector(self, positions: Array, fraction: float = 1.0) -> BoolArray:
        """(k,) which of the positions (k, 2) in R lie in the sector in which the sensor has measured before, or in one
        with a `fraction` of its angle and radius."""
        distances = np.hypot(positions[:, 0], positions[:, 1])
        least_cosine = math.cos(fraction * math.acos(self._least_cosine)) if fraction < 1.0 else self._least_cosine
        ahead = positions[:, 0] >= least_cosine * distances
        inside: BoolArray = ahead & (distances <= fraction * self._farthest)
        return inside

    def accept(self, hypothesis: Hypothesis) -> None:
        """End all doubts: tracking goes on from this hypothesis."""
        self.doubted = 0
        if len(hypothesis.features):
            self._last_paired = hypothesis.features.copy()

    def forget(self) -> None:
        """Reset the counts for another map."""
        self.doubted, self._accidental, self._hardly_paired, self._last_paired = 0, 0, 0, self._last_paired[:0]

    def renumber(self, became: IntArray) -> None:
        """Renumber the features stored here: feature j is now feature `became[j]` (n,), or UNPAIRED if removed."""
        self._last_paired = np.append(became, UNPAIRED)[self._last_paired]

    def _is_believable(self, scan: Scan, prediction: Prediction, hypothesis: Hypothesis) -> bool:
        """Whether the hypothesis pairs enough, by the rules of this class."""
        pairings = _pairings_with(*prediction.counted, prediction.confirmations, hypothesis.features)
        measured = len(hypothesis.features)
        explained = pairings >= max(_BELIEVED, self.fraction) * measured
        if not self.doubted and not explained and not prediction.has_view and pairings > 0:
            # the other measurements may show new ground, unless many features have disappeared
            expected = prediction.features[~prediction.provisional & self._should_be_seen(prediction)]
            missing = np.count_nonzero(~np.isin(expected, hypothesis.features)) > (1.0 - self.fraction) * len(expected)
            explained = not missing or min(len(expected), measured) < 2 * self.min_expected
        if (explained and not self.lost) or not self._misses_too_much(prediction, hypothesis):
            return True
        if self.lost or prediction.has_view:
            return False
        limit = _NOT_ACCIDENTAL if self.doubted else _HARDLY_ACCIDENTAL
        return log_expected_pairings(scan, prediction, hypothesis.features) < limit

    def _pairs_by_chance(self, scan: Scan, prediction: Prediction, hypothesis: Hypothesis) -> bool:
        """Whether chance may explain all pairings of this scan and of the last ones, by the rule of this class."""
        if prediction.has_view or len(scan) < 2 * self.min_expected:
            return False
        in_sector = ~prediction.provisional & self.in_sector(prediction.positions)
        if np.count_nonzero(in_sector) < 2 * self.min_expected:
            return False
        pairings = _pairings_with(*prediction.counted, prediction.confirmations, hypothesis.features)
        few = pairings < _BELIEVED * len(scan)
        by_chance = few and log_expected_pairings(scan, prediction, hypothesis.features) > _ACCIDENTAL_ALL
        self._accidental = self._accidental + 1 if by_chance else 0
        return self._accidental >= _ACCIDENTAL_SCANS

    def _misses_too_much(self, prediction: Prediction, hypothesis: Hypothesis) -> bool:
        established = ~prediction.provisional
        known, last = set(prediction.features[established].tolist()), set(self._last_paired.tolist())
        expected = set(prediction.features[established & self._should_be_seen(prediction)].tolist())
        should_persist = known & last if prediction.has_view else expected
        paired = known.intersection(hypothesis.features.tolist())
        measured = len(hypothesis.features)
        fraction = self.fraction * (_BELIEVED_AGAIN if self.lost else 1.0)
        missing = len(expected) >= self.min_expected and len(expected & paired) < fraction * len(expected)
        tracked = hypothesis.pairings if prediction.has_view and not self.lost else len(paired)
        few = measured >= self.min_expected and tracked < fraction * measured
        unresolved = self.doubted > 0 and not prediction.has_view
        unexplained = few and (unresolved or len(should_persist) >= self.min_expected)
        unsure = self.lost and len(expected & paired) < _BELIEVED_AGAIN * self.min_expected
        return (missing and len(paired) < _BELIEVED * measured) or unexplained or unsure

    def _should_be_seen(self, prediction: Prediction) -> BoolArray:
        paired = np.isin(prediction.features, self._last_paired)
        visibility = prediction.visibility()
        if visibility is None:
            return paired & self.in_sector(prediction.positions)
        in_view: BoolArray = (visibility >= _EXPECTED) | (paired & (visibility >= _STILL_EXPECTED))
        return in_view if self.lost else in_view & prediction.near


def _fits(hypothesis: Hypothesis) -> bool:
    """Whether the pairings fit as errors of a normal motion explain."""
    return hypothesis.joint_distance < chi2_gate(max(hypothesis.dof, 1), _SLIP_CONFIDENCE)


@compiled
def _pairings_with(features: IntArray, sightings: IntArray, confirmations: int, decisions: IntArray) -> int:
    """The number of decisions (m,) that pair one of the features (k,) with enough sightings to be confirmed."""
    count = 0
    for decision in decisions:
        if decision != UNPAIRED:
            for row in range(len(features)):
                if sightings[row] >= confirmations and features[row] == decision:
                    count += 1
                    break
    return count


def relocate_by(search: str | Relocator, locality: LocalityName | None = "covisibility") -> Relocate:
    """Relocation by `search` (a name, `"module:function"` or a callable) among the features of a map.

    A lost robot searches scan after scan, and rooms resemble each other, so that an answer must pass more than the
    rule of the search itself: the probability of so many accidental pairings in a scan must be less than 10⁻⁶, and most
    measurements, and most features that should be in view from the pose found, must be paired. Besides, no other place,
    without these features, may explain the scan with up to two pairings less, unless that were accidental: of two rooms
    that are alike, one loses a pairing to noise in every other scan.
    Raises ValueError for an unknown search or locality.
    """
    if locality not in (None, *LOCALITIES):
        raise ValueError(f"locality: {locality!r} is none of {', '.join(LOCALITIES)}, None")
    return functools.partial(_relocate, resolve_relocator(search), locality)


def _relocate(
    find: Relocator,
    kind: LocalityName | None,
    scan: Scan,
    m: StochasticMap,
    graph: CovisibilityGraph,
    reach: float,
    view_from: ViewsFrom | None,
) -> Relocation | None:
    """The relocation of `relocate_by`, or None."""
    landmarks, locality = m.landmarks(), locality_of(graph, m.positions, reach, kind)
    needed = max(min_pairings(scan, landmarks, probability=_CHANCE), math.ceil(_EXPLAINED * len(scan)))
    found = _search(find, scan, landmarks, locality, needed)
    if not found.accepted or found.pairings < needed or not _shows(found, m, reach, view_from):
        return None
    others, least = np.setdiff1d(np.arange(m.n), found.features), max(found.pairings - _MARGIN + 1, needed)
    if len(others) < least:
        return found
    rival = _search(find, scan, m.landmarks(others), restricted(locality, others), least)
    x, y, turn = relative(found.pose, rival.pose)  # NaN where there is none
    is_elsewhere = math.hypot(x, y) > _SAME_PLACE or abs(turn) > _SAME_PLACE
    return None if rival.pairings >= least and is_elsewhere else found


def _search(find: Relocator, scan: Scan, landmarks: Landmarks, locality: Locality | None, least: int) -> Relocation:
    """The answer of a search; those that can skip hypotheses with fewer than `least` pairings."""
    bound = {"min_pairings": least} if find in (gcbb, max_clique, random_sampling) else {}
    return find(scan, landmarks, locality, **bound)


def locality_of(graph: CovisibilityGraph, positions: Array, reach: float, kind: LocalityName | None) -> Locality | None:
    """The locality named `kind` among features at `positions` (n, 2) [m], for a sensor of range `reach` [m]."""
    if kind is None:
        return None
    if kind == "distance":
        return within(positions, 2.0 * reach)
    return covisible(graph, hops=2 if kind == "two-hop covisibility" else 1)


def _shows(found: Relocation, m: StochasticMap, reach: float, view_from: ViewsFrom | None) -> bool:
    """Whether most of the confirmed features that should be in view from the pose found, if known, are paired."""
    if view_from is None:
        return True
    relocated = m.copy()
    relocated.place(found.pose, found.covariance)
    prediction = predict(relocated, reach, sight=view_from)
    visibility = prediction.visibility()
    assert visibility is not None
    expected: IntArray = prediction.features[(visibility >= _EXPECTED) & ~prediction.provisional]
    return int(np.isin(expected, found.features).sum()) >= _EXPLAINED * len(expected)
