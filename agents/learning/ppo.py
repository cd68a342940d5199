"""PPO on `twist`, MaskablePPO on `goal` and `branch`, and their hyperparameters."""

from __future__ import annotations

import reprlib
import tomllib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

from sb3_contrib import MaskablePPO
from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import MultiInputActorCriticPolicy

from agents.learning.networks import BranchPolicy, GoalPolicy, ScoringPolicy, SituationEncoder
from slam_gym._files import content_of

Decision = Literal["goal", "twist", "branch"]
"""What a policy decides: goals or twists in Explore-v0, branches of the interpretation tree in Associate-v0."""

SCORING: dict[str, type[ScoringPolicy]] = {"goal": GoalPolicy, "branch": BranchPolicy}
"""The decisions that are choices."""

_MAX_BYTES = 1 << 16  # of a file of hyperparameters
HYPERPARAMETERS = Path(__file__).with_name("hyperparameters.toml")


@dataclass(frozen=True)
class Hyperparameters:
    """Of one training run; the file beside this module has the defaults and says what they mean.

    Raises ValueError that names the one that is of another type, or out of its range.
    """

    envs: int
    steps: int
    batch_size: int
    epochs: int
    learning_rate: float
    discount: float
    gae_lambda: float
    clip_range: float
    entropy_coefficient: float
    value_coefficient: float
    reward_scale: float
    width: int
    hidden: int
    deterministic: bool

    def __post_init__(self) -> None:
        if type(self.deterministic) is not bool:
            raise ValueError(f"deterministic is {self.deterministic!r}, expected true or false")
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            wanted = int if self.__annotations__[name] == "int" else int | float
            if isinstance(value, bool) or not isinstance(value, wanted) or not low <= value <= high:
                kind = "a whole number" if wanted is int else "a number"
                raise ValueError(f"{name} is {reprlib.repr(value)}, expected {kind} in {low:g} … {high:g}")


_RANGES: dict[str, tuple[float, float]] = {
    "envs": (1, 256), "steps": (1, 100_000), "batch_size": (2, 10_000_000), "epochs": (1, 1_000),
    "learning_rate": (1e-12, 1.0), "discount": (0.0, 1.0), "gae_lambda": (0.0, 1.0), "clip_range": (1e-6, 10.0),
    "entropy_coefficient": (0.0, 100.0), "value_coefficient": (0.0, 100.0), "reward_scale": (1e-6, 1e6),
    "width": (1, 1_024), "hidden": (1, 1_024),
}  # fmt: skip
"""Of each number, its smallest and largest value."""


def load_hyperparameters(action: Decision, path: Path = HYPERPARAMETERS) -> Hyperparameters:
    """The table `[goal]`, `[twist]` or `[branch]` of a TOML file.

    ValueError names the file and what is wrong in it.
    """
    try:
        table = tomllib.loads(content_of(path, _MAX_BYTES).decode("utf-8")).get(action)
    except RecursionError:
        raise ValueError(f"{path}: it is nested too deeply") from None
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error
    known = {field.name for field in fields(Hyperparameters)}
    if not isinstance(table, dict) or set(table) != known:
        wrong = sorted(known.symmetric_difference(table) if isinstance(table, dict) else {f"[{action}]"})
        raise ValueError(
            f"{path}: table [{action}] must have exactly {', '.join(sorted(known))}; wrong: {reprlib.repr(wrong)}"
        )
    try:
        return Hyperparameters(**table)
    except ValueError as error:
        raise ValueError(f"{path}: table [{action}]: {error}") from None


def policy_arguments(action: Decision, hyper: Hyperparameters) -> dict[str, Any]:
    """Arguments that both the trainer and the loader build the network from."""
    if action in SCORING:
        return {"width": hyper.width, "hidden": hyper.hidden}
    arguments = {"features_extractor_class": SituationEncoder, "features_extractor_kwargs": {"width": hyper.width}}
    return arguments | {"net_arch": {"pi": [hyper.hidden] * 2, "vf": [hyper.hidden] * 2}}


def make_algorithm(action: Decision, env: Any, hyper: Hyperparameters, seed: int) -> BaseAlgorithm:
    """A fresh learner on a vectorised environment."""
    cls, policy = (MaskablePPO, SCORING[action]) if action in SCORING else (PPO, MultiInputActorCriticPolicy)
    return cls(
        policy, env, learning_rate=hyper.learning_rate, n_steps=hyper.steps, batch_size=hyper.batch_size,
        n_epochs=hyper.epochs, gamma=hyper.discount, gae_lambda=hyper.gae_lambda, clip_range=hyper.clip_range,
        ent_coef=hyper.entropy_coefficient, vf_coef=hyper.value_coefficient, seed=seed, device="cpu",
        policy_kwargs=policy_arguments(action, hyper),
    )  # fmt: skip
