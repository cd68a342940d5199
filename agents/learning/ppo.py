"""PPO on `twist`, MaskablePPO on `goal` and `branch`: hyperparameters, policies and learners."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from sb3_contrib import MaskablePPO
from stable_baselines3 import PPO
from stable_baselines3.common.policies import ActorCriticPolicy, MultiInputActorCriticPolicy

from agents.learning.networks import ChoicePolicy

Decision = Literal["goal", "twist", "branch"]
"""What a policy decides: goals or twists in Explore-v0, branches of the interpretation tree in Associate-v0."""

CHOICES = {"goal": "goals", "branch": "candidates"}
"""The decisions that are choices, and the part of the observation that lists them."""

HYPERPARAMETERS = Path(__file__).with_name("hyperparameters.toml")
_PPO = (
    "n_steps", "batch_size", "n_epochs", "learning_rate", "gamma", "gae_lambda", "clip_range", "ent_coef", "vf_coef",
)  # fmt: skip
LARGEST_LAYER = 1_024


@dataclass(frozen=True)
class Hyperparameters:
    """Of one training run; the file beside this module has the defaults and says what they mean.

    Raises ValueError that names what is missing, unknown, or out of its range.
    """

    envs: int  # stepped in parallel
    reward_scale: float  # the factor of the rewards that are learned from
    width: int  # of the encoded situation
    hidden: int  # of the layers behind it
    deterministic: bool  # evaluated with the most probable action, or with one drawn from the policy
    ppo: dict[str, Any]  # as Stable-Baselines3 names them

    def __post_init__(self) -> None:
        for name in ("envs", "width", "hidden"):
            value = getattr(self, name)
            if type(value) is not int or not 1 <= value <= LARGEST_LAYER:
                raise ValueError(f"{name} is {value!r}, expected a whole number in 1 … {LARGEST_LAYER}")
        if not isinstance(self.ppo, dict) or set(self.ppo) != set(_PPO):
            raise ValueError(f"ppo must have exactly {', '.join(_PPO)}")
        for name, value in {"reward_scale": self.reward_scale, **self.ppo}.items():
            wanted = int if name in _PPO[:3] else int | float
            if isinstance(value, bool) or not isinstance(value, wanted) or not 0 <= value <= 1e6:
                raise ValueError(f"{name} is {value!r}, expected a {'whole ' if wanted is int else ''}number ≥ 0")


def load_hyperparameters(action: Decision, path: Path = HYPERPARAMETERS) -> Hyperparameters:
    """The table `[goal]`, `[twist]` or `[branch]` of a TOML file. ValueError names the file and what is wrong in it."""
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8")).get(action)
        if not isinstance(table, dict):
            raise ValueError(f"it has no table [{action}]")
        return Hyperparameters(**table)
    except (OSError, ValueError, TypeError, RecursionError) as error:
        raise ValueError(f"{path}: {error}") from error


def policy_of(action: Decision, width: int, hidden: int) -> tuple[type[ActorCriticPolicy], dict[str, Any]]:
    """Class and further arguments of a policy; both the trainer and the loader build it from these."""
    if action in CHOICES:
        return ChoicePolicy, {"choices": CHOICES[action], "width": width, "hidden": hidden}
    return MultiInputActorCriticPolicy, {
        "features_extractor_kwargs": {"cnn_output_dim": width},
        "net_arch": [hidden, hidden],
    }


def make_algorithm(action: Decision, env: Any, hyper: Hyperparameters, seed: int) -> PPO | MaskablePPO:
    """A fresh learner on a vectorised environment."""
    policy, arguments = policy_of(action, hyper.width, hyper.hidden)
    learner = MaskablePPO if action in CHOICES else PPO
    return learner(policy, env, seed=seed, device="cpu", policy_kwargs=arguments, **hyper.ppo)
