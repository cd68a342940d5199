"""The association suite: one question, one sweep and one number in [0, 1] per capability, in the manner of bsuite.

An experiment is a sweep over one knob. Each of its levels is a frozen setting with an id such as `closure/3`, to be
had from `get_level`; its `scenario` can be driven like any other, and goes by that id in `get_scenario`. What is done
with a level is up to `agents.suite`: maps are built by SLAM with true associations, and then every associator is asked
about the same scans.
"""

from __future__ import annotations

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
    """A frozen setting: the world and its sensor, and what the robot knows of its pose when it looks."""

    experiment: str
    number: int
    knob: float  # where the level lies on the experiment's axis
    scenario: Scenario
    blind: tuple[float, float]  # [m], [rad] σ of position and heading after driving on without a look

    @property
    def id(self) -> str:
        """`experiment/number`, as `get_level` takes it."""
        return f"{self.experiment}/{self.number}"

    @property
    def spacing(self) -> float:
        """[m] between the places from which the map is made."""
        return min(1.5, self.scenario.sensor.range / 4.0)


_FAIR = (0.08, math.radians(1.0))


@dataclass(frozen=True)
class Experiment:
    """A capability, the knob that strains it, and its levels from easy to hard."""

    name: str
    question: str
    why: str  # what turning the knob does to an association problem
    axis: str  # what the knob is, with its unit
    knobs: tuple[float, ...]
    scenario: Callable[[float], Scenario]  # by the knob
    blind: Callable[[float], tuple[float, float]] = lambda knob: _FAIR  # as `Level` has it, by the knob

    @cached_property
    def levels(self) -> tuple[Level, ...]:
        """From the first knob to the last."""
        return tuple(
            Level(self.name, number, knob, replace(self.scenario(knob), name=f"{self.name}/{number}"), self.blind(knob))
            for number, knob in enumerate(self.knobs)
        )


@dataclass(frozen=True)
class PostsGenerator:
    """A bare square room with a hundred posts anywhere in it, so thin that they hide nothing."""

    density: float  # [1/m²]

    def __call__(self, rng: np.random.Generator) -> FloorPlan:
        side = math.sqrt(_POSTS / self.density)
        corners = np.array([[0.0, 0.0], [side, 0.0], [side, side], [0.0, side]])
        positions, kinds = rng.uniform(0.0, side, (_POSTS, 2)), np.full(_POSTS, int(Kind.PILLAR))
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
    odometry=_ODOMETRY,  # so good that what the robot knows of its pose is decided by `Level.blind`
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


def _crowded(people: float) -> Scenario:
    return replace(_with_sensor(person_detection=0.9), dynamics=DynamicsSpec(people=int(people)))


EXPERIMENTS: dict[str, Experiment] = {
    experiment.name: experiment
    for experiment in (
        Experiment(
            "closure",
            "How lost may the robot be and still recognise what it sees?",
            "The gates grow with the uncertainty of the pose, so that each measurement has more compatible features; "
            "but all errors share one cause, the pose, and so the innovations of a right hypothesis agree with each "
            "other.",
            "σ of position before the look [m]; heading 12° per metre",
            (0.02, 0.1, 0.3, 0.6, 1.0),
            lambda sigma: _OFFICE,
            lambda sigma: (sigma, math.radians(12.0 * sigma)),
        ),
        Experiment(
            "drift",
            "How far may one tick turn the robot away from where it believes to look?",
            "At six metres a degree is ten centimetres. All measurements are turned together, further than the "
            "linearised gates of each foresee: 3°, 5° and 8° are what the wheels of `drift-1` to `drift-3` lose in a "
            "tick's turn.",
            "σ of heading before the look [°]; position 0.1 m",
            (1.0, 3.0, 5.0, 8.0, 12.0),
            lambda sigma: _with_sensor(detection=0.9, clutter=1.0),
            lambda sigma: (0.1, math.radians(sigma)),
        ),
        Experiment(
            "aliasing",
            "Are identical rooms told apart, when the pose does not quite say which one it is?",
            "Rooms repeat at the pitch. A hypothesis that is off by a room pairs as many measurements as the right "
            "one and is consistent in itself: only the prior on the pose, and what is at the ends of the corridor, "
            "speak against it.",
            "pitch of identical rooms [m]; σ of position 0.8 m",
            (6.0, 4.5, 3.5, 2.8, 2.2),
            _rooms_at_pitch,
            lambda pitch: (0.8, math.radians(3.0)),
        ),
        Experiment(
            "clutter",
            "How much that is not there may the detector report?",
            "Spurious measurements fall among the gates. An associator that pairs whatever is compatible pairs them "
            "too.",
            "spurious measurements a scan",
            (0.0, 3.0, 6.0, 12.0, 24.0),
            lambda clutter: _with_sensor(clutter=clutter),
        ),
        Experiment(
            "detection",
            "How much of what is there may the detector miss?",
            "Fewer measurements of one scan support each other, while the features that were missed still offer "
            "themselves to those that are there, spurious ones among them.",
            "probability of detection; 3 spurious measurements a scan",
            (1.0, 0.85, 0.7, 0.5, 0.35),
            lambda detection: _with_sensor(clutter=3.0, detection=detection),
        ),
        Experiment(
            "density",
            "How close together may features stand?",
            "Posts at random in a bare room, ever closer, and a sensor that reaches a dozen of them: what the pose "
            "and the sensor are off by stays the same, and more and more neighbours fall into one gate.",
            "features per m²",
            (0.3, 1.0, 3.0, 8.0, 16.0),
            _posts,
            lambda density: (0.1, math.radians(1.0)),
        ),
        Experiment(
            "dynamics",
            "How many people may walk about?",
            "People hide features and are taken for some, in other places each time.",
            "people in the building",
            (0.0, 6.0, 12.0, 24.0, 40.0),
            _crowded,
        ),
        Experiment(
            "kidnapped",
            "Does a search without any prior find the robot in its map, and does it notice when it is in another "
            "building?",
            "Without a pose only what features are to each other can be compared. Spurious measurements thin out what "
            "a scan says, and let a hypothesis arise by chance.",
            "spurious measurements a scan",
            (0.0, 2.0, 4.0, 8.0, 16.0),
            lambda clutter: _with_sensor(clutter=clutter),
            lambda clutter: (0.0, 0.0),
        ),
    )
}
RELOCATION = "kidnapped"
"""The experiment that asks relocators; all others ask associators."""


def get_level(id: str) -> Level:
    """The frozen setting behind an id such as `closure/3`. Raises ValueError that lists what there is."""
    name, slash, number = id.partition("/")
    one_of("experiment", name, EXPERIMENTS)
    levels = EXPERIMENTS[name].levels
    if not slash or not number.isdecimal() or int(number) >= len(levels):
        raise ValueError(f"setting {id!r}: expected {name}/0 … {name}/{len(levels) - 1}")
    return levels[int(number)]
