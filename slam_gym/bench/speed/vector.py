"""Explore-v0, many worlds at once: ticks per second beside those of one world, and what a reset costs the others.

All vectors take turns in one run, block by block, by the clock: medians over the blocks. Twists are drawn blindly,
goals among the legal ones; a goal takes many ticks, hence ticks are counted. The cost of a reset is that of a step in
which one world is reset, the worlds ending at different times, beyond the median of the steps between.
"""

from __future__ import annotations

import time
from functools import partial
from typing import Any, Literal

import gymnasium as gym
import numpy as np

import slam_gym  # noqa: F401  (registers the environments)
from slam_gym.bench.records import Record
from slam_gym.bench.report import Report
from slam_gym.bench.timing import timed

Action = Literal["twist", "goal"]
BUDGET = 160  # [ticks] of the episodes in which resets are timed


def made(scenario: str, action: Action, worlds: int, workers: int, **options: Any) -> Any:
    """So many worlds in so many processes."""
    given: dict[str, Any] = {"scenario": scenario, "action": action, "associator": "jcbb", "workers": workers} | options
    return gym.make_vec("slam_gym/Explore-v0", worlds, "vector_entry_point", **given)


def actions(envs: Any, rng: np.random.Generator) -> Any:
    """Legal goals, or twists that lean forward."""
    if isinstance(envs.single_action_space, gym.spaces.Discrete):
        return np.array([rng.choice(np.flatnonzero(mask)) for mask in envs.action_masks()])
    return np.clip(rng.normal([0.5, 0.0], [0.6, 0.5], (envs.num_envs, 2)), -1.0, 1.0).astype(np.float32)


def block(envs: Any, rng: np.random.Generator, ticks: int) -> float:
    """Ticks per second of all worlds together, over some ticks at least."""
    done, start = 0, time.perf_counter()
    while done < ticks:
        *_, infos = envs.step(actions(envs, rng))
        done += int(infos["ticks"].sum())
    return done / (time.perf_counter() - start)


def throughput(scenario: str, action: Action, worlds: int, workers: int, blocks: int, seed: int) -> list[Record]:
    """One world beside many, in this process and in others."""
    kinds = {
        "1 world": made(scenario, action, 1, 0),
        f"{worlds} worlds, this process": made(scenario, action, worlds, 0),
        f"{worlds} worlds, {workers} workers": made(scenario, action, worlds, workers),
    }
    ticks = 100 if action == "twist" else 200  # of each world in a block
    rates: dict[str, list[float]] = {name: [] for name in kinds}
    rngs = {name: np.random.default_rng(seed) for name in kinds}
    for envs in kinds.values():
        envs.reset(seed=seed)
    for k in range(blocks + 1):  # the first compiles
        for name, envs in kinds.items():
            rate = block(envs, rngs[name], ticks * envs.num_envs)
            rates[name] += [rate] if k else []
    for envs in kinds.values():
        envs.close()
    one = float(np.median(rates["1 world"]))
    return [
        {"action": action, "": name, "ticks/s": float(np.median(found)), "of one world": float(np.median(found)) / one}
        for name, found in rates.items()
    ]


def staggered(envs: Any, rng: np.random.Generator, seed: int) -> None:
    """Begin episodes that end one after the other."""
    envs.reset(seed=seed)
    for world in range(envs.num_envs):
        for _ in range(BUDGET // envs.num_envs):
            envs.step(actions(envs, rng))
        envs.reset(options={"reset_mask": np.arange(envs.num_envs) == world})


def reset_cost(envs: Any, steps: int, seed: int) -> Record:
    """[ms] of steps with and without a reset in them."""
    rng = np.random.default_rng(seed)
    staggered(envs, rng, seed)
    times: dict[bool, list[float]] = {True: [], False: []}
    over = np.zeros(envs.num_envs, np.bool_)
    for _ in range(steps):
        chosen = actions(envs, rng)
        (*_, over_now, _, _), microseconds = timed(envs.step, chosen)
        times[bool(over.any())].append(1e-3 * microseconds)
        over = over_now
    plain, with_reset = (float(np.median(times[flag])) for flag in (False, True))
    return {"a step [ms]": plain, "with a reset [ms]": with_reset, "longer by [ms]": with_reset - plain}


def resets(scenario: str, worlds: int, workers: int, steps: int, seed: int) -> list[Record]:
    """What a reset costs alone, and the others."""
    short = partial(made, scenario, "twist", overrides={"budget": BUDGET})
    single = gym.make("slam_gym/Explore-v0", scenario=scenario, action="twist", associator="jcbb")
    alone = [timed(partial(single.reset, seed=seed + k)).microseconds for k in range(20)]
    rows: list[Record] = [{"": "a reset alone", "longer by [ms]": 1e-3 * float(np.median(alone))}]
    for name, envs in (
        (f"{worlds} worlds, this process", short(worlds, 0)),
        (f"{worlds} worlds, {workers} workers", short(worlds, workers)),
    ):
        rows.append({"": name} | reset_cost(envs, steps, seed))
        envs.close()
    return rows


def run(
    report: Report, *, worlds: int = 8, workers: int = 2, scenario: str = "office", blocks: int = 7, seed: int = 0
) -> None:
    """Two tables.

    Arguments:
        worlds: of the vector
        workers: processes that they are spread over
        scenario: by name
        blocks: of 100 twists or some 200 ticks of goals in each world, over which medians are taken
        seed: of everything random
    """
    rows = [row for action in ("twist", "goal") for row in throughput(scenario, action, worlds, workers, blocks, seed)]
    report.table("Ticks per second", rows, "vector")
    report.table("What a reset costs", resets(scenario, worlds, workers, 4 * BUDGET, seed), "vector_resets")
