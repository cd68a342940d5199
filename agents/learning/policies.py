"""Policies of Stable-Baselines3, and their files: MaskablePPO scores choices one by one (goals of Explore-v0, branches
of Associate-v0), PPO drives by twists.

Every choice passes through the same weights, together with the situation and the maximum over all legal choices (Deep
Sets, Zaheer et al. 2017). So a permutation of the choices permutes their scores.

A file contains weights, which torch reads without running code, and a JSON table whose entry `about` describes the
network. Other entries of the table are pickles, which are read only with `trust`.
"""

from __future__ import annotations

import json
import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.policies import MaskableActorCriticPolicy, MaskableMultiInputActorCriticPolicy
from stable_baselines3 import PPO
from stable_baselines3.common.policies import ActorCriticPolicy, MultiInputActorCriticPolicy
from stable_baselines3.common.save_util import load_from_zip_file
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, CombinedExtractor
from stable_baselines3.common.utils import LinearSchedule
from torch import Tensor, nn

from agents.drivers.base import ActionKind, Info, Observation
from slam_gym._files import zip_members
from slam_gym.association.tracking import ppo
from slam_gym.association.tracking.walk import CANDIDATE_FIELDS, COMPATIBILITIES
from slam_gym.association.walks import ORDERS
from slam_gym.envs.observation import GOAL_FIELDS
from slam_gym.weights import Card, Weights

Decision = Literal["goal", "twist", "branch"]
"""What a policy decides: goals or twists in Explore-v0, branches of the interpretation tree in Associate-v0."""

CHOICES = {"goal": ("goals", GOAL_FIELDS), "branch": ("candidates", CANDIDATE_FIELDS)}
"""The decisions that are choices: the part of the observation that lists the choices, and the columns of its rows."""

# -- hyperparameters ---------------------------------------------------------------------------------------------------

HYPERPARAMETERS = Path(__file__).with_name("hyperparameters.toml")
_ANNEALED = ("learning_rate", "ent_coef")
_PPO = ("n_steps", "batch_size", "n_epochs", "gamma", "gae_lambda", "clip_range", "vf_coef", *_ANNEALED)
_WHOLE = {"n_steps": 1, "batch_size": 2, "n_epochs": 1}  # and the least; SB3 standardises advantages within a batch
_LARGEST = {"timesteps": 10**12, "eval_every": 10**12, "envs": 1_024, "width": 1_024, "hidden": 1_024}
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
        for name, most in _LARGEST.items():
            value = getattr(self, name)
            if type(value) is not int or not 1 <= value <= most:
                raise ValueError(f"{name} is {value!r}, expected a whole number in 1 … {most}")
        for name in ("deterministic", "annealed"):
            if type(getattr(self, name)) is not bool:
                raise ValueError(f"{name} is {getattr(self, name)!r}, expected true or false")
        if not isinstance(self.ppo, dict) or not set(_ANNEALED) <= set(self.ppo) <= set(_PPO):
            raise ValueError(f"ppo must be a table of {', '.join(_PPO)}, with {' and '.join(_ANNEALED)}")
        for name, value in {"reward_scale": self.reward_scale, **self.ppo}.items():
            least, most = _WHOLE.get(name, 0), 1 if name in ("gamma", "gae_lambda") else 1_000_000
            kinds = (int,) if name in _WHOLE else (int, float)
            if type(value) not in kinds or not least <= value <= most:
                whole = "whole " if name in _WHOLE else ""
                raise ValueError(f"{name} is {value!r}, expected a {whole}number in {least} … {most}")


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
        extractor, layers = {"cnn_output_dim": hyper.width}, [hyper.hidden, hyper.hidden]
        return MultiInputActorCriticPolicy, {"features_extractor_kwargs": extractor, "net_arch": layers}
    scorer = {"decision": action, "actions": actions, "width": hyper.width, "hidden": hyper.hidden}
    return ChoicePolicy, {"features_extractor_class": ChoiceScorer, "features_extractor_kwargs": scorer, "net_arch": []}


def make_algorithm(action: Decision, env: Any, hyper: Hyperparameters, seed: int) -> PPO | MaskablePPO:
    """A new learner on a vectorised environment."""
    policy, arguments = policy_of(action, spaces.flatdim(env.action_space), hyper)
    learner = MaskablePPO if action in CHOICES else PPO
    rate = hyper.ppo["learning_rate"]
    settings = hyper.ppo | {"learning_rate": LinearSchedule(rate, LAST * rate, 1.0) if hyper.annealed else rate}
    return learner(policy, env, seed=seed, device="cpu", policy_kwargs=arguments, **settings)


# -- files -------------------------------------------------------------------------------------------------------------

FORMAT = "slam_gym policy 3"
_MAX_BYTES = 1 << 28  # of a file, unpacked
_MAX_VALUES, _MAX_ACTIONS = 1 << 17, 4_096  # of an observation; of a choice


@dataclass(frozen=True)
class About:
    """The description in a model file: enough to rebuild the network, and how it was trained.

    Raises ValueError for values that no training writes.
    """

    action: Decision
    observation: dict[str, list[int]]  # shape of each part of the observation; `image` is uint8, the rest float32
    actions: int  # number of goals or branches, or length of the twist
    hyperparameters: Hyperparameters
    training: dict[str, Any]  # scenario, seed, versions …
    timesteps: int = 0  # decisions so far
    format: str = FORMAT

    def __post_init__(self) -> None:
        sides = [self.actions, *(side for shape in self.observation.values() for side in shape)]
        if self.format != FORMAT or self.action not in (*CHOICES, "twist") or not isinstance(self.training, dict):
            raise ValueError(f"not a {FORMAT!r} file")
        if not all(type(n) is int and n >= 1 for n in sides):
            raise ValueError("its sizes are no positive numbers")
        if sum(map(math.prod, self.observation.values())) > _MAX_VALUES or self.actions > _MAX_ACTIONS:
            raise ValueError("it describes a network larger than any that is trained here")

    @property
    def network(self) -> tuple[Any, ...]:
        """The values that determine the shapes of its weights."""
        return self.action, self.observation, self.actions, self.hyperparameters.width, self.hyperparameters.hidden

    def policy(self) -> Any:
        """The network, with initial weights."""
        observation = spaces.Dict({
            key: spaces.Box(0, 255, shape, np.uint8) if key == "image" else spaces.Box(-1.0, 1.0, shape, np.float32)
            for key, shape in self.observation.items()
        })  # fmt: skip
        choice, twist = spaces.Discrete(self.actions), spaces.Box(-1.0, 1.0, (self.actions,), np.float32)
        policy, arguments = policy_of(self.action, self.actions, self.hyperparameters)
        return policy(observation, choice if self.action in CHOICES else twist, lambda _: 0.0, **arguments)


def read_about(path: Path) -> About:
    """The description in a model file. Raises ValueError, naming the file, where it is missing, damaged or foreign."""
    try:
        data = json.loads(zip_members(path, _MAX_BYTES)["data"])
        hyper = Hyperparameters(**data["about"].pop("hyperparameters"))
        return About(**data["about"] | {"timesteps": int(data["num_timesteps"])}, hyperparameters=hyper)
    except OSError:
        raise ValueError(f"model {path}: no such file") from None
    except Exception as error:  # json and what it holds raise various errors
        raise ValueError(
            f"model {path}: refused, it is no model of this package ({type(error).__name__}: {error}); "
            "--trust reads other files of Stable-Baselines3, which can run code"
        ) from None


def load_policy(path: Path) -> tuple[About, Any]:
    """The description in a model file, and its network.

    Raises ValueError as `read_about`, and for weights that are not finite or do not fit the description.
    """
    about = read_about(path)
    try:
        weights = load_from_zip_file(path, load_data=False, device="cpu")[1]["policy"]
        if not all(bool(torch.isfinite(tensor).all()) for tensor in weights.values()):
            raise ValueError("not all weights are finite")
        policy = about.policy()
        policy.load_state_dict(weights)
    except Exception as error:  # torch raises various errors
        reason = (str(error) or type(error).__name__).splitlines()[0][:300]
        raise ValueError(f"model {path}: refused, {reason}") from None
    return about, policy


class PolicyAgent:
    """A driver that is a trained network."""

    name = "ppo"

    def __init__(self, policy: Any, action: ActionKind, *, deterministic: bool) -> None:
        torch.set_num_threads(1)  # more threads are slower for one state at a time
        policy.set_training_mode(False)
        self.action: ActionKind = action
        self._policy, self._deterministic = policy, deterministic

    @classmethod
    def load(cls, path: Path, *, trust: bool = False) -> PolicyAgent:
        """The driver of a model file. `trust` also reads files of Stable-Baselines3 without the entry `about`, by
        unpickling, which can run code: MaskablePPO for goals, PPO for twists."""
        try:
            about, policy = load_policy(path)
        except ValueError:
            if not trust:
                raise
            return cls._trusted(path)
        if about.action == "branch":
            raise ValueError(f"model {path}: an associator, not a driver")
        return cls(policy, about.action, deterministic=about.hyperparameters.deterministic)

    @classmethod
    def _trusted(cls, path: Path) -> PolicyAgent:
        try:
            kind: Any = load_from_zip_file(path, device="cpu")[0]["policy_class"]
            masked = issubclass(kind, MaskableActorCriticPolicy)
            policy = (MaskablePPO if masked else PPO).load(path, device="cpu").policy
        except Exception as error:  # of another algorithm, or damaged
            raise ValueError(f"model {path}: not of PPO or MaskablePPO ({error})") from None
        if masked != isinstance(policy.action_space, spaces.Discrete):
            raise ValueError(f"model {path}: goals need MaskablePPO, and twists PPO")
        return cls(policy, "goal" if masked else "twist", deterministic=masked)

    def reset(self, seed: int) -> None:
        torch.manual_seed(seed)

    def act(self, observation: Observation, info: Info) -> int | NDArray[np.float32]:
        masks = {"action_masks": info["action_mask"]} if self.action == "goal" else {}
        action, _ = self._policy.predict(dict(observation), deterministic=self._deterministic, **masks)
        return int(action) if self.action == "goal" else np.asarray(action, np.float32)


def branch_weights(policy: Any, known: dict[str, Any]) -> Weights:
    """The arrays of a network trained on Associate-v0, with which `tracking.ppo` associates without torch. `known` is
    the entry `training` of its description."""
    net, arrays = policy.features_extractor, {}
    layers = net.embed[0], net.embed[2], net.situation[1], net.score[0], net.score[2]
    for weight, bias, layer in zip("ABCDw", ("a", "b", "c", "d", "w0"), layers):
        arrays |= {weight: layer.weight.detach().numpy().copy(), bias: layer.bias.detach().numpy().copy()}
    walk = known["candidates"], ORDERS.index(known["order"]), COMPATIBILITIES.index(known["compatibility"])
    arrays["walk"] = np.array(walk, np.int64)
    card = Card(ppo.VERSION, ppo.INPUTS, {}, tuple(known["scenario"]), (known["seed"],), known["command"], {})
    return Weights(card, {name: arrays[name] for name in ppo.SHAPES})
