"""A policy for Associate-v0 that scores the branches of the interpretation tree one by one.

Every candidate passes through the same weights, together with the path so far and a summary of all legal candidates;
`*` has a score of its own from the same two. So K may change after training. The budget is not looked at, so that the
policy decides in the environment as it does as an associator elsewhere.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from sb3_contrib.common.maskable.policies import MaskableMultiInputActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn

from agents.learning.networks import GoalScorer
from slam_gym.association.tracking.observation import CANDIDATE_FIELDS

_CONTEXT = ("measurement", "pairings", "path")


class PathEncoder(BaseFeaturesExtractor):
    """Observation → one vector (B, width + K·F): measurement and path, encoded, then the candidates as they are."""

    def __init__(self, observation_space: spaces.Dict, width: int = 64) -> None:
        super().__init__(observation_space, features_dim=width + spaces.flatdim(observation_space["candidates"]))
        length = sum(spaces.flatdim(observation_space[key]) for key in _CONTEXT)
        self.context = nn.Sequential(nn.Linear(length, width), nn.Tanh(), nn.Linear(width, width), nn.Tanh())

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        context = self.context(torch.cat([observations[key] for key in _CONTEXT], dim=1))
        return torch.cat([context, observations["candidates"]], dim=1)


class BranchScorer(GoalScorer):
    """The encoder's vector → a score per branch (B, K + 1), `*` last, and a latent (B, hidden) for the critic."""

    def __init__(self, width: int, branches: int, hidden: int) -> None:
        super().__init__(width, branches, hidden, fields=len(CANDIDATE_FIELDS))
        self.refuse = nn.Sequential(nn.Linear(hidden + width, hidden), nn.Tanh(), nn.Linear(hidden, 1))

    def _scores(self, situation: Tensor, embedded: Tensor, summary: Tensor) -> Tensor:
        refusal = self.refuse(torch.cat([situation, summary], dim=1))
        return torch.cat([super()._scores(situation, embedded, summary), refusal], dim=1)


class BranchPolicy(MaskableMultiInputActorCriticPolicy):
    """Actor-critic for MaskablePPO. No weight's shape depends on K."""

    def __init__(self, *args: Any, width: int = 64, hidden: int = 64, **kwargs: Any) -> None:
        self._width, self._hidden = width, hidden
        kwargs.setdefault("features_extractor_class", PathEncoder)
        kwargs.setdefault("features_extractor_kwargs", {"width": width})
        super().__init__(*args, **kwargs)

    def _build_mlp_extractor(self) -> None:
        assert isinstance(self.action_space, spaces.Discrete)
        self.mlp_extractor = BranchScorer(self._width, int(self.action_space.n), self._hidden)

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        self.action_net = nn.Identity()  # the scorer's output already is one logit per branch
        with torch.no_grad():  # start close to uniform over the legal branches
            for head in (self.mlp_extractor.score, self.mlp_extractor.refuse):
                head[-1].weight.mul_(0.01 / np.sqrt(2.0))
        self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)

    def branch_scores(self, observations: dict[str, Tensor]) -> Tensor:
        """Logits (B, K + 1) of all branches, legal or not; K is that of the observations."""
        return self.mlp_extractor.forward_actor(self.extract_features(observations))

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return super()._get_constructor_parameters() | {"width": self._width, "hidden": self._hidden}
