"""The floor that every other agent has to beat."""

from __future__ import annotations

import numpy as np

from agents.drivers.base import ActionKind, Info, Observation, legal_goals


class RandomAgent:
    """One of the legal goals, uniformly."""

    name = "random"
    action: ActionKind = "goal"

    def __init__(self) -> None:
        self.reset(0)

    def reset(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)

    def act(self, observation: Observation, info: Info) -> int:
        return int(self._rng.choice(np.flatnonzero(legal_goals(info))))
