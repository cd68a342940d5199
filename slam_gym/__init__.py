"""slam_gym: learn and evaluate data association in SLAM, and active exploration on top of it.

Importing the package registers its environments with Gymnasium. The names in `__all__` are imported on first use, so
that `import slam_gym` itself stays quick.
"""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import TYPE_CHECKING, Any

import gymnasium as _gymnasium

if TYPE_CHECKING:
    from slam_gym.association import (
        ASSOCIATORS,
        RELOCATORS,
        from_policy,
        gcbb,
        global_nearest_neighbour,
        indexed,
        ipjc,
        jcbb,
        learned_associator,
        map_hypothesis,
        marginal,
        max_clique,
        nearest_neighbour,
        one_point_ransac,
        random_sampling,
        relocator_from_policy,
        singles,
        true_association,
    )
    from slam_gym.association.prediction import Prediction
    from slam_gym.mapping.smoothing import Smoothed, smooth
    from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
    from slam_gym.recordings import open_recordings
    from slam_gym.recordings.recording import Recording, write_tum
    from slam_gym.scenarios import LOG_SETTINGS, SCENARIOS, Scenario, from_floor_plan, get_scenario, register, slam_for
    from slam_gym.slam.atlas import AtlasSpec
    from slam_gym.slam.local_maps import LocalMapSlam
    from slam_gym.slam.relocate import relocate_by
    from slam_gym.slam.slam import Slam, SlamSpec
    from slam_gym.types import UNKNOWN_KIND, UNPAIRED, Hypothesis, Landmarks, Locality, Odometry, Relocation, Scan
    from slam_gym.world.floor_plan import FloorPlan

__version__ = "0.2.0"

_MODULES = (
    "types", "association", "association.prediction",
    "mapping.stochastic_map", "mapping.smoothing", "slam.slam", "slam.local_maps", "slam.atlas", "slam.relocate",
    "scenarios", "recordings", "world.floor_plan",
)  # fmt: skip
"""Modules that are searched for a public name, in this order."""

__all__ = [
    "ASSOCIATORS",
    "LOG_SETTINGS",
    "RELOCATORS",
    "SCENARIOS",
    "UNKNOWN_KIND",
    "UNPAIRED",
    "AtlasSpec",
    "FloorPlan",
    "Hypothesis",
    "Landmarks",
    "LocalMapSlam",
    "Locality",
    "MapSpec",
    "Odometry",
    "Prediction",
    "Recording",
    "Relocation",
    "Scan",
    "Scenario",
    "Slam",
    "SlamSpec",
    "Smoothed",
    "StochasticMap",
    "from_floor_plan",
    "from_policy",
    "gcbb",
    "get_scenario",
    "global_nearest_neighbour",
    "indexed",
    "ipjc",
    "jcbb",
    "learned_associator",
    "map_hypothesis",
    "marginal",
    "max_clique",
    "nearest_neighbour",
    "one_point_ransac",
    "open_recordings",
    "random_sampling",
    "register",
    "relocate_by",
    "relocator_from_policy",
    "singles",
    "slam_for",
    "smooth",
    "true_association",
    "write_tum",
]


def __getattr__(name: str) -> Any:
    """Import a name of `__all__` on first use."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(_home(name), name)
    globals()[name] = value
    return value


def _home(name: str) -> ModuleType:
    """The module that defines a public name."""
    modules = (importlib.import_module(f"slam_gym.{module}") for module in _MODULES)
    return next(module for module in modules if hasattr(module, name))


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


for _environment in ("Explore", "Associate", "Relocate"):
    _gymnasium.register(
        id=f"slam_gym/{_environment}-v0",
        entry_point=f"slam_gym.envs.{_environment.lower()}:{_environment}Env",
        vector_entry_point=f"slam_gym.envs.vector:{_environment}Worlds",
    )
