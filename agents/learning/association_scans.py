"""The examples from which the learned associator is trained: the hypotheses that the search keeps of a scan, and which
of their pairings are right. Scans come from train worlds of the suite and of the scenarios, and from the training parts
of recordings.

The maps of drives and logs are made by associators, so that they contain the mistakes of associators.
"""

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.suite import problems
from slam_gym.association import resolve_associator
from slam_gym.association.prediction import Prediction
from slam_gym.association.tracking.marginal import examples
from slam_gym.recordings import open_recordings
from slam_gym.scenarios import get_scenario, world_generator, world_seed
from slam_gym.scenarios.registry import slam_for
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION, get_level
from slam_gym.simulation.association_runs import DRIVERS, AssociationRun, DrivenRun, LoggedRun, ScanLog
from slam_gym.simulation.episode import survey
from slam_gym.simulation.judged import RightAnswers
from slam_gym.simulation.recorded_logs import reference_poses
from slam_gym.types import UNLABELLED, UNPAIRED, BoolArray, IntArray, Scan, Truth

WIDTH, MARGIN = 150, 16.0  # of the search; wider than in use, since the network is not trained yet
_MOST = 80  # hypotheses of a scan that are kept
_EASY = 0.15  # fraction of the unambiguous scans that are kept; the weight of each is divided by it
_DOUBT = 0.02  # a scan is ambiguous where the best hypothesis has a smaller probability than 1 − this
_MOST_TICKS = 500
SIGHTINGS = 3  # row of the first of a prediction's arrays

LEVELS = tuple(level.id for e in EXPERIMENTS.values() if e.name != RELOCATION for level in e.levels)
DRIVES = (
    "office", "aliased", "hall", "crowd", "drift-1", "drift-2", "drift-3", "aliased-drift", "hall-drift", "crowd-drift",
    "sparse", "loop",
)  # fmt: skip
LOGS = ("victoria_park/5", "victoria_park/10", "mrclam/1", "mrclam/2")  # every 5th or 10th scan; number of the robot

HIDDEN = ((), ("sizes", "not kinds"), ("sizes",), ("sizes", "views", "past"))
"""What is hidden in some worlds, so that the network learns what a pairing is worth when less is known about it."""


class Decisions(NamedTuple):
    """The example made of one scan: c pairings, b hypotheses, m measurements."""

    inputs: NDArray[np.float32]  # (c, inputs)
    measured: IntArray  # (c,)
    slots: IntArray  # (c,) the feature, numbered apart in each narrow heading
    hypotheses: IntArray  # (b, m) the pairing of each measurement, or UNPAIRED
    scores: NDArray[np.float32]  # (b,) log densities by the model, without the network
    agreed: BoolArray  # (b, m) the decision of the hypothesis on the measurement is right
    known: BoolArray  # (m,) the right decision is known, and among those of the hypotheses
    weight: float = 1.0  # of the scan in the loss


def decisions_of(scan: Scan, prediction: Prediction, truth: RightAnswers) -> Decisions | None:
    """The example made of a scan, or None where it has no pairing, or no measurement whose right decision is known."""
    parts = examples(scan, prediction, width=WIDTH, margin=MARGIN)
    inputs, measured, rows, scores = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("inputs", "measured", "rows", "log_densities")
    )
    sources, labelled = truth.sources, truth.sources != UNLABELLED
    right = (truth.identities[prediction.features[rows]] == sources[measured]) & (sources[measured] >= 0)
    unpaired = labelled & (truth.right == UNPAIRED)
    offered = np.isin(np.arange(len(scan)), measured[right])  # whether the right pairing can be chosen
    known = unpaired | (labelled & offered)
    if not known.any() or not len(measured):
        return None
    width = len(prediction) + 1  # columns of a heading; UNPAIRED is the last one of the heading before
    slots = rows + np.repeat(width * np.arange(len(parts)), [len(part.rows) for part in parts])
    number = np.full((len(scan), width * len(parts)), UNPAIRED)
    number[measured, slots] = np.arange(len(slots))
    best = np.argsort(-scores, kind="stable")[:_MOST]
    best = best[scores[best] > scores[best[0]] - MARGIN]
    kept = np.concatenate([part.hypotheses + width * k for k, part in enumerate(parts)])[best]
    hypotheses = number[np.arange(len(scan)), kept]
    agreed = np.where(hypotheses == UNPAIRED, unpaired, right[hypotheses])
    kept_scores = scores[best].astype(np.float32)
    return Decisions(inputs.astype(np.float32), measured, slots, hypotheses, kept_scores, agreed, known)


def without(hidden: Collection[str], scan: Scan, prediction: Prediction) -> tuple[Scan, Prediction]:
    """Scan and prediction without what is `hidden`: `sizes`, what should be in view (`views`), or how often features
    were seen before (`past`)."""
    if "views" in hidden:
        prediction = prediction.with_visibility(None)
    counted, sized, *others = prediction.rows
    if "past" in hidden:
        prediction, counted = replace(prediction, experience=None), counted.copy()
        counted[SIGHTINGS] = 0
    if "sizes" in hidden:
        unknown, sized = np.full(len(scan), math.nan), np.full_like(sized, math.nan)
        scan = replace(scan, sizes=unknown, size_variances=unknown)
    return scan, replace(prediction, rows=(counted, sized, *others))


# -- where scans come from ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Source:
    """A run whose scans become examples: of a level of the suite, of a scenario, or of a log."""

    kind: str  # level, drive or log
    name: str
    world: int
    associator: str = "marginal"  # that makes the map of a drive or a log
    hidden: tuple[str, ...] = ()

    def scans(self, count: int = 12) -> Iterator[Decisions]:
        """The examples of its scans; of a level, up to `count`."""
        rng = np.random.default_rng((world_seed("train", self.world), 7))
        if self.kind == "level":
            yield from self._problems(count)
        elif self.kind == "log":
            yield from self._watched(LoggedRun(_log(self.name), rng), rng)
        else:
            scenario = get_scenario(self.name)
            site = survey(scenario.generator(world_generator("train", self.world)), scenario)
            yield from self._watched(DrivenRun(scenario, site, DRIVERS["nearest_frontier"], rng), rng)

    def _problems(self, count: int) -> Iterator[Decisions]:
        level = get_level(self.name)
        sensor = replace(level.scenario.sensor, kinds="not kinds" in self.hidden)
        level = replace(level, scenario=replace(level.scenario, sensor=sensor))
        for problem in problems(level, self.world, count, "train"):
            decisions = decisions_of(*without(self.hidden, problem.scan, problem.prediction), problem.truth)
            if decisions is not None:
                yield decisions

    def _watched(self, run: AssociationRun, rng: np.random.Generator) -> Iterator[Decisions]:
        """The examples of a drive or a log: all ambiguous scans, and a fraction `_EASY` of the others."""
        associate = resolve_associator(self.associator)
        for _ in range(min(run.length, _MOST_TICKS)):
            if run.over:
                return
            run.next_scan()
            if len(run.scan) and len(run.prediction):
                truth = RightAnswers.of(run.truth, run.identities.majority_of(run.slam.map.ids))
                easy = rng.random() < _EASY
                decisions = decisions_of(*without(self.hidden, run.scan, run.prediction), truth)
                if decisions is not None and _doubtful(decisions):
                    yield decisions
                elif decisions is not None and easy:
                    yield decisions._replace(weight=1.0 / _EASY)
            run.associate(associate(run.scan, run.prediction))


def _log(name: str) -> ScanLog:
    """The training part of a log: the first half of Victoria Park, or the whole log of a robot of MR.CLAM."""
    published, _, number = name.partition("/")
    if published == "victoria_park":
        whole = open_recordings(published)[0]
        log = whole.part(0, len(whole) // 2).every(int(number))
    else:
        logs = [log for log in open_recordings(published, robots=[int(number)]) if "Dataset6" in log.name]
        if not logs:
            raise ValueError(f"{name}: the data contain no MRCLAM_Dataset6, on which the weights are trained")
        (log,) = logs

    def steps(_rng: np.random.Generator) -> Iterator[tuple[Any, Scan, Truth]]:
        for (odometry, scan, sources), pose in zip(log.steps(), reference_poses(log)):
            yield odometry, scan, Truth(pose, sources)

    return ScanLog(log.name, steps, len(log), slam_for(log), log.landmarks)


def _doubtful(d: Decisions) -> bool:
    """Whether the scan is ambiguous for the model, or the best hypothesis of the model is wrong."""
    weights = np.exp(d.scores - d.scores.max())
    best = d.agreed[np.argmax(weights)]
    return bool(weights.max() < (1.0 - _DOUBT) * weights.sum() or not best[d.known].all())
