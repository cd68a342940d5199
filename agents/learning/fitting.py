"""Fitting a network to examples: the one loop by which the learned driver and the learned associator are trained."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor, nn

T = TypeVar("T")

_DECAY, _LARGEST = 1e-2, 1.0  # of the weights, in each step; norm of the gradient


def fit(
    parameters: Sequence[Tensor],
    batches: Sequence[T],
    loss: Callable[[T], Tensor],
    judge: Callable[[], float],
    epochs: int,
    rate: float,
    rng: np.random.Generator,
) -> list[float]:
    """Lower the loss of the batches by AdamW; what `judge` says of the parameters after each epoch.

    The learning rate rises to `rate`, and falls to nothing (Smith and Topin's one cycle, 2019).
    """
    torch.set_num_threads(1)  # sums in one order, or the weights would depend on the number of cores
    optimizer = torch.optim.AdamW(parameters, lr=rate, weight_decay=_DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, rate, total_steps=epochs * len(batches))
    curve = []
    for _ in range(epochs):
        for k in rng.permutation(len(batches)).tolist():
            optimizer.zero_grad()
            loss(batches[k]).backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(parameters, _LARGEST)
            optimizer.step()
            schedule.step()
        with torch.no_grad():
            curve.append(judge())
    return curve
