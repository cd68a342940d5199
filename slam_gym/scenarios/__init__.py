"""Named, frozen configurations: simulated worlds with their seeds, and settings for recordings."""

from slam_gym.scenarios.registry import SCENARIOS, from_floor_plan, get_scenario, register
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
    "SCENARIOS",
    "SPLITS",
    "KidnappingSpec",
    "Scenario",
    "from_floor_plan",
    "get_scenario",
    "overridden",
    "parse_override",
    "register",
    "world_generator",
    "world_seed",
]
