"""A million ticks of all environments, with extreme settings: checks that nothing breaks and that memory does not grow.

Episodes of Explore, Associate and Relocate go through all scenarios and eight kinds of settings, with associators,
relocation, rewards and localities drawn at random, or with --associator through one kind of settings with it;
docs/reliability.md lists settings and checks. Episode N depends only on the seed and N: `--first N --ticks 1` repeats
it. Steps that compile or load a loop are not timed. The exit status is 1 if anything broke.

    python benchmarks/long_run.py --ticks 1000000                        # an hour and a half
    python benchmarks/long_run.py --ticks 100000 --associator learned
"""

import gc
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks.common import options, resident, timed
from slam_gym import ASSOCIATORS, RELOCATORS, SCENARIOS, Scenario
from slam_gym._jit import ready
from slam_gym.scenarios import overridden
from slam_gym.world.generators import OfficeGenerator

ODOMETRY = [f"odometry.{name}" for name in ("forward", "lateral", "turn_per_radian", "turn_per_metre")]
NOISY = dict.fromkeys(ODOMETRY, 0.5) | {"sensor.range_sigma": 0.6, "sensor.bearing_sigma": 0.2}
QUIET = dict.fromkeys(ODOMETRY, 0.0)
QUIET |= {"odometry.floor": 1e-7, "sensor.range_sigma_ratio": 0.0, "sensor.detection": 1.0, "sensor.clutter": 0.0}
QUIET |= {f"sensor.{name}": 1e-6 for name in ("range_sigma", "bearing_sigma", "size_sigma")}
BUSY = {"sensor.clutter": 10.0, "sensor.detection": 0.1, "dynamics.people": 30}
EXTREMES: dict[str, dict[str, Any]] = {
    "as it is": {},
    "noise × 20": NOISY,
    "clutter": {"sensor.clutter": 10.0},
    "blind": {"sensor.detection": 0.1},
    "crowd": {"dynamics.people": 30},
    "200 m": {},
    "no noise": QUIET,
    "all at once": NOISY | BUSY,
}
SOAK = NOISY | {"sensor.clutter": 10.0, "dynamics.people": 30}
SHORTER = {"noise × 20": 0.1, "clutter": 0.2, "all at once": 0.1, "soak": 0.1}  # a lost robot takes ten times as long
ARGUMENTS: dict[str, dict[str, tuple[Any, ...]]] = {
    "Explore": {
        "action": ("goal", "twist"),
        "associator": tuple(ASSOCIATORS),
        "reward": ("map_error", "a_opt", "d_opt", "entropy"),
        "locality": (None, "covisibility"),
        "relocation": tuple(RELOCATORS),
        "atlas": (True, False),
    },
    "Associate": {"reward": ("truth", "map_error"), "compatibility": ("joint", "individual")},
    "Relocate": {"locality": (None, "covisibility", "distance"), "outside": (0.0, 0.5, 1.0)},
}
LONGEST = {"Explore": math.inf, "Associate": 300, "Relocate": 150}  # [ticks]
KINDS = ("Explore",) * 7 + ("Associate",) * 2 + ("Relocate",)
MIN_EPISODES = 100  # least number for a judgement on memory, since code is loaded at first
GROWTH = 0.05  # of memory from the second to the last fifth of the episodes; more is a leak
LONGEST_TICK = 1.0  # [s] CPU time, with --associator


def episode(number: int, seed: int, ticks: int, associator: str = "") -> tuple[str, gym.Env[Any, Any]]:
    """A description of episode `number`, and its environment; scenarios and extremes take turns, the rest is random.

    With an `associator`, all episodes explore with it and have the settings `SOAK`.
    """
    rng = np.random.default_rng((seed, number))
    kind, name = KINDS[number % len(KINDS)], list(SCENARIOS)[number % len(SCENARIOS)]
    extreme = list(EXTREMES)[(number // len(KINDS) + number) % len(EXTREMES)]
    if associator:
        kind, extreme = "Explore", "soak"
    budget = min(max(int(ticks * SHORTER.get(extreme, 1.0)), 20), LONGEST[kind])
    scenario: Scenario = overridden(SCENARIOS[name], (EXTREMES | {"soak": SOAK})[extreme] | {"budget": budget})
    if extreme == "200 m":
        scenario = replace(scenario, generator=OfficeGenerator(rooms=80))
    arguments = {name: values[int(rng.integers(len(values)))] for name, values in ARGUMENTS[kind].items()}
    arguments |= {"associator": associator} if associator else {}
    env = gym.make(f"slam_gym/{kind}-v0", disable_env_checker=True, scenario=scenario, **arguments).unwrapped
    return f"episode {number}: {kind}, {name}, {extreme}, {arguments}", env


def checked(env: Any, seed: int) -> Iterator[tuple[int, float]]:
    """Play an episode at random; yields the ticks of each step, and its CPU time [s]. Raises AssertionError where a
    check fails."""
    rng, total = np.random.default_rng(seed), 0.0
    observation, info = env.reset(seed=seed)
    first, over = info.get("map_error"), False
    while not over:
        if "action_mask" in info:
            assert info["action_mask"].any(), "no action is legal"
            action = int(rng.choice(np.flatnonzero(info["action_mask"])))
        else:
            action = np.clip(rng.normal([0.5, 0.0], [0.6, 0.5]), -1.0, 1.0).astype(np.float32)
        (observation, reward, over, _, info), microseconds = timed(env.step, action)
        assert env.observation_space.contains(observation), "an observation is outside of its space"
        assert math.isfinite(reward), f"the reward is {reward}"
        total += reward
        yield int(info.get("ticks", 1)), 1e-6 * microseconds
    explored = getattr(env, "episode", None)
    if explored is not None:
        check_covariance(explored.slam.map.covariance)
    if explored is not None and env.arguments.reward == "map_error":
        assert abs(total - (first - info["map_error"])) < 1e-6, "rewards do not sum to the fall of the error"


def check_covariance(covariance: np.ndarray) -> None:
    """Raise AssertionError unless `covariance` is finite, symmetric and positive semi-definite, but for rounding."""
    assert np.isfinite(covariance).all(), "the covariance is not finite"
    assert np.allclose(covariance, covariance.T, rtol=1e-9, atol=0.0), "the covariance is not symmetric"
    assert (np.diag(covariance) >= 0.0).all(), "a variance is negative"
    sigma = np.sqrt(np.diag(covariance))
    scale = np.where(sigma > 0.0, sigma, 1.0)
    correlations = covariance / np.outer(scale, scale)
    assert np.linalg.eigvalsh(correlations)[0] > -1e-9 * len(correlations), "the covariance is not positive"


if __name__ == "__main__":
    a = options(__doc__, seed=0, ticks=1_000_000, length=1500, first=0, associator="")
    ticks, length = (200, 20) if a.quick else (a.ticks, a.length)
    total, number, broken = 0, a.first, 0
    megabytes: list[float] = []
    worst, when, loops = 0.0, "never", 0
    while total < ticks:
        words, env = episode(number, a.seed, length, a.associator)
        try:
            for taken, seconds in checked(env, number):
                total += taken
                if ready() == loops and seconds > worst * taken:
                    worst, when = seconds / taken, words
                loops = ready()
        except Exception as error:
            broken += 1
            print(f"BROKEN {words}: {type(error).__name__}: {error}", flush=True)
        del env
        gc.collect()
        megabytes.append(resident())
        number += 1
        if number % 20 == 0:
            print(f"{len(megabytes)} episodes, {total} ticks, {megabytes[-1]:.0f} MB; --first {number}", flush=True)
    fifth = max(len(megabytes) // 5, 1)
    growth = np.median(megabytes[-fifth:]) / np.median(megabytes[fifth : 2 * fifth] or megabytes) - 1.0
    print(f"{len(megabytes)} episodes, {total} ticks, {broken} broken, memory {100.0 * growth:+.1f} %")
    print(f"worst tick {worst:.2f} s: {when}")
    too_long, leaks = a.associator != "" and worst > LONGEST_TICK, len(megabytes) >= MIN_EPISODES and growth > GROWTH
    raise SystemExit(int(broken > 0 or too_long or leaks))
