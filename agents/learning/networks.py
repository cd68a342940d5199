"""Policies for Stable-Baselines3 that score choices one by one: goals of Explore-v0, branches of Associate-v0.

Every choice passes through the same weights, together with the situation and a summary of all legal choices (Deep Sets,
Zaheer et al. 2017). So a permutation of the choices permutes their scores.
"""

from __future__ import annotations

from typing import Any

import torch
from gymnasium import spaces
from sb3_contrib.common.maskable.policies import MaskableMultiInputActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, CombinedExtractor
from torch import Tensor, nn

from slam_gym.association.tracking.observation import CANDIDATE_FIELDS
from slam_gym.envs.observation import GOAL_FIELDS

FIELDS = {"goals": GOAL_FIELDS, "candidates": CANDIDATE_FIELDS}
"""What stands in a row of each part of an observation that lists choices."""


class ChoiceExtractor(BaseFeaturesExtractor):
    """Observation → (B, width + K · F): the encoded situation, then the K choices as they are."""

    def __init__(self, observation_space: spaces.Dict, choices: str, width: int) -> None:
        super().__init__(observation_space, width + spaces.flatdim(observation_space[choices]))
        others = {name: space for name, space in observation_space.spaces.items() if name != choices}
        combined = CombinedExtractor(spaces.Dict(others), cnn_output_dim=width)
        self.choices = choices
        self.situation = nn.Sequential(combined, nn.Linear(combined.features_dim, width), nn.Tanh())

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        return torch.cat([self.situation(observations), observations[self.choices].flatten(1)], dim=1)


class ChoiceScorer(nn.Module):
    """The extractor's vector → a score per action (B, n) for the actor, and a latent (B, hidden) for the critic.

    Actions beyond the K choices, such as `*` of the interpretation tree, are rows that are legal and 0 otherwise.
    """

    def __init__(self, width: int, fields: tuple[str, ...], choices: int, actions: int, hidden: int) -> None:
        super().__init__()
        self.width, self.choices, self.legal = width, choices, fields.index("legal")
        self.latent_dim_pi, self.latent_dim_vf = actions, hidden
        further = torch.zeros(actions - choices, len(fields))
        further[:, self.legal] = 1.0
        self.register_buffer("further", further)
        self.embed = nn.Sequential(nn.Linear(len(fields), hidden), nn.Tanh(), nn.Linear(hidden, hidden), nn.Tanh())
        self.score = nn.Sequential(nn.Linear(2 * hidden + width, hidden), nn.Tanh(), nn.Linear(hidden, 1))
        self.value = nn.Sequential(nn.Linear(hidden + width, hidden), nn.Tanh())

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        return self.forward_actor(features), self.forward_critic(features)

    def forward_actor(self, features: Tensor) -> Tensor:
        embedded, shared = self._parts(features)
        each = shared.unsqueeze(1).expand(-1, embedded.shape[1], -1)
        return self.score(torch.cat([embedded, each], dim=2)).squeeze(2)

    def forward_critic(self, features: Tensor) -> Tensor:
        return self.value(self._parts(features)[1])

    def _parts(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Embedded choices (B, n, hidden); the situation and the mean of the legal ones (B, width + hidden)."""
        rows = features[:, self.width :].reshape(len(features), self.choices, -1)
        rows = torch.cat([rows, self.further.expand(len(rows), -1, -1)], dim=1)
        embedded, legal = self.embed(rows), rows[:, :, self.legal : self.legal + 1]
        summary = (embedded * legal).sum(1) / legal.sum(1).clamp(min=1.0)
        return embedded, torch.cat([features[:, : self.width], summary], dim=1)


class ChoicePolicy(MaskableMultiInputActorCriticPolicy):
    """Actor-critic for MaskablePPO whose logits are the scores of the choices that `choices` of the observation lists.

    `width` is that of the encoded situation, `hidden` that of the layers behind it.
    """

    def __init__(self, *args: Any, choices: str, width: int = 64, hidden: int = 64, **kwargs: Any) -> None:
        self._sizes = {"choices": choices, "width": width, "hidden": hidden}
        kwargs["features_extractor_class"] = ChoiceExtractor
        kwargs["features_extractor_kwargs"] = {"choices": choices, "width": width}
        super().__init__(*args, **kwargs)

    def _build_mlp_extractor(self) -> None:
        assert isinstance(self.action_space, spaces.Discrete) and isinstance(self.observation_space, spaces.Dict)
        choices, width, hidden = self._sizes.values()
        fields = FIELDS[choices]
        rows = spaces.flatdim(self.observation_space[choices]) // len(fields)
        self.mlp_extractor = ChoiceScorer(width, fields, rows, int(self.action_space.n), hidden)

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        self.action_net = nn.Identity()  # the scorer's output already is one logit per action
        nn.init.orthogonal_(self.mlp_extractor.score[-1].weight, 0.01)  # close to uniform over what is legal
        self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return super()._get_constructor_parameters() | self._sizes
