"""Who associates in an evaluation, and what that takes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from agents.evaluation.records import Record
from slam_gym.association import ASSOCIATORS, resolve_associator, resolve_relocator
from slam_gym.association.prediction import Associator
from slam_gym.association.tracking.ppo import walk_by
from slam_gym.simulation.judged import CEILING

SIMPLEST_FIRST = (
    "nearest_neighbour", "global_nearest_neighbour", "singles", "one_point_ransac", "jcbb", "ipjc", "map_hypothesis",
    "marginal", "ppo", "learned",
)  # fmt: skip
SHIPPED = (*SIMPLEST_FIRST, CEILING)
"""The associators that ship, in the order of tables: from the simplest to the truth."""
JOIN = " + "
"""Between an associator and the search that finds a lost robot for it, in the name of what was evaluated."""


@lru_cache
def find_associator(name: str) -> Associator:
    """An associator by name, `module:function`, or the weights of a trained one. ValueError lists the known names."""
    if Path(name).suffix == ".npz":
        return walk_by(name)
    return resolve_associator(name)


def contenders(associators: Sequence[str], relocations: Sequence[str | None]) -> dict[str, tuple[str, str | None]]:
    """Name → associator and the search that finds a lost robot for it: each with each.

    ValueError for an associator or a relocator that nobody knows.
    """
    for name in associators:
        find_associator(name)
    for search in filter(None, relocations):
        resolve_relocator(search)
    several = len(relocations) > 1
    return {
        f"{name}{JOIN}{search}" if search and several else name: (name, search)
        for name in associators for search in relocations
    }  # fmt: skip


class Metered:
    """An associator or a relocator, and what its calls take since the last `reset`."""

    def __init__(self, ask: Callable[..., Any]) -> None:
        self._ask = ask
        self.reset()

    def reset(self) -> None:
        self.nodes: list[int] = []
        self.seconds: list[float] = []
        self.limits = 0  # calls that met the limit of their search

    def __call__(self, *question: Any) -> Any:
        start = time.perf_counter()
        answer = self._ask(*question)
        self.seconds.append(time.perf_counter() - start)
        self.nodes.append(answer.effort.nodes)
        self.limits += answer.effort.limit_hit
        return answer

    def effort(self) -> Record:
        """Means a scan; of the time the median, which does not see the first call being compiled. NaN without calls."""
        if not self.seconds:
            return dict.fromkeys(("nodes", "microseconds", "limits"), math.nan)
        return {
            "nodes": float(np.mean(self.nodes)),
            "microseconds": 1e6 * float(np.median(self.seconds)),
            "limits": self.limits,
        }


def metered(associator: str | Associator) -> tuple[Metered, Associator | str]:
    """A meter, and what to associate with: the metered associator, or the name of the one that is told the truth,
    which nothing may stand in for and whose meter stays empty."""
    if associator == CEILING:
        return Metered(ASSOCIATORS[CEILING]), CEILING
    meter = Metered(find_associator(associator) if isinstance(associator, str) else associator)
    return meter, meter
