"""The association problems of a level: real SLAM maps, and scans about which every associator is asked the same.

A robot goes round a floor twice, place by place, and maps it with true associations. On the second lap some looks
become problems: the map as it was before, whose robot has driven on without a look and so knows its pose as poorly as
the level says, and the scan from the true place. No answer changes the map, so that all associators meet the same
problems.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from slam_gym.association import true_association
from slam_gym.geometry import relative
from slam_gym.navigation.explored_grid import ExploredGrid
from slam_gym.navigation.visibility import FieldOfView
from slam_gym.scenarios import world_generator, world_seed
from slam_gym.scenarios.suite import Level
from slam_gym.simulation.episode import Site, survey
from slam_gym.simulation.judged import JudgedSlam
from slam_gym.slam.slam import Slam
from slam_gym.types import NONE, Array, Hypothesis, IntArray, Odometry, Prediction, Scan, Truth
from slam_gym.world.physics import Motion
from slam_gym.world.ray_casting import NO_DISCS
from slam_gym.world.reachability import free_start
from slam_gym.world.sensor import Sensor, SensorSpec

LEAST = 4  # measurements of mapped features in a problem: fewer decide nothing
WRONG_COST = 10.0  # of a wrong pairing, in right ones: as the reward of Associate-v0


@dataclass(frozen=True)
class Problem:
    """One scan to be associated, and the truth about it."""

    scan: Scan
    prediction: Prediction
    sources: IntArray  # (m,) true feature behind each measurement, NONE = spurious
    identities: IntArray  # (n,) true feature behind each feature of the map
    right: IntArray  # (m,) map feature of the same source, NONE where the map has none


@dataclass(frozen=True)
class Look:
    """One stop of a lap: how the robot got there and what it sees."""

    slam: Slam  # as it is before; it goes on once the next look is asked for
    odometry: Odometry
    scan: Scan
    truth: Truth
    identities: IntArray  # (n,) true feature behind each feature of the map
    grid: ExploredGrid  # explored so far

    @property
    def right(self) -> IntArray:
        """(m,) the map feature that each measurement comes from, NONE where the map has none."""
        oldest: dict[int, int] = {}
        for feature, source in enumerate(self.identities.tolist()):
            oldest.setdefault(source, feature)
        sources = self.truth.sources.tolist()
        return np.array([oldest.get(source, NONE) if source >= 0 else NONE for source in sources], np.int64)


def tour(site: Site, start: Array, spacing: float) -> Array:
    """Poses (t, 3) W of one lap over all places some `spacing` [m] apart, always on to the nearest one left."""
    squares = np.unique(np.floor(site.cells / spacing), axis=0, return_index=True)[1]
    left, at, order = site.cells[squares], start[:2], []
    while len(left):
        nearest = int(np.argmin(((left - at) ** 2).sum(axis=1)))
        at = left[nearest]
        order.append(at)
        left = np.delete(left, nearest, axis=0)
    places = np.array(order)
    ahead = np.diff(places, axis=0, append=places[:1])
    return np.column_stack([places, np.arctan2(ahead[:, 1], ahead[:, 0])])


class Course:
    """Two laps through one world of a level; the second runs backwards. To be run once."""

    def __init__(self, level: Level, world: int, split: str = "test") -> None:
        scenario = level.scenario
        self.level = level
        self.site = survey(scenario.generator(world_generator(split, world)), scenario)
        self.rng = np.random.default_rng((world_seed(split, world), 2, level.number))
        self.sensor = Sensor(self.site.plan, self.site.index, scenario.sensor, scenario.beams, scenario.odometry)
        self.base = free_start(self.site.plan, self.site.cells, self.rng)
        lap = tour(self.site, self.base, level.spacing)
        back = lap[::-1].copy()
        back[:, 2] += np.pi
        self.poses = np.concatenate([self.base[None], lap, back])
        self.second = 1 + len(lap)  # look at which the second lap begins

    def looks(self) -> Iterator[Look]:
        """Every look in turn, mapped with true associations."""
        scenario = self.level.scenario
        judged = JudgedSlam(Slam(replace(scenario.slam, reach=scenario.sensor.range)), "true_association")
        slam, identities, at = judged.slam, judged.identities, self.base
        reach = float(np.hypot(*(self.site.plan.bounds[2:] - self.site.plan.bounds[:2]))) + 1.0
        grid = ExploredGrid(np.array([-reach, -reach, reach, reach]), scenario.grid_resolution)
        for pose in self.poses:
            moved = relative(at, pose)
            odometry = self.sensor.odometry(Motion(moved, moved, False), self.rng)
            scan, truth = self.look(pose)
            known = identities.source_of(slam.map.ids)
            yield Look(slam, odometry, scan, truth, known, grid)
            judged.step(odometry, scan, truth)
            grid.integrate(slam.map.pose, self.sensor.beams(pose, self.rng))
            at = pose

    def sampled(self, count: int) -> Iterator[Look]:
        """Up to `count` looks, evenly spaced over the second lap, at enough of what is mapped."""
        due = np.linspace(self.second, len(self.poses), count, endpoint=False).astype(int).tolist()
        for k, look in enumerate(self.looks()):
            if due and k >= due[0] and (look.right != NONE).sum() >= LEAST:
                due.pop(0)
                yield look

    def look(self, pose: Array) -> tuple[Scan, Truth]:
        """A scan from a pose (3,) W, among people who stand somewhere else every time, none on the robot."""
        dynamics, people = self.level.scenario.dynamics, NO_DISCS
        if dynamics.people:
            cells = self.site.cells[self.rng.integers(len(self.site.cells), size=dynamics.people)]
            clear = np.hypot(*(cells - pose[:2]).T) > 2.0 * dynamics.person_radius
            people = np.column_stack([cells, np.full(len(cells), dynamics.person_radius)])[clear]
        return self.sensor.scan(pose, self.rng, people)


def problems(course: Course, count: int) -> Iterator[Problem]:
    """Up to `count` problems of a course."""
    blind = np.array([course.level.blind[0], course.level.blind[0], course.level.blind[1]])
    for look in course.sampled(count):
        noise, u = blind * course.rng.standard_normal(3), look.odometry
        lost = look.slam.map.copy()
        lost.predict(Odometry(u.motion + noise, u.covariance + np.diag(blind**2)))
        prediction = lost.prediction(course.level.scenario.sensor.range)
        prediction = replace(prediction, view=_view(course.level.scenario.sensor, look.grid, lost.pose))
        yield Problem(look.scan, prediction, look.truth.sources, look.identities, look.right)


def _view(sensor: SensorSpec, grid: ExploredGrid, pose: Array) -> Callable[[Array, Array], Array]:
    view = FieldOfView(sensor.field_of_view, sensor.range, sensor.min_range)
    return functools.partial(view.in_view, explored=grid.explored, pose=pose)


def ask(associate: Callable[..., Hypothesis], problem: Problem) -> Hypothesis:
    """An associator's answer; the true one is handed the truth."""
    if getattr(associate, "func", associate) is true_association:
        associate = functools.partial(associate, sources=problem.sources, identities=problem.identities)
    return associate(problem.scan, problem.prediction)


@dataclass(frozen=True)
class Judgement:
    """What an answer to one problem comes to, in measurements."""

    right: int
    wrong: int
    refused: int  # of a mapped feature, and left unpaired
    mapped: int  # of a mapped feature

    @property
    def exact(self) -> bool:
        """All that is mapped is paired rightly, and nothing else is paired."""
        return self.wrong == 0 and self.refused == 0

    @property
    def score(self) -> float:
        """(right − 10 · wrong) / mapped, but not below −1: 1 without a mistake, 0 for refusing everything."""
        return max(-1.0, (self.right - WRONG_COST * self.wrong) / self.mapped)


def judge(features: IntArray, problem: Problem) -> Judgement:
    """The decisions (m,) of a hypothesis, held against the truth. Raises ValueError for another number of them."""
    if len(features) != len(problem.right):
        raise ValueError(f"{len(features)} decisions for {len(problem.right)} measurements")
    paired, mapped = features != NONE, problem.right != NONE
    right = int((paired & (features == problem.right)).sum())
    return Judgement(right, int(paired.sum()) - right, int((mapped & ~paired).sum()), int(mapped.sum()))
