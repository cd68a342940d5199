"""Ablations of the learning of association: what an agent has to see, and what it should be paid for.

Every variant trains MaskablePPO in Associate-v0 from random weights, for 400 000 decisions and with several seeds, and
differs from the first in one thing. Each policy then associates in drives of train worlds that no training sees, and
the rows give its map error and the paired difference to the first variant.

    python benchmarks/learned_associator.py --out runs/ablations            # an hour of one core
    python benchmarks/learned_associator.py --variants "as it is" "reward per scan"

Trainings and drives that are in the folder already are left out.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd
from gymnasium.wrappers import TransformObservation

from agents.evaluation.episodes import AssociateArguments, ExploreArguments, associator_evaluation
from agents.evaluation.pipeline import carry_out
from agents.learning.policies import HYPERPARAMETERS
from agents.learning.training import WEIGHTS, train
from agents.options import DRIFTING, Training
from benchmarks.common import Record, mean_interval, options, table
from slam_gym import weights
from slam_gym.association.tracking.ppo import INPUTS, SHAPES, VERSION
from slam_gym.association.tracking.walk import CANDIDATE_FIELDS

SCENARIOS = ("office", "drift-2", "drift-3", "aliased-drift")
FIRST_WORLD = 30_000  # of the million of the train split, of which a training draws some hundreds


@dataclass(frozen=True)
class Variant(AssociateArguments):
    """Arguments of Associate-v0, fields of candidates that the agent is not shown, and when it is paid."""

    hidden: tuple[str, ...] = ()
    per_scan: bool = False

    @property
    def plain(self) -> dict[str, Any]:
        return {name: value for name, value in super().plain.items() if name not in ("hidden", "per_scan")}

    @property
    def columns(self) -> list[int]:
        return [CANDIDATE_FIELDS.index(name) for name in self.hidden]

    def make(self, action: str = "branch") -> gym.Env[Any, Any]:
        env = super().make(action)
        env = TransformObservation(env, self._without_hidden, env.observation_space) if self.hidden else env
        return _PaysPerScan(env) if self.per_scan else env

    def _without_hidden(self, observation: Any) -> Any:
        rows = observation["candidates"].reshape(-1, len(CANDIDATE_FIELDS)).copy()
        rows[:, self.columns] = 0.0
        return observation | {"candidates": rows.ravel()}


class _PaysPerScan(gym.Wrapper[Any, Any, Any, Any]):
    """Every scan is an episode of its own, and what its decisions earn is paid with the last of them."""

    _begun: tuple[Any, dict[str, Any]] | None = None  # the scan that follows
    _earned, _look = 0.0, -1

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        observation, info = self._begun or self.env.reset(**arguments)
        self._begun, self._earned, self._look = None, 0.0, info["look"]
        return observation, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._earned += float(reward)
        if terminated or truncated:
            return observation, self._earned, terminated, truncated, info
        if info["look"] == self._look:
            return observation, 0.0, False, False, info
        self._begun = observation, info
        return observation, self._earned, True, False, info


VARIANTS = {
    "as it is": Variant(),
    "no outlook": Variant(hidden=("outlook", "odds", "margin")),
    "no sightings, age, confirmed": Variant(hidden=("sightings", "age", "confirmed")),
    "nearest measurements first": Variant(order="nearest_first"),
    "reward per scan": Variant(per_scan=True),
}


def trained(variant: Variant, seed: int, timesteps: int, out: Path) -> Path:
    """The file of the weights that a training leaves in a folder; the weights of hidden columns are 0."""
    path = out / WEIGHTS
    if path.exists():
        return path
    out.mkdir(parents=True, exist_ok=True)
    text = HYPERPARAMETERS.read_text(encoding="utf-8")
    hyper = out / "hyperparameters.toml"
    hyper.write_text(text.replace("gamma = 0.0 ", "gamma = 1.0 ") if variant.per_scan else text, encoding="utf-8")
    training = Training(timesteps, seed, out, hyperparameters=hyper, eval_every=10 * timesteps)
    train("branch", [replace(variant, scenario=name) for name in DRIFTING], training, str(out))
    learned = weights.load(path, VERSION, INPUTS, SHAPES)
    columns = np.array(learned.arrays["A"])
    columns[:, variant.columns] = 0.0
    weights.write(path, learned._replace(arrays={**learned.arrays, "A": columns}))
    return path


def compared(drives: pd.DataFrame) -> Iterator[Record]:
    """Of each variant and scenario the means, and the paired difference of the map error to the first variant."""
    for scenario, group in drives.groupby("setting", sort=False):
        first = None
        for variant, rows in group.groupby("variant", sort=False):
            errors = rows.groupby("episode")["map_error"].mean()
            first = errors if first is None else first
            difference = "" if first is errors else mean_interval(errors - first, signed=True)
            means = rows[["map_error", "precision", "recall", "duplicates"]].mean()
            yield {"scenario": scenario, "variant": variant, **means, "difference [95 %]": difference}


if __name__ == "__main__":
    a = options(__doc__, seed=0, variants=tuple(VARIANTS), seeds=3, timesteps=400_000, worlds=20, out="")
    names, seeds = (["no outlook", "reward per scan"], 1) if a.quick else (a.variants, a.seeds)
    timesteps, worlds, scenarios = (3_000, 1, SCENARIOS[:1]) if a.quick else (a.timesteps, a.worlds, SCENARIOS)
    with TemporaryDirectory() as temporary:
        out, variants = Path(a.out or temporary), {}  # of the files of weights
        for name, seed in product(names, range(a.seed, a.seed + seeds)):
            path = trained(VARIANTS[name], seed, timesteps, out / name.replace(" ", "-") / str(seed))
            variants[str(path)] = name
        loops = [ExploreArguments(name, split="train") for name in scenarios]
        numbers = range(FIRST_WORLD, FIRST_WORLD + worlds)
        evaluation = associator_evaluation(list(variants), loops, "information_gain", numbers, [None])
        drives = out / "drives"
        frame = carry_out(evaluation, drives, resume=drives.exists()).frame
    frame = frame.assign(variant=frame["name"].map(variants))
    table("Drives of train worlds", list(compared(frame)))
