"""The atlas: the active map, the inactive maps, and the fusion of features that were mapped twice.

**Loops.** When the robot returns to an old part of the map, its drift makes the features there ambiguous: relative to
the features just paired they are so uncertain that others lie within their gates. A scan pairs such features wrongly
now and then, and one wrong scan can ruin the map. So they are not offered to the associator, but left to the search for
loops (`slam.places.loops`), which pairs them with the whole recent part of the map.

**First links.** Where a scan pairs one or two features that the robot has not seen for long, the measurement may come
from an unmapped neighbour half a metre away: a door has two jambs, and 20 m away a gate is as wide. Such pairings are
rejected until there are so many that chance hardly explains them all (`association.acceptance`).

**Associators that weigh all hypotheses,** such as `marginal`, refuse ambiguous pairings themselves, and say which
measurements are new. So they are offered the ambiguous features, too (`SlamSpec.trust_marginals`). On real logs they
are not, and the step says what is new: their probabilities are those of a model that does not hold.

**Second map.** A robot that was lost for some scans goes on in a new map. It starts there at its pose by odometry, so
that coordinates remain roughly those of B; in the new map, this pose is known exactly. The recent part of this map is
searched for in the inactive maps, again whenever a quarter of it is new. Once it is recognised, the maps are joined
with an uninformative relation, in the base of the one that began first, the paired features are made equal, and the
robot goes on in the joined map.

**Ids** are unique over all maps and are never given twice; of features that are fused, the older id stays. The features
of a map that becomes inactive are `removed` in the `SlamStep` of that moment, and `returned` when the map is joined.
"""

import functools
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np

from slam_gym.association.acceptance import are_accidental
from slam_gym.association.prediction import Prediction, SlamStep
from slam_gym.association.tracking.near_first import joint_distance_of
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.slam.places.fusion import (
    Fusion,
    MappedArea,
    close_missed_loop,
    find_duplicates,
    fuse,
    join_recognised,
    join_relocated,
)
from slam_gym.slam.places.loops import find_loop
from slam_gym.slam.places.recognition import RecognitionSpec, recent_part
from slam_gym.slam.relocate import Relocate, Tracker
from slam_gym.types import UNPAIRED, Hypothesis, IntArray, Scan
from slam_gym.validation import Checked

_NEW_PART = 0.25  # fraction of the recent part: if more is new since the last search for it, it is searched for again


@dataclass(frozen=True)
class AtlasSpec(Checked):
    """Settings of an atlas."""

    recognition: RecognitionSpec = field(default_factory=RecognitionSpec)
    patience: int | None = 3  # [scans] that a robot has been lost before it starts another map; None: it never does
    rejoin: int = 5  # [scans] between attempts to recognise an inactive map


class FusionRecord(NamedTuple):
    """Which features became one, when and why."""

    kind: Literal["loop", "duplicates", "maps"]
    step: int
    ids: IntArray  # (k, 2) the id that is kept, and the id that is removed


class Atlas:
    """The inactive maps of a robot, and the rules by which they are left, recognised and joined with the active one.

    Arguments:
        spec: settings.
        relocate: finds a scan in an inactive map.
    """

    def __init__(self, spec: AtlasSpec, relocate: Relocate) -> None:
        self.spec = spec
        self.inactive: list[MappedArea] = []  # not joined yet, oldest first
        self.fusions: list[FusionRecord] = []
        self.has_dropped = False  # whether a map was dropped, so that nobody knows where later ones are in B
        self._relocate = relocate
        self._search_everywhere = False  # whether the next search for duplicates covers the whole map
        self._searched: IntArray = np.empty(0, np.int64)  # ids of the recent part that was last searched for

    def gives_up(self, tracker: Tracker) -> bool:
        """Whether the robot has been lost for so long that it starts another map."""
        patience = self.spec.patience
        return patience is not None and tracker.lost and tracker.doubted - tracker.scans >= patience

    def next_map(self, m: StochasticMap, graph: CovisibilityGraph) -> StochasticMap:
        """An empty map to go on in. The map `m` becomes inactive, or is dropped if it is too small to be recognised."""
        if int((~m.provisional).sum()) >= self.spec.recognition.min_pairs:
            self.inactive.append(MappedArea(m, graph))
        else:
            self.has_dropped = True
        fresh = m.successor()
        fresh.place(m.pose, np.zeros((3, 3)))
        return fresh

    def fusion(self, active: MappedArea, step: SlamStep, scan: Scan, reach: float, missed: bool) -> Fusion | None:
        """Join maps, then close a loop, then fuse duplicates, as far as they are recognised after a step; or None.

        `missed` says whether a loop seems to have been missed, and is searched for in the whole map.
        """
        fusions: list[Fusion] = []
        due = bool(self.inactive) and active.map.step % self.spec.rejoin == 0
        joined = self._joined(active, step, scan, reach) if due else None
        if joined is not None:
            fusions.append(joined)
            active = MappedArea(joined.map, joined.covisibility)
        fusions += self._fused(active, missed)
        return functools.reduce(Fusion.then, fusions) if fusions else None

    def _fused(self, active: MappedArea, missed: bool) -> Iterator[Fusion]:
        """Yield the fusion that closes a loop, then the fusion of duplicates, as far as there are any."""
        spec, (m, graph) = self.spec.recognition, active
        if m.step % spec.every:
            return
        pairs = find_loop(m, graph, spec)
        closed = fuse(m, graph, pairs) if len(pairs) else None
        if closed is None and missed:
            closed = close_missed_loop(m, graph, spec)
        if closed is not None:
            m, graph = closed.map, closed.covisibility
            yield self._recorded("loop", m.step, closed)
        everywhere, self._search_everywhere = self._search_everywhere or closed is not None, False
        pairs = find_duplicates(m, graph, m.step if everywhere else spec.recent)
        if len(pairs):
            yield self._recorded("duplicates", m.step, fuse(m, graph, pairs))

    def _joined(self, active: MappedArea, step: SlamStep, scan: Scan, reach: float) -> Fusion | None:
        """The active map joined with an inactive one in which its recent part, or the scan, is recognised."""
        spec = self.spec.recognition
        recent = recent_part(*active, spec)
        ids = active.map.ids[recent]
        is_new = np.count_nonzero(~np.isin(ids, self._searched)) > _NEW_PART * len(ids)
        if is_new:
            self._searched = ids
        for position, older in enumerate(self.inactive):
            if np.isin(older.map.ids, step.removed).any():
                continue  # it was left in this step, since the scan was not found in it
            joined = join_recognised(older, active, recent, spec) if is_new else None
            found = self._relocate(scan, *older, reach, None) if joined is None else None
            if found is not None:
                index = {feature: position for position, feature in enumerate(active.map.ids.tolist())}
                features = np.array([index.get(feature, UNPAIRED) for feature in step.ids.tolist()], np.int64)
                joined = join_relocated(older, active, found, features, spec)
            if joined is not None:
                del self.inactive[position]
                self._search_everywhere, self._searched = True, self._searched[:0]
                self._recorded("maps", active.map.step, joined)
                return joined._replace(returned=older.map.ids)
        return None

    def _recorded(self, kind: Literal["loop", "duplicates", "maps"], step: int, fusion: Fusion) -> Fusion:
        self.fusions.append(FusionRecord(kind, step, fusion.ids))
        return fusion


def accepted(
    scan: Scan, prediction: Prediction, hypothesis: Hypothesis, max_chance_probability: float, trust_marginals: bool
) -> Hypothesis:
    """The hypothesis without pairings with old features that may all be accidental (see `are_accidental`).

    Of an associator that weighs all hypotheses and is not trusted, only the pairings count, and new features start by
    the rule of the step. The settings are those of `SlamSpec`.
    """
    if hypothesis.experience is not None and not trust_marginals:
        hypothesis = replace(hypothesis, new=None)
    if max_chance_probability >= 1.0:
        return hypothesis
    rejected = are_accidental(scan, prediction, hypothesis.features, max_chance_probability)
    if not rejected.any():
        return hypothesis
    features, dof = np.where(rejected, UNPAIRED, hypothesis.features), hypothesis.dof - 2 * int(rejected.sum())
    offered = np.isin(features, prediction.features)
    rows = np.where(offered, np.searchsorted(prediction.features, features), UNPAIRED)
    distance = joint_distance_of(scan.arrays, prediction.expected, rows)
    return replace(hypothesis, features=features, joint_distance=distance, dof=dof)
