"""The driver's network while it learns: attention between goals, a score for each that is added to the greedy one.

`agents.drivers.goal_network` runs the same arithmetic on plain arrays; a test holds one against the other.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from agents.drivers.goal_network import Arrays, Size
from agents.drivers.goal_tokens import TOKEN_FIELDS


class Block(nn.Module):
    """Every goal looks at all legal ones, nearer ones more or less so, and then thinks for itself."""

    def __init__(self, size: Size) -> None:
        super().__init__()
        self.heads = size.heads
        self.before, self.between = nn.LayerNorm(size.width), nn.LayerNorm(size.width)
        self.attend = nn.Linear(size.width, 3 * size.width)
        self.mix = nn.Linear(size.width, size.width)
        self.nearness = nn.Parameter(torch.linspace(0.0, 1.0, size.heads))
        self.wide, self.narrow = nn.Linear(size.width, 2 * size.width), nn.Linear(2 * size.width, size.width)

    def forward(self, x: Tensor, gaps: Tensor, legal: Tensor) -> Tensor:
        batch, goals, width = x.shape
        q, k, v = self.attend(self.before(x)).reshape(batch, goals, 3, self.heads, -1).permute(2, 0, 3, 1, 4)
        match = q @ k.transpose(-1, -2) / (width / self.heads) ** 0.5
        match = match - self.nearness[:, None, None] * gaps[:, None]
        share = match.masked_fill(~legal[:, None, None, :], -1e9).softmax(dim=-1)
        x = x + self.mix((share @ v).transpose(1, 2).reshape(batch, goals, width))
        return x + self.narrow(torch.relu(self.wide(self.between(x))))


class GoalNetwork(nn.Module):
    """Tokens (b, k, f), gaps (b, k, k) between goals, greedy scores (b, k) → scores (b, k), −1e9 where not legal."""

    def __init__(self, size: Size) -> None:
        super().__init__()
        self.size = size
        self.embed = nn.Linear(len(TOKEN_FIELDS), size.width)
        self.blocks = nn.ModuleList(Block(size) for _ in range(size.layers))
        self.last = nn.LayerNorm(size.width)
        self.score = nn.Linear(size.width, 1)
        self.greed = nn.Parameter(torch.tensor(3.0))
        self.register_buffer("shift", torch.zeros(len(TOKEN_FIELDS)))
        self.register_buffer("scale", torch.ones(len(TOKEN_FIELDS)))
        nn.init.zeros_(self.score.weight)  # it begins as the greedy driver
        nn.init.zeros_(self.score.bias)

    def forward(self, tokens: Tensor, gaps: Tensor, greedy: Tensor, legal: Tensor) -> Tensor:
        x = self.embed((tokens - self.shift) * self.scale)
        for block in self.blocks:
            x = block(x, gaps, legal)
        scores = self.greed * greedy + self.score(self.last(x))[..., 0]
        return scores.masked_fill(~legal, -1e9)

    def arrays(self) -> Arrays:
        """The weights, by the names that `agents.drivers.goal_network` knows."""
        return {name: value.detach().numpy().astype(np.float32) for name, value in self.state_dict().items()}
