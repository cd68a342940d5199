"""What is driven in the soak: an environment, a scenario, and settings that no robot should have."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import gymnasium as gym
import numpy as np

from slam_gym.association import ASSOCIATORS, RELOCATORS
from slam_gym.envs.associate import AssociateEnv
from slam_gym.envs.base import BaseEnv
from slam_gym.envs.explore import ExploreEnv
from slam_gym.envs.relocate import RelocateEnv
from slam_gym.scenarios import SCENARIOS, Scenario, get_scenario
from slam_gym.world.generators import OfficeGenerator

TIMES = 20.0  # the noise of "noise × 20"


def noisy(scenario: Scenario) -> Scenario:
    """Wheels and sensor twenty times as bad."""
    sensor, odometry = scenario.sensor, scenario.odometry
    names = ("forward", "lateral", "turn_per_radian", "turn_per_metre")
    wheels = {name: TIMES * getattr(odometry, name) for name in names}
    return replace(
        scenario,
        odometry=replace(odometry, **wheels),
        sensor=replace(
            sensor, range_sigma=TIMES * sensor.range_sigma, bearing_sigma=min(TIMES * sensor.bearing_sigma, 0.5)
        ),
    )


def noiseless(scenario: Scenario) -> Scenario:
    """As little noise as the settings admit: a millimetre's thousandth."""
    sensor = replace(scenario.sensor, range_sigma=1e-6, range_sigma_ratio=0.0, bearing_sigma=1e-6, size_sigma=1e-6)
    wheels = replace(
        scenario.odometry, forward=0.0, lateral=0.0, turn_per_radian=0.0, turn_per_metre=0.0, floor=1e-7,
        slip_floor=0.0, slip_forward=0.0, slip_lateral=0.0, slip_turn=0.0,
    )  # fmt: skip
    return replace(scenario, sensor=replace(sensor, detection=1.0, clutter=0.0), odometry=wheels)


def _cluttered(scenario: Scenario) -> Scenario:
    return replace(scenario, sensor=replace(scenario.sensor, clutter=10.0))


def _blind(scenario: Scenario) -> Scenario:
    return replace(scenario, sensor=replace(scenario.sensor, detection=0.1))


def _crowded(scenario: Scenario) -> Scenario:
    return replace(scenario, dynamics=replace(scenario.dynamics, people=30))


def _large(scenario: Scenario) -> Scenario:
    """A corridor of 200 m with some eighty rooms."""
    return replace(scenario, generator=OfficeGenerator(rooms=80))


EXTREMES: dict[str, Callable[[Scenario], Scenario]] = {
    "as it is": lambda scenario: scenario,
    "noise x 20": noisy,
    "clutter 10": _cluttered,
    "detection .1": _blind,
    "30 people": _crowded,
    "floor of 200 m": _large,
    "no noise": noiseless,
    "all at once": lambda scenario: noisy(_crowded(_cluttered(_blind(scenario)))),
}


@dataclass(frozen=True)
class Case:
    """One episode of the soak."""

    number: int
    env: str  # Explore, Associate or Relocate
    scenario: str
    extreme: str  # of EXTREMES
    ticks: int  # the episode's budget
    options: dict[str, Any]  # further arguments of the environment

    def make(self) -> BaseEnv:
        """The environment, without the wrappers of `gym.make`."""
        scenario = replace(EXTREMES[self.extreme](get_scenario(self.scenario)), budget=self.ticks)
        made: gym.Env[Any, Any] = _CLASSES[self.env](scenario=scenario, **self.options)
        assert isinstance(made, BaseEnv)
        return made

    def __str__(self) -> str:
        options = ", ".join(f"{name}={value}" for name, value in self.options.items())
        return f"case {self.number}: {self.env}, {self.scenario}, {self.extreme}, {self.ticks} ticks, {options}"


_CLASSES: dict[str, Callable[..., Any]] = {
    "Explore": ExploreEnv,
    "Associate": AssociateEnv,
    "Relocate": RelocateEnv,
}
# Robots that are lost, and agents that decide every pairing, take ten to a hundred times as long for a tick: their
# episodes are shorter, so that all kinds of cases share the time of a soak, and none the number of its episodes.
SHARES = {"noise x 20": 0.1, "clutter 10": 0.2, "all at once": 0.1, "floor of 200 m": 0.5}
_DECIDED = 0.25  # the same for Associate, where a tick is some ten decisions
_LEAST = 20  # [ticks]
_ROTA = ("Explore",) * 7 + ("Associate",) * 2 + ("Relocate",)
_MAPPING = 150  # [ticks] at most for the map of Relocate, which is made before the first step


def case(number: int, seed: int, ticks: int) -> Case:
    """The `number`-th case of a soak; scenarios and extremes go round, the rest is drawn.

    Args:
        number: which, from 0
        seed: of the soak
        ticks: of the longest episodes; half of that to all of it is drawn, times the share of what is driven
    """
    rng = np.random.default_rng((seed, number))
    env = _ROTA[number % len(_ROTA)]
    scenario = list(SCENARIOS)[number % len(SCENARIOS)]
    extreme = list(EXTREMES)[(number // len(_ROTA) + number) % len(EXTREMES)]
    share = SHARES.get(extreme, 1.0) * (_DECIDED if env == "Associate" else 1.0)
    budget = max(int(share * rng.integers(ticks // 2, ticks + 1)), min(ticks, _LEAST))
    if env == "Relocate":
        budget = min(budget, _MAPPING)
    return Case(number, env, scenario, extreme, budget, _OPTIONS[env](rng))


def _any(rng: np.random.Generator, *values: Any) -> Any:
    return values[int(rng.integers(len(values)))]


def _explore(rng: np.random.Generator) -> dict[str, Any]:
    relocation = _any(rng, None, *RELOCATORS)
    return {
        "action": _any(rng, "goal", "twist"),
        "associator": _any(rng, *ASSOCIATORS),
        "reward": _any(rng, "map_error", "a_opt", "d_opt", "entropy"),
        "locality": _any(rng, None, "covisibility"),
        "relocation": relocation,
        "atlas": relocation is not None and bool(rng.integers(2)),
    }


def _associate(rng: np.random.Generator) -> dict[str, Any]:
    return {
        "reward": _any(rng, "truth", "map_error"),
        "candidates": int(rng.integers(1, 9)),
        "compatibility": _any(rng, "joint", "individual"),
        "order": _any(rng, "as_scanned", "nearest_first", "fewest_candidates"),
        "driver": _any(rng, "nearest_frontier", "random"),
    }


def _relocate(rng: np.random.Generator) -> dict[str, Any]:
    return {
        "locality": _any(rng, None, "covisibility", "two-hop covisibility", "distance"),
        "outside": _any(rng, 0.0, 0.5, 1.0),
        "node_limit": int(rng.integers(1, 400)),
        "associator": _any(rng, "jcbb", "marginal", "nearest_neighbour"),
    }


_OPTIONS = {"Explore": _explore, "Associate": _associate, "Relocate": _relocate}
