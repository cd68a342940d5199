"""Named, frozen configurations: simulated worlds with their seeds, and settings for recordings."""

from slam_gym.scenarios.registry import LOG_SETTINGS, SCENARIOS, from_floor_plan, get_scenario, register, slam_for
from slam_gym.scenarios.scenario import (
    SPLITS,
    KidnappingSpec,
    Scenario,
    overridden,
    parse_override,
    world_generator,
    world_seed,
)

__all__ = [
    "LOG_SETTINGS",
    "SCENARIOS",
    "SPLITS",
    "KidnappingSpec",
    "Scenario",
    "from_floor_plan",
    "get_scenario",
    "overridden",
    "parse_override",
    "register",
    "slam_for",
    "world_generator",
    "world_seed",
]
