"""The environments made small, random episodes, single and vectorised, and a comparison of what they hand out."""

import copy
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np

import slam_gym  # noqa: F401 (registers the environments)
from slam_gym.envs.associate import AssociateEnv
from slam_gym.envs.explore import ExploreEnv
from slam_gym.envs.relocate import RelocateEnv
from slam_gym.scenarios import Scenario, get_scenario

SCENARIOS = ("office-small", "office", "aliased", "hall", "crowd")
Step = tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]
Choice = Callable[[Any, dict[str, np.ndarray], dict[str, Any]], Any]  # environment, observation and info to an action


def bare(name: str, **options: Any) -> Any:
    """The environment `slam_gym/<name>` without the wrappers of `gym.make`."""
    return gym.make(f"slam_gym/{name}", disable_env_checker=True, **options).unwrapped


def explore(scenario: str | Scenario = "office-small", **options: Any) -> ExploreEnv:
    env: ExploreEnv = bare("Explore-v0", scenario=scenario, **options)
    return env


def associate(scenario: Any = "office-small", **options: Any) -> AssociateEnv:
    env: AssociateEnv = bare("Associate-v0", scenario=scenario, **options)
    return env


def relocate(scenario: str | Scenario | None = None, **options: Any) -> RelocateEnv:
    """In maps that are made in 120 ticks, unless the scenario says otherwise."""
    env: RelocateEnv = bare("Relocate-v0", scenario=scenario or short(120), **options)
    return env


def short(budget: int, name: str = "office-small", **changes: Any) -> Scenario:
    """A scenario whose episodes end early."""
    return replace(get_scenario(name), budget=budget, **changes)


def in_any_process(name: str, **options: Any) -> gym.Env:
    """An environment for vector environments, under the id that imports its own module in a fresh process."""
    return gym.make(f"slam_gym:slam_gym/{name}", **options)


def random_action(env: gym.Env, info: dict[str, Any], rng: np.random.Generator) -> Any:
    """A legal action, or a twist that leans forward, so that the robot gets somewhere."""
    if "action_mask" in info:
        return int(rng.choice(np.flatnonzero(info["action_mask"])))
    return np.clip(rng.normal([0.5, 0.0], [0.6, 0.5]), -1.0, 1.0).astype(np.float32)


def at_random(seed: int | None) -> Choice:
    """Random actions, the same for the same seed."""
    rng = np.random.default_rng(seed)
    return lambda env, observation, info: random_action(env, info, rng)


def episode(
    env: gym.Env,
    steps: int = 10**6,
    seed: int | None = 0,
    options: dict[str, Any] | None = None,
    choose: Choice | None = None,
) -> Iterator[Step]:
    """What reset (with reward 0) and then at most `steps` steps hand out, with actions that are chosen at random or by
    `choose`. Same arguments, same actions."""
    choose = choose or at_random(seed)
    observation, info = env.reset(seed=seed, options=options)
    yield observation, 0.0, False, False, info
    terminated = False
    while steps > 0 and not terminated:
        step = env.step(choose(env, observation, info))
        yield step
        steps, (observation, _, terminated, _, info) = steps - 1, step


def vector_rollout(envs: gym.vector.VectorEnv, steps: int) -> list:
    """Everything that `steps` handed out, with the environments' own autoresets in between; and the actions."""
    rng = np.random.default_rng(0)
    observations, infos = envs.reset(seed=[7, 11])
    record = [(copy.deepcopy(observations), infos)]
    for _ in range(steps):
        masks = [{"action_mask": mask} for mask in infos.get("action_mask", ())] or [{}, {}]
        actions = np.array([random_action(envs, mask, rng) for mask in masks])
        observations, *rest, infos = envs.step(actions)
        record.append((copy.deepcopy(observations), *rest, dict(sorted(infos.items())), actions))
    envs.close()
    return record


def differences(a: Any, b: Any, at: str = "") -> list[str]:
    """Places where two nested values differ, in type, shape or a single bit (NaN equals NaN)."""
    if isinstance(a, dict) and isinstance(b, dict):
        if list(a) != list(b):
            return [f"{at}: keys {list(a)} and {list(b)}"]
        return [place for key in a for place in differences(a[key], b[key], f"{at}.{key}")]
    if isinstance(a, (list, tuple)) and type(a) is type(b):
        if len(a) != len(b):
            return [f"{at}: lengths {len(a)} and {len(b)}"]
        return [place for i, pair in enumerate(zip(a, b)) for place in differences(*pair, f"{at}[{i}]")]
    same = type(a) is type(b) and np.array_equal(a, b, equal_nan=np.asarray(a).dtype.kind == "f")
    return [] if same and getattr(a, "dtype", None) == getattr(b, "dtype", None) else [f"{at}: {a!r} and {b!r}"]
