"""Were the measurements associated with the right features?

The identity of a map feature is the source of the measurement that created it. Every measurement is judged against the
map as it was before its scan, so what a scan creates is no excuse and no trap for the rest of that scan.
"""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.prediction import SlamStep
from slam_gym.types import NO_ID, SPURIOUS, UNLABELLED, BoolArray, IntArray, Truth


class Decision(IntEnum):
    """What became of a measurement, as a picture or a log tells it."""

    RIGHT = 0  # paired with its feature
    WRONG = 1  # paired with another feature or a duplicate, or started a duplicate of its own
    NEW = 2  # started its feature, which the map did not have
    SPURIOUS = 3  # came from no feature, yet was paired or started one
    DISCARDED = 4  # neither paired nor started a feature
    UNJUDGED = 5  # nobody knows its source, or that of the feature it was paired with


@dataclass(frozen=True, slots=True)
class Tally:
    """Counts of association decisions; tallies add up.

    A mismatch counts once, as a false positive, so that recall = TP / #(measurements whose feature is in the map).
    Unlabelled measurements, and pairings with features that such a measurement created, count nowhere.
    """

    tp: int = 0  # paired with the feature of their source; of duplicates, the oldest is the right one
    fp_wrong: int = 0  # paired with a feature of another source
    fp_spurious: int = 0  # spurious, yet paired
    fp_duplicate: int = 0  # paired with a later duplicate of the right feature
    fn: int = 0  # not paired, though their feature was in the map
    tn: int = 0  # not paired, and rightly
    in_map: int = 0  # measurements whose feature was in the map
    new_right: int = 0  # started a feature that the map did not have
    new_wrong: int = 0  # started a duplicate, or a feature where there is none
    not_in_map: int = 0  # measurements of a real feature that the map did not have
    scans: int = 0  # scans with something to judge
    scans_exact: int = 0  # of those, without any FP or FN

    def __add__(self, other: Tally) -> Tally:
        return Tally(*(getattr(self, name) + getattr(other, name) for name in self.__slots__))

    @property
    def fp(self) -> int:
        """Paired and not right, whatever the reason."""
        return self.fp_wrong + self.fp_spurious + self.fp_duplicate

    @property
    def precision(self) -> float:
        """TP / (TP + FP); NaN where nothing was paired."""
        return _ratio(self.tp, self.tp + self.fp)

    @property
    def recall(self) -> float:
        """TP / #(measurements whose feature is in the map); NaN where there was none."""
        return _ratio(self.tp, self.in_map)

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall; NaN where there was nothing to pair and nothing was paired."""
        return _ratio(2 * self.tp, self.tp + self.fp + self.in_map)

    @property
    def exact(self) -> float:
        """Fraction of scans whose whole hypothesis is right; NaN without scans."""
        return _ratio(self.scans_exact, self.scans)


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else math.nan


class Identities:
    """Which true feature each map feature is, learned from the steps of a SLAM run and the truth behind its scans."""

    def __init__(self) -> None:
        self.decisions: IntArray = np.empty(0, np.int64)  # (m,) `Decision` of each measurement of the last step
        self._counts: IntArray = np.zeros(len(Tally.__slots__), np.int64)
        self._source: IntArray = np.full(64, UNLABELLED)  # indexed by id; also of features no longer in the map
        self._oldest: IntArray = np.full(64, NO_ID)  # indexed by source: id of the oldest feature the map has of it
        self._in_map: dict[int, list[int]] = {}  # source -> ids of the features the map has of it, oldest first

    @property
    def decided(self) -> list[int]:
        """The first five counts of the tally so far: right pairings, wrong ones of three kinds, and missed ones."""
        decided: list[int] = self._counts[:5].tolist()
        return decided

    @property
    def total(self) -> Tally:
        """Tally of all steps so far."""
        return Tally(*self._counts.tolist())

    def source_of(self, ids: IntArray) -> IntArray:
        """True feature (k,) behind map features (k,) given by id: SPURIOUS = created by a spurious measurement."""
        return self._source[ids]

    def judge(self, step: SlamStep, truth: Truth) -> None:
        """Judge the decisions of one step, then learn what it created and removed.

        Raises ValueError where step and truth do not speak of the same number of measurements.
        """
        if len(step.ids) != len(truth.sources):
            raise ValueError(f"the step has {len(step.ids)} measurements, truth.sources {len(truth.sources)}")
        self.decisions = np.empty(len(step.ids), np.int64)
        started = _judge(
            step.ids, step.created, truth.sources, self._source, self._oldest, self.decisions,
            self._counts,
        )  # fmt: skip
        if started:
            for i in step.created.nonzero()[0].tolist():
                self._add(step.ids.item(i), truth.sources.item(i))
        if len(step.returned):
            for feature in step.returned.tolist():
                self._add(feature, self._source.item(feature))
        if len(step.removed):
            for feature in step.removed.tolist():
                self._remove(feature)

    def _add(self, feature: int, source: int) -> None:
        self._source = _grown(self._source, feature, UNLABELLED)
        self._source[feature] = source
        if source >= 0:
            bisect.insort(self._in_map.setdefault(source, []), feature)
            self._oldest = _grown(self._oldest, source, NO_ID)
            self._oldest[source] = self._in_map[source][0]

    def _remove(self, feature: int) -> None:
        source = self._source.item(feature)
        if source >= 0:
            self._in_map[source].remove(feature)
            self._oldest[source] = self._in_map[source][0] if self._in_map[source] else NO_ID


def _grown(values: IntArray, index: int, fill: int) -> IntArray:
    """`values`, with doubled capacity until `index` fits."""
    while index >= len(values):
        values = np.concatenate([values, np.full_like(values, fill)])
    return values


_TP, _FP_WRONG, _FP_SPURIOUS, _FP_DUPLICATE, _FN, _TN = range(6)  # fields of Tally, in their order
_IN_MAP, _NEW_RIGHT, _NEW_WRONG, _NOT_IN_MAP, _SCANS, _SCANS_EXACT = range(6, 12)
_RIGHT, _WRONG, _NEW, _SPURIOUS, _DISCARDED, _UNJUDGED = (int(decision) for decision in Decision)


@compiled
def _judge(
    ids: IntArray,
    created: BoolArray,
    sources: IntArray,
    source_of: IntArray,
    oldest: IntArray,
    decisions: IntArray,
    total: IntArray,
) -> int:
    """Enter the `Decision` (m,) on each measurement, and add their Tally to the `total` (12,); how many are started."""
    counts = np.zeros(len(total), np.int64)
    decisions[:], started = _UNJUDGED, 0
    for i in range(len(ids)):
        started += created[i]
        source, paired = sources[i], ids[i] != NO_ID and not created[i]
        if source == UNLABELLED or (paired and source_of[ids[i]] == UNLABELLED):
            continue
        real, counts[_SCANS] = source != SPURIOUS, 1
        in_map = real and source < len(oldest) and oldest[source] != NO_ID
        if real:
            counts[_IN_MAP if in_map else _NOT_IN_MAP] += 1
        if paired:
            field = _TP if in_map and oldest[source] == ids[i] else _FP_DUPLICATE
            if source_of[ids[i]] != source:
                field = _FP_WRONG
            if not real:
                field = _FP_SPURIOUS
            counts[field] += 1
            decisions[i] = _RIGHT if field == _TP else (_SPURIOUS if field == _FP_SPURIOUS else _WRONG)
            continue
        counts[_FN if in_map else _TN] += 1
        decisions[i] = _DISCARDED
        if created[i]:
            decisions[i] = _SPURIOUS if not real else (_WRONG if in_map else _NEW)
            counts[_NEW_RIGHT if decisions[i] == _NEW else _NEW_WRONG] += 1
    mistakes = counts[_FP_WRONG] + counts[_FP_SPURIOUS] + counts[_FP_DUPLICATE] + counts[_FN]
    counts[_SCANS_EXACT] = counts[_SCANS] if mistakes == 0 else 0
    for field in range(len(total)):
        total[field] += counts[field]
    return started
