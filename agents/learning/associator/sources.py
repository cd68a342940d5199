"""Where the scans come from that the learned associator is trained on: train worlds of the suite and of the scenarios,
and the training parts of recordings. Maps in the loop are made by associators, so that their mistakes are in them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from agents.learning.associator.decisions import Decisions, decisions_of
from agents.suite.problems import Problem, TwoLaps, problems
from slam_gym.association import resolve_associator
from slam_gym.recordings.catalogue import open_recordings
from slam_gym.recordings.recording import Recording
from slam_gym.scenarios import get_scenario, world_generator, world_seed
from slam_gym.scenarios.registry import slam_for
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION, get_level
from slam_gym.simulation.association_runs import DRIVERS, AssociationRun, DrivenRun, LoggedRun, ScanLog
from slam_gym.simulation.episode import survey
from slam_gym.simulation.recorded_logs import reference_poses
from slam_gym.simulation.right_answers import RightAnswers
from slam_gym.types import UNLABELLED, UNPAIRED, IntArray, Prediction, Scan, Truth

LEVELS = tuple(level.id for e in EXPERIMENTS.values() if e.name != RELOCATION for level in e.levels)
LOOPS = (
    "office", "aliased", "hall", "crowd", "drift-1", "drift-2", "drift-3", "aliased-drift", "hall-drift", "crowd-drift",
    "sparse", "loop",
)  # fmt: skip
LOGS = ("victoria_park/5", "victoria_park/10", "mrclam/1", "mrclam/2")  # every so many scans; robot

_EASY = 0.15  # fraction of the scans kept in which the model has no doubt; each counts for more by as much
_DOUBT = 0.02
_MOST_TICKS = 500


@dataclass(frozen=True)
class Source:
    """One run that is looked at: of a level of the suite, a scenario, or a log."""

    kind: str  # level, loop or log
    name: str
    world: int
    associator: str = "marginal"  # who maps, in the loop
    hidden: str = "nothing"  # what the network is not told, see `Hidden`

    def scans(self, count: int = 12) -> Iterator[Decisions]:
        """The decisions of its scans; of a level, of `count` of them."""
        if self.kind == "level":
            for p in self._problems(count):
                found = decisions_of(*without(self.hidden, p.scan, p.prediction), p.truth)
                if found is not None:
                    yield found
            return
        rng = np.random.default_rng((world_seed("train", self.world), 7))
        run = _drive(self, rng) if self.kind == "loop" else LoggedRun(_log(self.name), rng)
        yield from _watched(run, self, rng)

    def _problems(self, count: int) -> Iterator[Problem]:
        level = get_level(self.name)
        sensor = replace(level.scenario.sensor, kinds=self.hidden == "sizes, but for kinds")
        told = replace(level, scenario=replace(level.scenario, sensor=sensor))
        return problems(TwoLaps(told, self.world, "train"), count)


HIDDEN = ("nothing", "sizes, but for kinds", "sizes", "all but places")
VIEWS, VIEWS_AND_SIZES = "views", "views and sizes"  # as in recordings
"""What may be hidden, so that the network knows how much a pairing is worth of which less is told."""


def without(hidden: str, scan: Scan, prediction: Prediction) -> tuple[Scan, Prediction]:
    """The two as somebody would have them who does not measure what is `hidden`."""
    if hidden == "nothing":
        return scan, prediction
    if hidden in (VIEWS, VIEWS_AND_SIZES):
        prediction = replace(prediction, view=None)
    if hidden == VIEWS:
        return scan, prediction
    nan = np.full(len(scan), math.nan)
    prediction = replace(prediction, **dict.fromkeys(("sizes", "size_variances"), np.full(len(prediction), math.nan)))
    if hidden == "all but places":
        prediction = replace(prediction, view=None, sightings=None, experience=None)
    return replace(scan, sizes=nan, size_variances=nan), prediction


def _drive(source: Source, rng: np.random.Generator) -> AssociationRun:
    scenario = get_scenario(source.name)
    site = survey(scenario.generator(world_generator("train", source.world)), scenario)
    return DrivenRun(scenario, site, DRIVERS["nearest_frontier"], rng)


def _log(name: str) -> ScanLog:
    """The training part of a log: the first half of the park, all of a robot of MR.CLAM."""
    published, _, number = name.partition("/")
    if published == "victoria_park":
        whole = open_recordings(published)[0]
        log = whole.part(0, len(whole) // 2).every(int(number))
    else:
        log = next(log for log in open_recordings(published, robots=[int(number)]) if "Dataset6" in log.name)
    return _as_scan_log(log)


def _as_scan_log(log: Recording) -> ScanLog:
    def steps(_rng: np.random.Generator):  # type: ignore[no-untyped-def]
        poses = reference_poses(log)
        for (odometry, scan, sources), pose in zip(log.steps(), poses):
            yield odometry, scan, Truth(pose, sources)

    return ScanLog(log.name, steps, len(log), slam_for(log), log.landmarks)


def _watched(run: AssociationRun, source: Source, rng: np.random.Generator) -> Iterator[Decisions]:
    """The scans of a run in which there is something to decide; of those without a doubt only some."""
    associate, seen = resolve_associator(source.associator), SeenAs()
    for _ in range(min(run.length, _MOST_TICKS)):
        if run.over:
            return
        run.next_scan()
        if len(run.scan) and len(run.prediction):
            ids = run.slam.map.ids
            truth = RightAnswers.of(run.truth, seen.source_of(ids, run.identities.source_of(ids)))
            easy = rng.random() < _EASY
            found = decisions_of(*without(source.hidden, run.scan, run.prediction), truth)
            if found is not None and _doubtful(found):
                yield found
            elif found is not None and easy:
                yield found._replace(weight=1.0 / _EASY)
        hypothesis = associate(run.scan, run.prediction)
        seen.add(run.slam.map.ids, hypothesis.features, run.truth.sources)
        run.associate(hypothesis)


class SeenAs:
    """What each feature of a map has mostly been seen as: one that was started by one thing, and is updated by another
    from then on, is the other, though it keeps the name of the first."""

    def __init__(self) -> None:
        self._votes: dict[int, Counter[int]] = {}

    def source_of(self, ids: IntArray, started: IntArray) -> IntArray:
        """(n,) of features `ids` (n,) that the true features `started` (n,) have started."""
        for feature, source in zip(ids.tolist(), started.tolist()):
            self._votes.setdefault(feature, Counter({source: 1}))
        return np.array([self._votes[feature].most_common(1)[0][0] for feature in ids.tolist()], np.int64)

    def add(self, ids: IntArray, features: IntArray, sources: IntArray) -> None:
        """A scan whose measurements of `sources` (m,) are paired with `features` (m,)."""
        for feature, source in zip(features.tolist(), sources.tolist()):
            if feature != UNPAIRED and source != UNLABELLED and int(ids[feature]) in self._votes:
                self._votes[int(ids[feature])][source] += 1


def _doubtful(d: Decisions) -> bool:
    """Whether the model has a doubt, or is wrong."""
    weights = np.exp(d.scores - d.scores.max())
    best = d.hypotheses[np.argmax(weights)]
    right = np.where(best < 0, d.unpaired, np.append(d.right, False)[best])
    return bool(weights.max() < (1.0 - _DOUBT) * weights.sum() or not right[d.known].all())
