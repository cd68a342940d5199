"""Policies and learners of Stable-Baselines3: MaskablePPO scores choices one by one (goals of Explore-v0, branches of
Associate-v0), PPO drives by twists.

Every choice passes through the same weights, together with the situation and the maximum over all legal choices (Deep
Sets, Zaheer et al. 2017). So a permutation of the choices permutes their scores.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import torch
from gymnasium import spaces
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.policies import MaskableMultiInputActorCriticPolicy
from stable_baselines3 import PPO
from stable_baselines3.common.policies import ActorCriticPolicy, MultiInputActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, CombinedExtractor
from stable_baselines3.common.utils import LinearSchedule
from torch import Tensor, nn

from slam_gym.association.tracking.observation import CANDIDATE_FIELDS
from slam_gym.envs.observation import GOAL_FIELDS

Decision = Literal["goal", "twist", "branch"]
"""What a policy decides: goals or twists in Explore-v0, branches of the interpretation tree in Associate-v0."""

CHOICES = {"goal": ("goals", GOAL_FIELDS), "branch": ("candidates", CANDIDATE_FIELDS)}
"""The decisions that are choices: the part of the observation that lists the choices, and the columns of its rows."""

# -- hyperparameters ---------------------------------------------------------------------------------------------------

HYPERPARAMETERS = Path(__file__).with_name("hyperparameters.toml")
_WHOLE_NUMBERS = ("n_steps", "batch_size", "n_epochs")
_PPO = (*_WHOLE_NUMBERS, "learning_rate", "gamma", "gae_lambda", "clip_range", "ent_coef", "vf_coef")
_LARGEST_LAYER, _LONGEST = 1_024, 10**12
LAST = 0.05  # final learning rate and entropy coefficient, as a fraction of the initial ones


@dataclass(frozen=True)
class Hyperparameters:
    """The hyperparameters of a training; the file beside this module contains the defaults, with explanations.

    Raises ValueError, naming the hyperparameter, for one that is missing, unknown or out of its range.
    """

    timesteps: int  # decisions in all
    eval_every: int  # decisions between evaluations on held-out worlds
    envs: int  # stepped in parallel
    reward_scale: float  # factor of the rewards in training
    width: int  # of the encoded situation
    hidden: int  # of the layers behind it
    deterministic: bool  # evaluated with the most probable action, or with one drawn from the policy
    annealed: bool  # learning rate and entropy coefficient fall linearly, to a twentieth at the end
    ppo: dict[str, Any]  # arguments of Stable-Baselines3's PPO

    def __post_init__(self) -> None:
        for name in ("timesteps", "eval_every", "envs", "width", "hidden"):
            value, most = getattr(self, name), _LONGEST if name in ("timesteps", "eval_every") else _LARGEST_LAYER
            if type(value) is not int or not 1 <= value <= most:
                raise ValueError(f"{name} is {value!r}, expected a whole number in 1 … {most}")
        if not isinstance(self.ppo, dict) or not set(self.ppo) <= set(_PPO):
            raise ValueError(f"ppo must be a table of {', '.join(_PPO)}")
        for name, value in {"reward_scale": self.reward_scale, **self.ppo}.items():
            kinds = (int,) if name in _WHOLE_NUMBERS else (int, float)
            if type(value) not in kinds or not 0 <= value <= 1e6:
                raise ValueError(f"{name} is {value!r}, expected a {'whole ' if len(kinds) == 1 else ''}number ≥ 0")


def load_hyperparameters(action: Decision, path: Path = HYPERPARAMETERS) -> Hyperparameters:
    """The table `[goal]`, `[twist]` or `[branch]` of a TOML file. Raises ValueError, naming the file and the error."""
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8")).get(action)
        if not isinstance(table, dict):
            raise ValueError(f"it has no table [{action}]")
        return Hyperparameters(**table)
    except (OSError, ValueError, TypeError, RecursionError) as error:
        raise ValueError(f"{path}: {error}") from error


# -- policies ----------------------------------------------------------------------------------------------------------


class ChoiceScorer(BaseFeaturesExtractor):
    """Observation → (B, actions + 1): a score for each action, and the critic's value.

    Actions beyond the K choices, such as `*` of the interpretation tree, are rows that are legal and 0 otherwise.
    """

    def __init__(self, observation_space: spaces.Dict, decision: Decision, actions: int, width: int, hidden: int):
        super().__init__(observation_space, actions + 1)
        self.choices, fields = CHOICES[decision]
        others = {name: space for name, space in observation_space.spaces.items() if name != self.choices}
        combined = CombinedExtractor(spaces.Dict(others), cnn_output_dim=width)
        self.situation = nn.Sequential(combined, nn.Linear(combined.features_dim, width), nn.ReLU())
        self.legal = fields.index("legal")
        further = torch.zeros(actions - spaces.flatdim(observation_space[self.choices]) // len(fields), len(fields))
        further[:, self.legal] = 1.0
        self.register_buffer("further", further)
        self.embed = nn.Sequential(nn.Linear(len(fields), hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU())
        self.score = nn.Sequential(nn.Linear(2 * hidden + width, hidden), nn.ReLU(), nn.Linear(hidden, 1))
        self.value = nn.Sequential(nn.Linear(hidden + width, hidden), nn.ReLU(), nn.Linear(hidden, 1))

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        rows = observations[self.choices].unflatten(1, (-1, self.further.shape[1]))
        rows = torch.cat([rows, self.further.expand(len(rows), -1, -1)], dim=1)
        embedded = self.embed(rows) * rows[:, :, self.legal, None]
        shared = torch.cat([self.situation(observations), embedded.amax(1)], dim=1)
        each = shared.unsqueeze(1).expand(-1, rows.shape[1], -1)
        scores = self.score(torch.cat([embedded, each], dim=2)).squeeze(2)
        return torch.cat([scores, self.value(shared)], dim=1)


class Columns(nn.Module):
    """Some columns of the output of the scorer."""

    def __init__(self, columns: slice) -> None:
        super().__init__()
        self.columns = columns

    def forward(self, scored: Tensor) -> Tensor:
        return scored[:, self.columns]


class ChoicePolicy(MaskableMultiInputActorCriticPolicy):
    """Actor-critic for MaskablePPO whose logits and value are those of a `ChoiceScorer`, its features extractor."""

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        actions, scorer = spaces.flatdim(self.action_space), self.features_extractor
        self.action_net, self.value_net = Columns(slice(actions)), Columns(slice(actions, None))
        nn.init.orthogonal_(scorer.score[-1].weight, 0.01)  # close to uniform over the legal actions
        nn.init.orthogonal_(scorer.value[-1].weight)
        self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)


def policy_of(action: Decision, actions: int, hyper: Hyperparameters) -> tuple[type[ActorCriticPolicy], dict[str, Any]]:
    """Class and further arguments of a policy, from which both trainer and loader build it."""
    if action == "twist":
        extractor = {"cnn_output_dim": hyper.width}
        return MultiInputActorCriticPolicy, {
            "features_extractor_kwargs": extractor, "net_arch": [hyper.hidden, hyper.hidden],
        }  # fmt: skip
    scorer = {"decision": action, "actions": actions, "width": hyper.width, "hidden": hyper.hidden}
    return ChoicePolicy, {
        "features_extractor_class": ChoiceScorer, "features_extractor_kwargs": scorer, "net_arch": [],
    }  # fmt: skip


def make_algorithm(action: Decision, env: Any, hyper: Hyperparameters, seed: int) -> PPO | MaskablePPO:
    """A new learner on a vectorised environment."""
    policy, arguments = policy_of(action, spaces.flatdim(env.action_space), hyper)
    learner = MaskablePPO if action in CHOICES else PPO
    rate = hyper.ppo["learning_rate"]
    ppo = hyper.ppo | {"learning_rate": LinearSchedule(rate, LAST * rate, 1.0) if hyper.annealed else rate}
    return learner(policy, env, seed=seed, device="cpu", policy_kwargs=arguments, **ppo)
