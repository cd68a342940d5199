"""Named, frozen configurations: simulated worlds with their seeds, and settings for recordings."""

from slam_gym.scenarios.overrides import overridden, parse_override
from slam_gym.scenarios.registry import SCENARIOS, from_floor_plan, get_scenario, register
from slam_gym.scenarios.scenario import SPLITS, KidnappingSpec, Scenario, world_generator, world_seed

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
