"""Association metrics: whether measurements were paired with the right features.

For decisions, the identity of a map feature is the source of the measurement that created it. Every measurement is
judged against the map as it was before its scan, so a feature that a scan creates does not affect the judgement of its
other measurements. For the map, it is the source of most of its measurements: a feature that one measurement of a
neighbour created, and two hundred of its own then moved into place, is no duplicate of the neighbour.
"""

from __future__ import annotations

import bisect
import math
from collections import Counter, defaultdict
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from slam_gym._jit import compiled
from slam_gym.association.prediction import SlamStep
from slam_gym.types import NO_ID, SPURIOUS, UNLABELLED, BoolArray, IntArray, Truth


class Decision(IntEnum):
    """The judgement of one measurement, as pictures and logs show it."""

    RIGHT = 0  # paired with its feature
    WRONG = 1  # paired with another feature or a duplicate, or started a duplicate
    NEW = 2  # started its feature, which the map did not have
    SPURIOUS = 3  # came from no feature, but was paired or started one
    DISCARDED = 4  # was not paired and started no feature
    UNJUDGED = 5  # its source, or that of the feature it was paired with, is unknown


@dataclass(frozen=True, slots=True)
class Tally:
    """Counts of association decisions; tallies can be added.

    A mismatch counts once, as a false positive, so that recall = TP / #(measurements whose feature is in the map).
    Unlabelled measurements, and pairings with features that such a measurement created, are not counted.
    """

    tp: int = 0  # paired with the feature of their source; of duplicates, the oldest is the right one
    fp_wrong: int = 0  # paired with a feature of another source
    fp_spurious: int = 0  # spurious, but paired
    fp_duplicate: int = 0  # paired with a later duplicate of the right feature
    fn: int = 0  # not paired, although their feature was in the map
    tn: int = 0  # not paired, correctly
    in_map: int = 0  # measurements whose feature was in the map
    new_right: int = 0  # started a feature that the map did not have
    new_wrong: int = 0  # started a duplicate, or a feature where there is none
    not_in_map: int = 0  # measurements of a real feature that the map did not have
    scans: int = 0  # scans with at least one judged measurement
    scans_exact: int = 0  # of these scans, those without any FP or FN

    def __add__(self, other: Tally) -> Tally:
        return Tally(*(getattr(self, name) + getattr(other, name) for name in self.__slots__))

    @property
    def fp(self) -> int:
        """False positives: wrong pairings of all three kinds."""
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
    """The true feature behind each map feature, learned from the steps of a SLAM run and the truth of its scans."""

    def __init__(self) -> None:
        self.decisions: IntArray = np.empty(0, np.int64)  # (m,) `Decision` of each measurement of the last step
        self._counts: IntArray = np.zeros(len(Tally.__slots__), np.int64)
        self._source: IntArray = np.full(64, UNLABELLED)  # indexed by id, features no longer in the map included
        self._oldest: IntArray = np.full(64, NO_ID)  # indexed by source: id of its oldest feature in the map
        self._measured: dict[int, Counter[int]] = defaultdict(Counter)  # id -> number of its measurements by source
        self._in_map: dict[int, list[int]] = {}  # source -> ids of its features in the map, oldest first

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
        """(k,) true feature behind each map feature in `ids` (k,); SPURIOUS: created by a spurious measurement."""
        self._source = _grown(self._source, int(ids.max(initial=0)), UNLABELLED)
        return self._source[ids]

    def majority_of(self, ids: IntArray) -> IntArray:
        """(k,) source of most measurements that each map feature in `ids` (k,) got under its id, of equals the first.

        A measurement without a label counts only if it created the feature.
        """
        counts = [self._measured.get(feature, Counter({UNLABELLED: 1})) for feature in ids.tolist()]
        return np.array([of_feature.most_common(1)[0][0] for of_feature in counts], np.int64)

    def judge(self, step: SlamStep, truth: Truth) -> None:
        """Judge the decisions of one step, then register the features that it created and removed.

        Those that are left behind when another map begins are not in the map against which its first scan is judged.
        Raises ValueError where step and truth have different numbers of measurements.
        """
        if len(step.ids) != len(truth.sources):
            raise ValueError(f"the step has {len(step.ids)} measurements, truth.sources {len(truth.sources)}")
        ids, self.decisions, removed = step.ids.tolist(), np.empty(len(step.ids), np.int64), step.removed
        largest = max(ids + removed.tolist() + step.returned.tolist(), default=0)  # of a map that was loaded
        self._source = _grown(self._source, largest, UNLABELLED)
        if step.prediction.expected.n == 0:
            left_behind = removed[~np.isin(removed, step.ids) & ~np.isin(removed, step.returned)]
            self._remove(left_behind)
            removed = np.setdiff1d(removed, left_behind)
        started = _judge(
            step.ids, step.created, truth.sources, self._source, self._oldest, self.decisions,
            self._counts,
        )  # fmt: skip
        for feature, source, new in zip(ids, truth.sources.tolist(), step.created.tolist()):
            if new or (feature != NO_ID and source != UNLABELLED):
                self._measured[feature][source] += 1
        if started:
            for i in step.created.nonzero()[0].tolist():
                self._add(step.ids.item(i), truth.sources.item(i))
        if len(step.returned):
            for feature in step.returned.tolist():
                self._add(feature, self._source.item(feature))
        self._remove(removed)

    def _add(self, feature: int, source: int) -> None:
        self._source = _grown(self._source, feature, UNLABELLED)
        self._source[feature] = source
        if source >= 0:
            bisect.insort(self._in_map.setdefault(source, []), feature)
            self._oldest = _grown(self._oldest, source, NO_ID)
            self._oldest[source] = self._in_map[source][0]

    def _remove(self, features: IntArray) -> None:
        for feature in features.tolist():
            source = self._source.item(feature)
            if source >= 0:
                self._in_map[source].remove(feature)
                self._oldest[source] = self._in_map[source][0] if self._in_map[source] else NO_ID


def _grown(values: IntArray, index: int, fill: int) -> IntArray:
    """`values`, padded with `fill` by doubling its length until `index` fits."""
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
    """Enter the `Decision` (m,) on each measurement, and add their Tally to `total` (12,); returns how many started."""
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
