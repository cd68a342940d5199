"""Networks that score choices one by one: goals of Explore-v0, branches of the interpretation tree of Associate-v0.

Every choice passes through the same weights, together with the situation and a summary of all legal choices (Deep Sets,
Zaheer et al. 2017). So a permutation of the choices permutes their scores, and their number K may change after
training.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from sb3_contrib.common.maskable.policies import MaskableMultiInputActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn

from slam_gym.association.tracking.observation import CANDIDATE_FIELDS
from slam_gym.envs.goal_observation import GOAL_FIELDS

LEGAL = GOAL_FIELDS.index("legal")  # as in CANDIDATE_FIELDS
_CONTEXT = ("measurement", "pairings", "path")


class SituationEncoder(BaseFeaturesExtractor):
    """Observation of Explore-v0 → one vector (B, width + K·G): the encoded situation, then the goals, if any."""

    def __init__(self, observation_space: spaces.Dict, width: int = 64, channels: int = 16) -> None:
        goals = spaces.flatdim(observation_space["goals"]) if "goals" in observation_space.spaces else 0
        super().__init__(observation_space, features_dim=width + goals)
        self._vectors = sorted(key for key in observation_space.spaces if key not in ("image", "goals"))
        layers, height = observation_space["image"].shape[0], observation_space["image"].shape[1]
        self.image = nn.Sequential(
            nn.Conv2d(layers, channels, 5, stride=3), nn.ReLU(),
            nn.Conv2d(channels, 2 * channels, 3, stride=2), nn.ReLU(),
            nn.Conv2d(2 * channels, 2 * channels, 3, stride=2), nn.ReLU(), nn.Flatten(),
        )  # fmt: skip
        with torch.no_grad():
            flat = self.image(torch.zeros(1, layers, height, height)).shape[1]
        vectors = sum(spaces.flatdim(observation_space[key]) for key in self._vectors)
        self.vectors = nn.Sequential(nn.Linear(vectors, width), nn.Tanh())
        self.join = nn.Sequential(nn.Linear(flat + width, width), nn.Tanh())

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        vectors = self.vectors(torch.cat([observations[key].flatten(1) for key in self._vectors], dim=1))
        situation = self.join(torch.cat([self.image(observations["image"]), vectors], dim=1))
        if "goals" not in observations:
            return situation
        return torch.cat([situation, observations["goals"].flatten(1)], dim=1)


class PathEncoder(BaseFeaturesExtractor):
    """Observation of Associate-v0 → one vector (B, width + K·F): measurement and path, encoded, then the candidates.

    The budget is not looked at, so that a policy decides in the environment as it does as an associator elsewhere.
    """

    def __init__(self, observation_space: spaces.Dict, width: int = 64) -> None:
        super().__init__(observation_space, features_dim=width + spaces.flatdim(observation_space["candidates"]))
        length = sum(spaces.flatdim(observation_space[key]) for key in _CONTEXT)
        self.context = nn.Sequential(nn.Linear(length, width), nn.Tanh(), nn.Linear(width, width), nn.Tanh())

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        context = self.context(torch.cat([observations[key] for key in _CONTEXT], dim=1))
        return torch.cat([context, observations["candidates"]], dim=1)


class Scorer(nn.Module):
    """The encoder's vector → a score per choice (B, K) for the actor, and a latent (B, hidden) for the critic."""

    def __init__(self, width: int, choices: int, hidden: int, fields: int = len(GOAL_FIELDS)) -> None:
        super().__init__()
        self.fields = fields
        self.width, self.latent_dim_pi, self.latent_dim_vf = width, choices, hidden
        self.embed = nn.Sequential(nn.Linear(fields, hidden), nn.Tanh(), nn.Linear(hidden, hidden), nn.Tanh())
        self.score = nn.Sequential(nn.Linear(2 * hidden + width, hidden), nn.Tanh(), nn.Linear(hidden, 1))
        self.value = nn.Sequential(nn.Linear(hidden + width, hidden), nn.Tanh())

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        situation, embedded, summary = self._split(features)
        return self._scores(situation, embedded, summary), self._latent(situation, summary)

    def forward_actor(self, features: Tensor) -> Tensor:
        return self._scores(*self._split(features))

    def forward_critic(self, features: Tensor) -> Tensor:
        situation, _, summary = self._split(features)
        return self._latent(situation, summary)

    def heads(self) -> list[nn.Sequential]:
        """What the scores come out of."""
        return [self.score]

    def _split(self, features: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Situation (B, width), embedded choices (B, K, hidden), and the mean of the legal ones (B, hidden)."""
        situation, choices = features[:, : self.width], features[:, self.width :]
        choices = choices.reshape(len(features), -1, self.fields)
        embedded = self.embed(choices)
        legal = choices[:, :, LEGAL : LEGAL + 1]
        return situation, embedded, (embedded * legal).sum(1) / legal.sum(1).clamp(min=1.0)

    def _scores(self, situation: Tensor, embedded: Tensor, summary: Tensor) -> Tensor:
        shared = torch.cat([situation, summary], dim=1)
        each = shared.unsqueeze(1).expand(-1, embedded.shape[1], -1)
        return self.score(torch.cat([embedded, each], dim=2)).squeeze(2)

    def _latent(self, situation: Tensor, summary: Tensor) -> Tensor:
        return self.value(torch.cat([situation, summary], dim=1))


class BranchScorer(Scorer):
    """The same for branches (B, K + 1): `*`, the last, has a score of its own from situation and summary."""

    def __init__(self, width: int, choices: int, hidden: int) -> None:
        super().__init__(width, choices, hidden, fields=len(CANDIDATE_FIELDS))
        self.refuse = nn.Sequential(nn.Linear(hidden + width, hidden), nn.Tanh(), nn.Linear(hidden, 1))

    def heads(self) -> list[nn.Sequential]:
        return [self.score, self.refuse]

    def _scores(self, situation: Tensor, embedded: Tensor, summary: Tensor) -> Tensor:
        refusal = self.refuse(torch.cat([situation, summary], dim=1))
        return torch.cat([super()._scores(situation, embedded, summary), refusal], dim=1)


class ScoringPolicy(MaskableMultiInputActorCriticPolicy):
    """Actor-critic for MaskablePPO whose logits are the scores. No weight's shape depends on K."""

    encoder: type[BaseFeaturesExtractor]
    scorer: type[Scorer]

    def __init__(self, *args: Any, width: int = 64, hidden: int = 64, **kwargs: Any) -> None:
        self._width, self._hidden = width, hidden
        kwargs.setdefault("features_extractor_class", self.encoder)
        kwargs.setdefault("features_extractor_kwargs", {"width": width})
        super().__init__(*args, **kwargs)

    def _build_mlp_extractor(self) -> None:
        assert isinstance(self.action_space, spaces.Discrete)
        self.mlp_extractor = self.scorer(self._width, int(self.action_space.n), self._hidden)

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        self.action_net = nn.Identity()  # the scorer's output already is one logit per choice
        with torch.no_grad():  # start close to uniform over the legal choices
            for head in self.mlp_extractor.heads():
                head[-1].weight.mul_(0.01 / np.sqrt(2.0))
        self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)

    def scores(self, observations: dict[str, Tensor]) -> Tensor:
        """Logits of all choices, legal or not: (B, K) goals, or (B, K + 1) branches; K is that of the observations."""
        return self.mlp_extractor.forward_actor(self.extract_features(observations))

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return super()._get_constructor_parameters() | {"width": self._width, "hidden": self._hidden}


class GoalPolicy(ScoringPolicy):
    """Chooses goals."""

    encoder, scorer = SituationEncoder, Scorer


class BranchPolicy(ScoringPolicy):
    """Chooses branches of the interpretation tree."""

    encoder, scorer = PathEncoder, BranchScorer
