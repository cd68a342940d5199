"""The association suite: one question, one sweep and one score in [0, 1] per capability, in the manner of bsuite.

An experiment is a sweep over one parameter, its knob. Each of its levels is a frozen setting with an id such as
`closure/3`, which `get_level` returns; its `scenario` can be driven like any other, and has that id in `get_scenario`.
`agents.suite` evaluates the levels: it builds maps by SLAM with true associations, and then all associators associate
the same scans.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from slam_gym.scenarios.scenario import Scenario
from slam_gym.validation import one_of
from slam_gym.world.draft import Contents
from slam_gym.world.floor_plan import Features, FloorPlan, Kind, Room
from slam_gym.world.generators import AliasedGenerator, OfficeGenerator
from slam_gym.world.physics import DynamicsSpec
from slam_gym.world.sensor import OdometrySpec, SensorSpec


@dataclass(frozen=True)
class Level:
    """A frozen setting: the world and its sensor, and the uncertainty of the pose at the time of the scan."""

    experiment: str
    number: int
    knob: float  # value of the level on the experiment's axis
    scenario: Scenario
    blind: tuple[float, float]  # [m], [rad] σ of position and heading after driving without a scan

    @property
    def id(self) -> str:
        """`experiment/number`, the argument of `get_level`."""
        return f"{self.experiment}/{self.number}"

    @property
    def spacing(self) -> float:
        """[m] between the places from which the map is built."""
        return min(1.5, self.scenario.sensor.range / 4.0)


@dataclass(frozen=True)
class Experiment:
    """A capability, the knob that tests it, and its levels from easy to hard."""

    name: str
    question: str
    why: str  # how the knob changes an association problem
    axis: str  # name of the knob, with its unit
    knobs: tuple[float, ...]
    scenario: Callable[[float], Scenario]  # for a knob
    blind: Callable[[float], tuple[float, float]] = lambda knob: (0.08, math.radians(1.0))  # `Level.blind` for a knob

    @cached_property
    def levels(self) -> tuple[Level, ...]:
        """The levels, from the first knob to the last."""
        return tuple(
            Level(self.name, number, knob, replace(self.scenario(knob), name=f"{self.name}/{number}"), self.blind(knob))
            for number, knob in enumerate(self.knobs)
        )


@dataclass(frozen=True)
class PostsGenerator:
    """An empty square room with a hundred posts at random, so thin that they hide nothing."""

    density: float  # [1/m²]

    def __call__(self, rng: np.random.Generator) -> FloorPlan:
        side = math.sqrt(_POSTS / self.density)
        corners = np.array([[0.0, 0.0], [side, 0.0], [side, side], [0.0, side]])
        positions, kinds = rng.uniform(0.0, side, (_POSTS, 2)), np.full(_POSTS, int(Kind.PILLAR))
        while len(np.unique(np.round(positions, 3), axis=0)) < _POSTS:  # a plan has no two features in one millimetre
            positions = rng.uniform(0.0, side, (_POSTS, 2))
        posts = Features(positions, kinds, np.full(_POSTS, 0.05))
        return FloorPlan("posts", np.hstack([corners, np.roll(corners, -1, axis=0)]), posts, (Room("room", corners),))


_POSTS = 100
_IN_SIGHT = 12  # posts within reach of the sensor, on average
_SENSOR = SensorSpec(detection=0.95, clutter=0.0, max_features=60)
_ODOMETRY = OdometrySpec(forward=0.01, lateral=0.005, turn_per_radian=0.01, turn_per_metre=0.005)
_OFFICE = Scenario(
    "office",
    OfficeGenerator(rooms=6, contents=Contents(pilasters=0.15)),
    budget=600,
    sensor=_SENSOR,
    odometry=_ODOMETRY,  # so good that `Level.blind` determines the uncertainty of the pose
)


def _with_sensor(**changes: Any) -> Scenario:
    return replace(_OFFICE, sensor=replace(_SENSOR, **changes))


def _rooms_at_pitch(pitch: float) -> Scenario:
    width = (pitch - 0.2, pitch - 0.2)
    generator = AliasedGenerator(rooms=12, room_width=width, room_depth=(4.4, 4.8), door_width=(0.8, 0.9))
    return replace(_OFFICE, generator=generator)


def _posts(density: float) -> Scenario:
    reach = math.sqrt(_IN_SIGHT / (0.5 * _SENSOR.field_of_view * density))
    return replace(_OFFICE, generator=PostsGenerator(density), sensor=replace(_SENSOR, range=reach))


EXPERIMENTS: dict[str, Experiment] = {
    experiment.name: experiment
    for experiment in (
        Experiment(
            "closure",
            "How lost may the robot be and still recognise what it sees?",
            "The gates grow with the uncertainty of the pose, so that each measurement has more compatible features; "
            "but all errors share one cause, the pose, and so the innovations of a right hypothesis agree with each "
            "other.",
            "σ of position before the scan [m]; heading 12° per metre",
            (0.02, 0.1, 0.3, 0.6, 1.0),
            lambda sigma: _OFFICE,
            lambda sigma: (sigma, math.radians(12.0 * sigma)),
        ),
        Experiment(
            "drift",
            "How large may the error of the heading after one tick be?",
            "At six metres, one degree is ten centimetres. All measurements are turned together, further than the "
            "linearised gates of each allow for: 3°, 5° and 8° are the σ of the odometry of `drift-1` to "
            "`drift-3` in the fastest turn of one tick.",
            "σ of heading before the scan [°]; position 0.1 m",
            (1.0, 3.0, 5.0, 8.0, 12.0),
            lambda sigma: _with_sensor(detection=0.9, clutter=1.0),
            lambda sigma: (0.1, math.radians(sigma)),
        ),
        Experiment(
            "aliasing",
            "Are identical rooms distinguished when the pose does not quite determine the room?",
            "Rooms repeat at the pitch. A hypothesis that is off by one room pairs as many measurements as the right "
            "one and is consistent in itself: only the prior on the pose, and the features at the ends of the "
            "corridor, contradict it.",
            "pitch of identical rooms [m]; σ of position 0.8 m",
            (6.0, 4.5, 3.5, 2.8, 2.2),
            _rooms_at_pitch,
            lambda pitch: (0.8, math.radians(3.0)),
        ),
        Experiment(
            "clutter",
            "How many spurious measurements may the detector report?",
            "Spurious measurements fall into the gates of features. An associator that pairs whatever is compatible "
            "pairs them too.",
            "spurious measurements per scan",
            (0.0, 3.0, 6.0, 12.0, 24.0),
            lambda clutter: _with_sensor(clutter=clutter),
        ),
        Experiment(
            "detection",
            "How many features may the detector miss?",
            "Fewer measurements of one scan support each other, while the features that were missed are still "
            "candidates for other measurements, spurious ones included.",
            "probability of detection; 3 spurious measurements per scan",
            (1.0, 0.85, 0.7, 0.5, 0.35),
            lambda detection: _with_sensor(clutter=3.0, detection=detection),
        ),
        Experiment(
            "density",
            "How close together may features be?",
            "Posts are at random in an empty room, closer at each level, and the sensor reaches a dozen of them: the "
            "errors of pose and sensor stay the same, while more and more neighbours fall into one gate.",
            "features per m²",
            (0.3, 1.0, 3.0, 8.0, 16.0),
            _posts,
            lambda density: (0.1, math.radians(1.0)),
        ),
        Experiment(
            "dynamics",
            "How many people may walk about?",
            "People hide features and are mistaken for features, at other places each time.",
            "people in the building",
            (0.0, 6.0, 12.0, 24.0, 40.0),
            lambda people: replace(_with_sensor(person_detection=0.9), dynamics=DynamicsSpec(people=int(people))),
        ),
        Experiment(
            "kidnapped",
            "Does a search without any prior find the robot in its map, and does it notice when it is in another "
            "building?",
            "Without a pose only relations between features can be compared. Spurious measurements reduce the fraction "
            "of informative ones, and make accidental hypotheses more likely.",
            "spurious measurements per scan",
            (0.0, 2.0, 4.0, 8.0, 16.0),
            lambda clutter: _with_sensor(clutter=clutter),
            lambda clutter: (0.0, 0.0),
        ),
    )
}
RELOCATION = "kidnapped"
"""The experiment for relocators; all others are for associators."""


def get_level(id: str) -> Level:
    """The frozen setting with an id such as `closure/3`. Raises ValueError, listing the known ids, for another."""
    name, slash, number = id.partition("/")
    one_of("experiment", name, EXPERIMENTS)
    levels = EXPERIMENTS[name].levels
    if not slash or not number.isdecimal() or int(number) >= len(levels):
        raise ValueError(f"setting {id!r}: expected {name}/0 … {name}/{len(levels) - 1}")
    return levels[int(number)]
