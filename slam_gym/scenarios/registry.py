"""The scenarios of the package by name, and those that users add."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from slam_gym.scenarios.buildings import BUILDINGS, floor_budget
from slam_gym.scenarios.drift import CROWDED, DRIFTING
from slam_gym.scenarios.scenario import KidnappingSpec, Scenario
from slam_gym.scenarios.suite import EXPERIMENTS, get_level
from slam_gym.validation import imported
from slam_gym.world.floor_plan import FloorPlan
from slam_gym.world.floor_plan_file import load_floor_plan
from slam_gym.world.generators import AliasedGenerator, HallGenerator, OfficeGenerator
from slam_gym.world.sensor import OdometrySpec, SensorSpec

SCENARIOS: dict[str, Scenario] = {
    scenario.name: scenario
    for scenario in (
        Scenario("office-small", OfficeGenerator(rooms=4), budget=300),
        Scenario("office", OfficeGenerator(), budget=800),
        Scenario("aliased", AliasedGenerator(), budget=800),
        Scenario(
            "hall",  # long views, and a robot whose noise makes drift count
            HallGenerator(),
            budget=600,
            sensor=SensorSpec(range_sigma=0.04, bearing_sigma=0.015),
            odometry=OdometrySpec(forward=0.05, turn_per_radian=0.05, turn_per_metre=0.05),
        ),
        Scenario("crowd", OfficeGenerator(), budget=800, **CROWDED),
        Scenario(
            "kidnapped",  # carried away at half time, to where it has been
            OfficeGenerator(),
            budget=800,
            kidnapping=KidnappingSpec(),
        ),
        *DRIFTING,
        *BUILDINGS,
    )
}
"""The scenarios with a name of their own; the levels of the suite (`slam_gym.scenarios.suite`) go by their ids."""


def get_scenario(name: str) -> Scenario:
    """The scenario of that name, of a level of the suite such as `closure/3`, or of `"module:name"`.

    A module is imported: it registers a scenario by that name, or holds it in a variable so called. Raises ValueError,
    listing the known names, where there is none.
    """
    if name in SCENARIOS:
        return SCENARIOS[name]
    if name.partition("/")[0] in EXPERIMENTS and "/" in name:
        return get_level(name).scenario
    levels = ", ".join(f"{experiment}/…" for experiment in EXPERIMENTS)
    found = imported("scenario", name, SCENARIOS, f"; levels of the suite: {levels}")
    if not isinstance(found, Scenario):
        raise ValueError(f"scenario {name!r} is of type {type(found).__name__}, not a Scenario")
    return found


def register(scenario: Scenario) -> None:
    """Make a scenario known by its name, in this process, to `get_scenario` and the environments.

    Raises ValueError where another scenario goes by that name, or the name could be that of a level of the suite.
    """
    if SCENARIOS.get(scenario.name, scenario) != scenario:
        raise ValueError(f"there is another scenario {scenario.name!r} already")
    if not scenario.name or "/" in scenario.name:
        raise ValueError(f"scenario name {scenario.name!r}: is empty or has a slash, as only levels of the suite have")
    SCENARIOS[scenario.name] = scenario


def from_floor_plan(path: str | Path, resolution: float | None = None, like: Scenario | None = None) -> Scenario:
    """A scenario on a floor plan file: the package's JSON, or an occupancy image with its `resolution` [m per pixel].

    Robot, people, sensors and filter are those of `like` (default: building). The plan is read once, here; faults in
    the file are reported by `load_floor_plan`. Seeds vary the start and the noise. The budget grows with the area that
    the robot can reach (see `slam_gym.scenarios.buildings.floor_budget`).
    """
    plan, like = load_floor_plan(path, resolution), like or SCENARIOS["building"]
    return replace(like, name=plan.name, generator=partial(_given, plan), budget=floor_budget(plan, like))


def _given(plan: FloorPlan, _rng: np.random.Generator) -> FloorPlan:
    return plan
