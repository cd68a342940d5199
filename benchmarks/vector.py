"""Explore-v0 with many worlds at once: ticks per second, compared with one world and with Gymnasium's own vectors.

All take turns in one run, block by block, in wall-clock time; the figures are medians over the blocks. Twists and legal
goals are drawn at random. Ticks are counted, not steps, since a goal takes many ticks.

    python benchmarks/vector.py [--worlds 8 --workers 2 --blocks 16]      # three minutes
"""

import time
from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np

import slam_gym  # noqa: F401 (registers the environments)
from benchmarks.common import Record, options, table

ID = "slam_gym:slam_gym/Explore-v0"  # imports the package in a fresh process, too


def actions(envs: Any, infos: dict[str, Any], rng: np.random.Generator) -> Any:
    """Random legal goals, or twists that mostly drive forward."""
    if isinstance(envs.single_action_space, gym.spaces.Discrete):
        return np.array([rng.choice(np.flatnonzero(mask)) for mask in infos["action_mask"]])
    return np.clip(rng.normal([0.5, 0.0], [0.6, 0.5], (envs.num_envs, 2)), -1.0, 1.0).astype(np.float32)


def blocks_of(envs: Any, ticks: int, seed: int) -> Iterator[float]:
    """Yield the ticks per second of all worlds together, in blocks of at least `ticks`."""
    rng = np.random.default_rng(seed)
    _, infos = envs.reset(seed=seed)
    while True:
        done, start = 0, time.perf_counter()
        while done < ticks:
            *_, infos = envs.step(actions(envs, infos, rng))
            done += int(np.asarray(infos["ticks"]).sum())
        yield done / (time.perf_counter() - start)


if __name__ == "__main__":
    a = options(__doc__, seed=0, worlds=8, workers=2, scenario="office", blocks=7)
    n, blocks = (2, 1) if a.quick else (a.worlds, a.blocks)
    rows: list[Record] = []
    for action, ticks in (("twist", 100), ("goal", 200)):
        arguments = {"scenario": a.scenario, "action": action, "associator": "jcbb"}
        native = {"vectorization_mode": "vector_entry_point", **arguments}
        kinds = {
            "1 world": gym.make_vec(ID, 1, workers=0, **native),
            f"{n} worlds, this process": gym.make_vec(ID, n, workers=0, **native),
            f"{n} worlds, {a.workers} workers": gym.make_vec(ID, n, workers=a.workers, **native),
            f"{n} worlds, Gymnasium's sync": gym.make_vec(ID, n, vectorization_mode="sync", **arguments),
            f"{n} worlds, Gymnasium's async": gym.make_vec(ID, n, vectorization_mode="async", **arguments),
        }
        runs = [blocks_of(envs, (5 if a.quick else ticks) * envs.num_envs, a.seed) for envs in kinds.values()]
        rates = np.array([[next(run) for run in runs] for _ in range(blocks + 1)])
        medians = np.median(rates[1:], axis=0).tolist()  # without the first block, which compiles
        for (name, envs), rate in zip(kinds.items(), medians):
            envs.close()
            rows.append({"action": action, "": name, "ticks/s": rate, "of one world": rate / medians[0]})
    table("Ticks per second", rows)
