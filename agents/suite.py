"""The association suite: single scans against SLAM maps, the same for every associator or relocator, and their scores.

A robot goes round a floor twice, place by place, and maps it with true associations. Some stops of the second lap
become problems: the map before the stop, with a robot that has driven on without scans, so that its pose is as
uncertain as the level prescribes, and the scan from the true place. Answers do not change the map, so that all
associators get the same problems. A task evaluates all associators or relocators in one world of one level.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from agents.evaluation.associators import Metered, hashes_of
from agents.evaluation.pipeline import Evaluation, Key, Task
from agents.evaluation.records import Record
from agents.options import Suite
from slam_gym.association import resolve_associator, resolve_relocator, true_association
from slam_gym.association.prediction import Prediction, predict
from slam_gym.geometry import relative
from slam_gym.mapping.locality import covisible
from slam_gym.navigation.explored_grid import ExploredGrid
from slam_gym.navigation.visibility import ViewsFrom
from slam_gym.scenarios import SPLITS, world_generator, world_seed
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION, Level, get_level
from slam_gym.simulation.episode import Site, survey
from slam_gym.simulation.judged import CEILING, JudgedSlam, RightAnswers
from slam_gym.simulation.kidnapping import is_right
from slam_gym.slam.slam import Slam
from slam_gym.types import UNPAIRED, Array, Hypothesis, IntArray, Landmarks, Locality, Odometry, Relocation, Scan, Truth
from slam_gym.validation import one_of
from slam_gym.world.physics import Motion
from slam_gym.world.ray_casting import NO_DISCS, NO_SEGMENTS
from slam_gym.world.reachability import free_start
from slam_gym.world.sensor import Sensor

WORLDS, PROBLEMS = 24, 12  # worlds of a level; largest number of problems of a world
QUICK_WORLDS, QUICK_PROBLEMS = 4, 8
MIN_MAPPED = 4  # least number of measurements of mapped features in a problem
WRONG_COST = 10.0  # of a wrong pairing, relative to a right one, as in the reward of Associate-v0

OUTCOMES = ("correct", "silent", "wrong", "refused", "invented")
MAX_DISTANCE = 0.3  # [m] largest position error of a right pose
MAX_TURN = math.radians(3.0)  # [rad] largest heading error of a right pose
OTHER_BUILDING = 5_000  # offset from the number of a world to that of its other building


class AssociationProblem(NamedTuple):
    """One scan to be associated, and the truth about it."""

    scan: Scan
    prediction: Prediction
    truth: RightAnswers

    @property
    def right(self) -> IntArray:
        """(m,) the right feature of each measurement."""
        return self.truth.right


def lap_around(site: Site, start: Array, spacing: float) -> Array:
    """Poses (t, 3) W of one lap over places about `spacing` [m] apart, each the nearest that is left."""
    squares = np.unique(np.floor(site.cells / spacing), axis=0, return_index=True)[1]
    left, place, order = site.cells[squares], start[:2], []
    while len(left):
        nearest = int(np.argmin(((left - place) ** 2).sum(axis=1)))
        place = left[nearest]
        order.append(place)
        left = np.delete(left, nearest, axis=0)
    places = np.array(order)
    ahead = np.diff(places, axis=0, append=places[:1])
    return np.column_stack([places, np.arctan2(ahead[:, 1], ahead[:, 0])])


class TwoLaps:
    """Two laps through one world of a level, the second backwards. They can be driven only once.

    `slam` and `grid`, the explored space, are in the state before the present stop of `sampled`.
    """

    def __init__(self, level: Level, world: int, split: str = "test") -> None:
        scenario = level.scenario
        self.level = level
        self.site = survey(scenario.generator(world_generator(split, world)), scenario)
        self.rng = np.random.default_rng((world_seed(split, world), 2, level.number))
        self.sensor = Sensor(self.site.plan, self.site.index, scenario.sensor, scenario.beams, scenario.odometry)
        self.base = free_start(self.site.plan, self.site.cells, scenario.robot.radius, self.rng)
        lap = lap_around(self.site, self.base, level.spacing)
        back = lap[::-1].copy()
        back[:, 2] += np.pi
        self.poses = np.concatenate([self.base[None], lap, back])
        self.second = 1 + len(lap)  # stop at which the second lap begins
        self.slam = Slam(replace(scenario.slam, reach=scenario.sensor.range))
        reach = float(np.hypot(*(self.site.plan.bounds[2:] - self.site.plan.bounds[:2]))) + 1.0
        self.grid = ExploredGrid(np.array([-reach, -reach, reach, reach]), scenario.grid_resolution)

    def sampled(self, count: int) -> Iterator[tuple[Odometry, Scan, RightAnswers]]:
        """Up to `count` stops, evenly spaced over the second lap, with enough measurements of mapped features: the
        motion to the stop, the scan there, and the truth about it. All stops are mapped with true associations."""
        judged, previous = JudgedSlam(self.slam, CEILING), self.base
        due = np.linspace(self.second, len(self.poses), count, endpoint=False).astype(int).tolist()
        for k, pose in enumerate(self.poses):
            moved = relative(previous, pose)
            odometry = self.sensor.odometry(Motion(moved, moved, False), self.rng)
            scan, truth = self.look(pose)
            answers = RightAnswers.of(truth, judged.identities.source_of(self.slam.map.ids))
            if due and k >= due[0] and answers.known >= MIN_MAPPED:
                due.pop(0)
                yield odometry, scan, answers
            judged.step(odometry, scan, truth)
            self.grid.integrate(self.slam.map.pose, self.sensor.beams(pose, self.rng))
            previous = pose

    def look(self, pose: Array) -> tuple[Scan, Truth]:
        """A scan from a pose (3,) W. People stand at new random places, none of them on the robot."""
        dynamics, people = self.level.scenario.dynamics, NO_DISCS
        if dynamics.people:
            cells = self.site.cells[self.rng.integers(len(self.site.cells), size=dynamics.people)]
            clear = np.hypot(*(cells - pose[:2]).T) > 2.0 * dynamics.person_radius
            people = np.column_stack([cells, np.full(len(cells), dynamics.person_radius)])[clear]
        return self.sensor.scan(pose, self.rng, (people, NO_SEGMENTS))


def problems(level: Level, world: int, count: int, split: str = "test") -> Iterator[AssociationProblem]:
    """Up to `count` problems of a world."""
    laps, sensor, (position, heading) = TwoLaps(level, world, split), level.scenario.sensor, level.blind
    blind = np.array([position, position, heading])
    for odometry, scan, truth in laps.sampled(count):
        noise = blind * laps.rng.standard_normal(3)
        lost = laps.slam.map.copy()
        lost.predict(Odometry(odometry.motion + noise, odometry.covariance + np.diag(blind**2)))
        sight = ViewsFrom(sensor.field_of_view, sensor.range, sensor.min_range, explored=laps.grid.explored)
        prediction = predict(lost, sensor.range, sight=sight, view_moves=False)
        yield AssociationProblem(scan, prediction, truth)


# -- without a prior -------------------------------------------------------------------------------------------------


class RelocationProblem(NamedTuple):
    """A scan, a map that may contain its place, and the true pose."""

    scan: Scan
    landmarks: Landmarks
    locality: Locality
    right: Array | None  # (3,) pose of the robot in B by true associations; None: in another building


def relocation_problems(level: Level, world: int, count: int, split: str = "test") -> Iterator[RelocationProblem]:
    """Up to `count` problems: half inside the map, on the second lap, then as many in another building."""
    inside, left, laps = 0, count // 2, TwoLaps(level, world, split)
    for odometry, scan, truth in laps.sampled((count + 1) // 2):
        inside += 1
        landmarks, locality = laps.slam.map.landmarks(), covisible(laps.slam.covisibility)
        known = laps.slam.map.copy()
        known.predict(odometry)
        known.update(scan, truth.right)
        yield RelocationProblem(scan, landmarks, locality, known.pose)
    other = TwoLaps(level, (world + OTHER_BUILDING) % SPLITS[split][1], split)
    for pose in other.rng.permutation(other.poses):
        scan, seen = other.look(pose)
        if min(inside, left) and np.count_nonzero(seen.sources >= 0) >= MIN_MAPPED:
            inside, left = inside - 1, left - 1
            yield RelocationProblem(scan, landmarks, locality, None)


def judge_relocation(found: Relocation, truth: Array | None) -> str:
    """The outcome: `correct`, `wrong` or `silent` inside the map; `refused` or `invented` outside."""
    if truth is None:
        return "invented" if found.accepted else "refused"
    if not found.accepted:
        return "silent"
    return "correct" if is_right(found.pose, truth, MAX_DISTANCE, MAX_TURN) else "wrong"


# -- the evaluation ---------------------------------------------------------------------------------------------------


def suite_evaluation(options: Suite, associators: Sequence[str], relocators: Sequence[str], split: str) -> Evaluation:
    """The evaluation of all associators and relocators on every level. Raises ValueError for unknown names."""
    worlds = options.worlds or (QUICK_WORLDS if options.quick else WORLDS)
    count = options.problems or (QUICK_PROBLEMS if options.quick else PROBLEMS)
    with_prior = {name: resolve_associator(name) for name in associators}
    without_prior = {name: resolve_relocator(name) for name in relocators}
    tasks = []
    for name in dict.fromkeys(options.experiments or EXPERIMENTS):
        one_of("experiment", name, EXPERIMENTS)
        searches: Mapping[str, Any] = without_prior if name == RELOCATION else with_prior
        for level, world in product(EXPERIMENTS[name].levels[:: 2 if options.quick else 1], range(worlds)):
            keys = [Key(each, level.id, world) for each in searches]
            tasks.append(Task(keys, partial(evaluate, level.id, world, searches, count, split)))
    size = {"worlds": worlds, "problems": count, "quick": options.quick, "split": split}
    return Evaluation("suite", tasks, size, {"models": hashes_of(*associators, *relocators)})


def ask(name: str, function: Callable[..., Any], problem: AssociationProblem | RelocationProblem) -> Any:
    """The answer of an associator, of which `true_association` receives the truth, or of a relocator."""
    *shown, truth = problem
    if name == CEILING:
        return true_association(*shown, sources=truth.sources, identities=truth.identities)
    return function(*shown)


def evaluate(setting: str, world: int, searches: Mapping[str, Any], count: int, split: str) -> list[Record]:
    """The record of each associator, or of each relocator where the level is one of kidnapped robots, for up to `count`
    problems of a world. `searches` are the functions by name."""
    level = get_level(setting)
    kidnapped = level.experiment == RELOCATION
    meters = [Metered(partial(ask, name, search)) for name, search in searches.items()]
    answers: list[list[Any]] = [[] for _ in meters]
    truths: list[Any] = []
    for problem in (relocation_problems if kidnapped else problems)(level, world, count, split):
        truths.append(problem.right)
        for own, meter in zip(answers, meters):
            own.append(meter(problem))
    about = {"experiment": level.experiment, "knob": level.knob}
    record = relocation_record if kidnapped else association_record
    return [about | record(own, truths) | meter.effort() for own, meter in zip(answers, meters)]


def association_record(answers: Sequence[Hypothesis], right: Sequence[IntArray]) -> Record:
    """Fractions over the problems of a world, by the right features (m,) of each; NaN where it had none.

    A scan scores (right − 10 · wrong) / mapped, but not below −1; the score is the mean, but not below 0. `spoiled` are
    scans with a wrong pairing; in `exact` scans, all measurements of mapped features are paired rightly and no others
    are paired.
    """
    counts = []
    for hypothesis, features in zip(answers, right):
        paired, mapped = hypothesis.features != UNPAIRED, features != UNPAIRED
        agreed = paired & (hypothesis.features == features)
        counts.append((agreed.sum(), (paired & ~agreed).sum(), (mapped & ~paired).sum(), mapped.sum()))
    scans = pd.DataFrame(counts, columns=["agreed", "wrong", "refused", "mapped"], dtype=float)  # measurements
    scores = ((scans.agreed - WRONG_COST * scans.wrong) / scans.mapped).clip(lower=-1.0)
    return {
        "problems": len(scans),
        "score": float(max(scores.mean(), 0.0)),  # NaN stays
        "spoiled": float((scans.wrong > 0.0).mean()),
        "refused": float((scans.refused / scans.mapped).mean()),
        "exact": float((scans.wrong + scans.refused == 0.0).mean()),
        "precision": _ratio(scans.agreed.sum(), scans.agreed.sum() + scans.wrong.sum()),
        "recall": _ratio(scans.agreed.sum(), scans.mapped.sum()),
    } | promised(answers, right)


def promised(answers: Sequence[Hypothesis], right: Sequence[IntArray]) -> Record:
    """The mean probability of the best hypothesis of a scan, and the rate at which it is right, `*` included; NaN
    without probabilities. The two agree where the posterior is calibrated."""
    p, hit = [], []
    for hypothesis, of_truth in zip(answers, right):
        if (posterior := hypothesis.posterior) is not None:
            decided = posterior.probability >= posterior.runner_up_probability
            best = hypothesis.features if decided else posterior.runner_up
            p.append(max(posterior.probability, posterior.runner_up_probability))
            hit.append(bool((best == of_truth).all()))
    return {"promised": float(np.mean(p or math.nan)), "kept": float(np.mean(hit or math.nan))}


def _ratio(part: float, whole: float) -> float:
    return float(part / whole) if whole else math.nan


def relocation_record(answers: Sequence[Relocation], right: Sequence[Array | None]) -> Record:
    """Outcomes and their score: (fraction correct − wrong inside, not below 0) · (fraction refused outside)."""
    counts = Counter(map(judge_relocation, answers, right))
    inside = counts["correct"] + counts["silent"] + counts["wrong"]
    outside = counts["refused"] + counts["invented"]
    score = _ratio(max(0, counts["correct"] - counts["wrong"]), inside) * _ratio(counts["refused"], outside)
    return {"problems": inside + outside, "score": score, **{name: counts[name] for name in OUTCOMES}}
