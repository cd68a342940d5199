"""The associators of an evaluation, and their effort."""

import hashlib
import math
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agents.evaluation.records import Record
from slam_gym.association import resolve_associator, resolve_relocator
from slam_gym.association.prediction import Associator
from slam_gym.simulation.judged import CEILING

SIMPLEST_FIRST = (
    "nearest_neighbour", "global_nearest_neighbour", "singles", "one_point_ransac", "jcbb", "ipjc", "map_hypothesis",
    "marginal", "ppo", "learned",
)  # fmt: skip
SHIPPED = (*SIMPLEST_FIRST, CEILING)
"""The shipped associators in the order of tables, from the simplest to the truth."""
JOIN = " + "
"""Separates the associator and the relocation search in the name of a contender."""


def contenders(associators: Sequence[str], relocations: Sequence[str | None]) -> dict[str, tuple[str, str | None]]:
    """Name → (associator, relocation search), for every combination of the two.

    Raises ValueError for an unknown associator or relocator.
    """
    for name in associators:
        resolve_associator(name)
    for search in filter(None, relocations):
        resolve_relocator(search)
    several = len(relocations) > 1
    return {
        f"{name}{JOIN}{search}" if search and several else name: (name, search)
        for name in associators for search in relocations
    }  # fmt: skip


def hashes_of(*names: str | None) -> dict[str, dict[str, Any]]:
    """The SHA-256 of the file behind each name of an associator, search, driver, model or world, for results.json: that
    of the module of `module:name`, and none of what ships with the package."""
    files = {name: file for name in names if name and (file := _file_of(name))}
    return {name: {"sha256": hashlib.sha256(file.read_bytes()).hexdigest()} for name, file in files.items()}


def _file_of(name: str) -> Path | None:
    """The file of that name, or with that module, which is not imported."""
    module, colon, _ = name.partition(":")
    *packages, last = module.split(".")
    files = (*packages, last, "__init__.py"), (*packages, f"{last}.py")
    places = [Path(folder, *file) for folder in sys.path for file in files] if colon else [Path(name)]
    return next(filter(Path.is_file, places), None)


class Metered:
    """An associator or a relocator that records the effort of its calls since the last `reset`."""

    is_checked = True  # a resolved function checks its answers already

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self.reset()

    def reset(self) -> None:
        self.calls: list[tuple[int, float, bool]] = []  # nodes, seconds, whether the search reached its limit

    def __call__(self, *arguments: Any) -> Any:
        start = time.perf_counter()
        answer = self._function(*arguments)
        self.calls.append((answer.effort.nodes, time.perf_counter() - start, answer.effort.limit_hit))
        return answer

    def effort(self) -> Record:
        """Mean nodes, median time (which excludes compilation in the first call), and limits; NaN without calls."""
        nodes, seconds, limits = np.array(self.calls, float).reshape(-1, 3).T
        if not len(nodes):
            return dict.fromkeys(("nodes", "microseconds", "limits"), math.nan)
        return {"nodes": nodes.mean(), "microseconds": 1e6 * np.median(seconds), "limits": limits.sum()}


def metered(associator: str) -> tuple[Metered, Associator | str]:
    """A meter, and the associator to use: the metered one, or the name `true_association`, which cannot be wrapped, so
    that its meter stays empty."""
    meter = Metered(resolve_associator(associator))
    return meter, CEILING if associator == CEILING else meter
