"""Named, frozen configurations: simulated worlds with their seeds, and the settings of recordings."""

from slam_gym.scenarios.simulated import (
    SCENARIOS,
    SPLITS,
    KidnappingSpec,
    Scenario,
    from_floor_plan,
    get_scenario,
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
    "world_generator",
    "world_seed",
]
