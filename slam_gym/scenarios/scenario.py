"""A scenario: a generator of worlds, a robot with its sensors and filter, and a budget; and the seeds of its worlds.

Overrides change the fields of a scenario by dotted names and plain values, from a command line or a JSON file.
"""

import json
import math
import reprlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, is_dataclass, replace
from types import NoneType
from typing import Any, cast

import numpy as np

from slam_gym.mapping.stochastic_map import MapSpec
from slam_gym.slam.slam import SlamSpec
from slam_gym.validation import Checked, known_names, one_of, types_of
from slam_gym.world.floor_plan import FloorPlan
from slam_gym.world.physics import DynamicsSpec, RobotSpec
from slam_gym.world.sensor import BeamSpec, OdometrySpec, SensorSpec

SPLITS = {"train": (0, 1_000_000), "test": (1_000_000, 10_000)}
"""First world seed and number of worlds of each split."""

Plain = bool | int | float | str | None
"""The values that an override may have: those of JSON without lists and objects."""

_PLAIN = (bool, int, float, str)


@dataclass(frozen=True)
class KidnappingSpec(Checked):
    """The robot is carried elsewhere, and neither its odometry nor any other measurement shows it."""

    at: float = 0.5  # fraction of the budget after which it happens
    inside: bool = True  # to a place where it has been; False: to the place farthest from all where it has been
    distance: float = 5.0  # [m] least distance from its last place, if possible; for `inside`


@dataclass(frozen=True)
class Scenario(Checked):
    """Everything that defines an episode, except its seed."""

    name: str
    generator: Callable[[np.random.Generator], FloorPlan]
    budget: int  # [ticks] length of an episode
    robot: RobotSpec = field(default_factory=RobotSpec)
    dynamics: DynamicsSpec = field(default_factory=DynamicsSpec)
    sensor: SensorSpec = field(default_factory=SensorSpec)
    beams: BeamSpec = field(default_factory=BeamSpec)
    odometry: OdometrySpec = field(default_factory=OdometrySpec)
    slam: SlamSpec = field(default_factory=lambda: SlamSpec(MapSpec(unconfirmed_age=5), new_confidence=1.0 - 1e-6))
    associator: str = "jcbb"  # default associator
    prior_sigma: float = 0.5  # [m] σ₀: the error of a feature that has not been mapped
    grid_resolution: float = 0.2  # [m] side of a cell of the explored grid
    wall_compass: bool = False  # whether straight walls in view correct odometry; overconfident below some 90 beams
    kidnapping: KidnappingSpec | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        substep = self.robot.max_speed * self.dynamics.tick / self.dynamics.substeps
        if substep > self.robot.radius:
            what = f"in one substep a robot of radius {self.robot.radius:g} m moves by up to {substep:g} m"
            raise ValueError(f"dynamics.substeps={self.dynamics.substeps}: {what}, and could pass through walls")


def world_seed(split: str, index: int) -> int:
    """The seed of world `index` of a split. Raises ValueError for an unknown split or an index outside it."""
    one_of("split", split, SPLITS)
    first, count = SPLITS[split]
    whole = isinstance(index, int | np.integer) and not isinstance(index, bool)
    if not (whole and 0 <= index < count):
        raise ValueError(f"world {index!r} of split {split!r}: expected a whole number 0 … {count - 1}")
    return first + int(index)


def world_generator(split: str, index: int) -> np.random.Generator:
    """The random generator for the plan of a world, independent of `reset(seed=…)`. Raises as `world_seed`."""
    return np.random.default_rng((world_seed(split, index), 1))


def overridden(scenario: Scenario, overrides: Mapping[str, Plain]) -> Scenario:
    """The scenario with some fields changed, e.g. `{"sensor.range": 4.0, "dynamics.people": 3, "generator.rooms": 4}`.

    A name leads through the fields of dataclasses to a bool, a number or a string. `None` is allowed for fields that
    may be None. Where a dataclass is None, as `kidnapping` is in most scenarios, a name such as `kidnapping.at` changes
    its defaults. All changes of one dataclass are made at once, so their order does not matter.

    Raises ValueError, naming the override, for an unknown field (it lists the known ones), for a value of the wrong
    type or a number that is not finite, and for values that the dataclasses themselves reject.
    """
    overrides = {name: value.item() if isinstance(value, np.generic) else value for name, value in overrides.items()}
    for name, value in overrides.items():
        if not isinstance(name, str):
            raise ValueError(f"override {reprlib.repr(name)}: expected the name of a field")
        if not (value is None or isinstance(value, _PLAIN)):
            found = reprlib.repr(value)
            raise ValueError(f"override {name!r}: expected a bool, a number, a string or None, got {found}")
    changed: Scenario = _changed(scenario, overrides, "")
    return changed


def parse_override(text: str) -> tuple[str, Plain]:
    """Parse the NAME=VALUE of `--set`: `true`, `false`, `null` and numbers as in JSON; other values are strings.

    Raises ValueError for a text of another form.
    """
    name, equals, value = text.partition("=")
    if not (name.strip() and equals):
        raise ValueError(f"{text!r}: expected NAME=VALUE, such as sensor.range=4")
    try:
        parsed = json.loads(value)
    except (ValueError, RecursionError):  # RecursionError: thousands of brackets
        return name.strip(), value
    return name.strip(), parsed if parsed is None or isinstance(parsed, _PLAIN) else value


def _changed(record: Any, overrides: Mapping[str, Plain], prefix: str) -> Any:
    """The dataclass `record`, whose dotted name is `prefix`, with the fields changed that `overrides` name."""
    types = types_of(cast(Any, type(record)))
    parts = {name: _part(getattr(record, name), types[name]) for name in types}
    known = [name for name in types if parts[name] is not None or any(kind in _PLAIN for kind in types[name])]
    below: dict[str, dict[str, Plain]] = {}  # overrides within each field; "" stands for the field itself
    for name, value in overrides.items():
        first, _, rest = name.partition(".")
        below.setdefault(first, {})[rest] = value
    values: dict[str, Any] = {}
    for name, inner in below.items():
        if name not in known:
            where = f" in {prefix[:-1]!r}" if prefix else ""
            raise ValueError(f"override {prefix + name!r}: there is no such field{where}; {known_names(name, known)}")
        if "" in inner and len(inner) > 1:
            raise ValueError(f"override {prefix + name!r}: is given a value and fields")
        if "" in inner:
            values[name] = _checked(prefix + name, inner[""], types[name])
        elif parts[name] is None:
            raise ValueError(f"override {prefix + name!r}: has no fields")
        else:
            values[name] = _changed(parts[name], inner, f"{prefix}{name}.")
    try:
        return replace(record, **values)
    except ValueError as error:
        names = ", ".join(prefix + name for name in values)
        raise ValueError(f"override of {names}: {error}") from None


def _part(value: Any, types: tuple[Any, ...]) -> Any:
    """The dataclass in a field: its value, or the defaults of a dataclass among its `types`; None where it has none."""
    kinds = (kind for kind in types if isinstance(kind, type) and is_dataclass(kind))
    return value if is_dataclass(value) else next((kind() for kind in kinds), None)


def _checked(name: str, value: Plain, types: tuple[Any, ...]) -> Plain:
    """The value as one of the `types`; an integer is accepted for a float. Raises ValueError for others."""
    if value is None and NoneType in types:
        return None
    whole = type(value) is int and abs(value) < 1 << 63  # larger ones do not fit into arrays
    for kind in (bool, float, int, str):
        fits = whole if kind is int else isinstance(value, kind) or (whole and kind is float)
        if kind in types and fits and (kind is not float or math.isfinite(value)):  # type: ignore[arg-type]
            return kind(value)  # type: ignore[arg-type]
    words = {bool: "true or false", int: "a whole number", float: "a finite number", str: "a string", NoneType: "None"}
    wanted = [words[kind] for kind in types if kind in words]
    if not words.keys() >= set(types):
        wanted.append(f"the name of a field in it, {name}.…")
    raise ValueError(f"override {name!r}: expected {' or '.join(wanted)}, got {reprlib.repr(value)}")
