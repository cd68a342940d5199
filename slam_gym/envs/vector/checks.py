"""Arguments of a vector of worlds, checked: what is wrong is told with the world that it is wrong for."""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from slam_gym.types import BoolArray


def worker_count(asked: int | None, worlds: int) -> int:
    """How many processes; 0: none beside this one. Raises ValueError for anything but None and a whole number ≥ 0."""
    if asked is not None and not (isinstance(asked, int) and asked >= 0):
        raise ValueError(f"workers={asked!r}: expected None or a whole number >= 0")
    if asked is None:
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        asked = cores if min(cores, worlds) > 1 else 0
    return min(asked, worlds)


def shared_out(worlds: int, groups: int) -> list[range]:
    """The worlds 0 … N−1 in so many groups of about the same size."""
    edges = [k * worlds // groups for k in range(groups + 1)]
    return [range(first, last) for first, last in itertools.pairwise(edges)]


def seeds_of(seed: int | Sequence[int | None] | None, worlds: int) -> list[int | None]:
    """The seed of each world: that of world i is i more than that of world 0, where only one is given."""
    if seed is None:
        return [None] * worlds
    return (
        [int(seed) + i for i in range(worlds)] if isinstance(seed, int | np.integer) else one_each("seed", seed, worlds)
    )


def options_of(options: dict[str, Any], worlds: int) -> list[dict[str, Any]]:
    """The reset options of each world: `world` may be a sequence with one for each."""
    chosen = options.get("world")
    if not isinstance(chosen, list | tuple | np.ndarray):
        return [options] * worlds
    return [{**options, "world": world} for world in one_each("options['world']", chosen, worlds)]


def one_each(name: str, values: Any, worlds: int) -> list[Any]:
    """The values as a list. Raises ValueError where there is not one for each world."""
    found = list(values)
    if len(found) != worlds:
        raise ValueError(f"{name}: {len(found)} values for {worlds} worlds")
    return found


def reset_mask(mask: Any, worlds: int) -> BoolArray:
    """Which worlds are reset: all, where there is no mask."""
    if mask is None:
        return np.ones(worlds, np.bool_)
    given = np.asarray(mask)
    if given.shape != (worlds,) or given.dtype != np.bool_ or not given.any():
        raise ValueError(f"options['reset_mask']={mask!r}: expected {worlds} flags (bool), at least one of them true")
    return given


def checked_actions(
    actions: Any, like: NDArray[Any], space: spaces.Space[Any], ignored: BoolArray | None = None
) -> NDArray[Any]:
    """Actions for all worlds in an array `like` that of the buffers. Raises ValueError for one outside its space, but
    for the worlds whose action is `ignored`."""
    given = np.asarray(actions)
    if given.shape != like.shape or given.dtype.kind not in ("iu" if like.dtype.kind == "i" else "iuf"):
        kind = "whole numbers" if like.dtype.kind == "i" else "numbers"
        raise ValueError(f"actions {actions!r}: expected {kind} of shape {like.shape}, a row for each world")
    if isinstance(space, spaces.Discrete):
        right, said = (given >= 0) & (given < space.n), f"is not one of 0 … {space.n - 1}"
    else:
        right, said = (given >= -1.0) & (given <= 1.0), "is not two fractions (forward, turn) in [−1, 1]"
    if right.all():
        return given
    excused = right.reshape(len(given), -1).all(axis=1)
    if ignored is not None:
        excused |= ignored
    if not excused.all():
        world = int(np.argmin(excused))
        raise ValueError(f"world {world}: action {given[world]} {said}")
    return given
