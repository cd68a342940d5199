"""PPO on `twist`, MaskablePPO on `goal` and `branch`, and their hyperparameters."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

from sb3_contrib import MaskablePPO
from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import MultiInputActorCriticPolicy

from agents.learning.networks import BranchPolicy, GoalPolicy, ScoringPolicy, SituationEncoder

Decision = Literal["goal", "twist", "branch"]
"""What a policy decides: goals or twists in Explore-v0, branches of the interpretation tree in Associate-v0."""

SCORING: dict[str, type[ScoringPolicy]] = {"goal": GoalPolicy, "branch": BranchPolicy}
"""The decisions that are choices."""

HYPERPARAMETERS = Path(__file__).with_name("hyperparameters.toml")


@dataclass(frozen=True)
class Hyperparameters:
    """Of one training run; the file beside this module has the defaults and says what they mean."""

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


def load_hyperparameters(action: Decision, path: Path = HYPERPARAMETERS) -> Hyperparameters:
    """The table `[goal]`, `[twist]` or `[branch]` of a TOML file. ValueError names the file and what is wrong in it."""
    try:
        table = tomllib.loads(path.read_text()).get(action)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ValueError(f"{path}: {error}") from error
    known = {field.name for field in fields(Hyperparameters)}
    if not isinstance(table, dict) or set(table) != known:
        wrong = known.symmetric_difference(table) if isinstance(table, dict) else {f"[{action}]"}
        raise ValueError(
            f"{path}: table [{action}] must have exactly {', '.join(sorted(known))}; wrong: {sorted(wrong)}"
        )
    return Hyperparameters(**table)


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
