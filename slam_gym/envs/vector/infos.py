"""Infos of many worlds as arrays, in Gymnasium's convention: beside every `key`, `_key` tells which worlds have it.

An info that is made as the first one was goes through memory that all processes share; any other, such as the last of
an episode, which tells more, is sent as it is.
"""

from __future__ import annotations

import mmap
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_gym.envs.vector.buffers import ALIGNED
from slam_gym.types import BoolArray

Infos = dict[str, Any]
Info = dict[str, Any]


class Leaf(NamedTuple):
    """A value of an info: where those of all worlds lie in the block."""

    of: type[Any]  # the value's
    shape: tuple[int, ...]
    kind: str  # its type in an array
    at: int  # first byte


class InfoLayout(NamedTuple):
    """Where each value lies; the block begins with a flag for each world: whether its info is there."""

    worlds: int  # how many
    leaves: dict[str, Any]  # as the info has them, by key: a `Leaf`, or a dictionary of such
    size: int  # bytes

    @classmethod
    def of(cls, info: Info, count: int) -> InfoLayout | None:
        """For infos like this one; None where one of its values is neither a number nor an array of numbers."""
        size = _aligned(count)

        def placed(info: Info) -> dict[str, Any]:
            nonlocal size
            found: dict[str, Any] = {}
            for key, value in info.items():
                if isinstance(value, dict):
                    found[key] = placed(value)
                    continue
                array = _empty(value, count)
                if array.dtype == object:
                    raise _NotPlainError
                found[key] = Leaf(type(value), array.shape[1:], array.dtype.str, size)
                size += _aligned(array.nbytes)
            return found

        try:
            leaves = placed(info)
        except _NotPlainError:
            return None
        return cls(count, leaves, size)


class SharedInfos:
    """The infos of all worlds in a block of memory, into which whoever steps a world writes."""

    def __init__(self, layout: InfoLayout, block: bytearray | mmap.mmap) -> None:
        self._layout = layout
        self._block: NDArray[np.uint8] = np.frombuffer(block, np.uint8)[: layout.size]
        self.there: BoolArray = self._block[: layout.worlds].view(np.bool_)  # which worlds' infos are in the block
        self._leaves = _views(layout.leaves, layout.worlds, self._block)

    def write(self, info: Info, world: int) -> bool:
        """Enter the info of a world, if it is made as the layout has it; returns whether it is."""
        there = _written(self._layout.leaves, self._leaves, info, world)
        self.there[world] = there
        return there

    def read(self) -> Infos:
        """A copy of what is there."""
        there = self.there.copy()
        if not there.any():
            return {}
        infos = _copied(self._leaves, there)
        if not there.all():
            _clear(infos, ~there)
        return infos


class _NotPlainError(Exception):
    """A value that no array of numbers holds."""


def _aligned(size: int) -> int:
    return -(-size // ALIGNED) * ALIGNED


def _views(leaves: Mapping[str, Any], count: int, block: NDArray[np.uint8]) -> Infos:
    """The arrays (count, …) in a block."""
    return {
        key: np.ndarray((count, *leaf.shape), leaf.kind, block, leaf.at)
        if isinstance(leaf, Leaf)
        else _views(leaf, count, block)
        for key, leaf in leaves.items()
    }


def _written(leaves: Mapping[str, Any], arrays: Infos, info: Info, world: int) -> bool:
    """Write an info as far as it is like the leaves; returns whether it was all of it."""
    if len(info) != len(leaves):
        return False
    for key, leaf in leaves.items():
        value, array = info.get(key), arrays[key]
        if not isinstance(leaf, Leaf):
            if not isinstance(value, dict) or not _written(leaf, array, value, world):
                return False
            continue
        if type(value) is not leaf.of:
            return False
        if isinstance(value, np.ndarray) and (value.shape != leaf.shape or value.dtype != array.dtype):
            return False
        array[world] = value
    return True


def _copied(arrays: Infos, there: BoolArray) -> Infos:
    """The arrays, and beside every key which worlds have it."""
    infos: Infos = {}
    for key, array in arrays.items():
        infos[key] = _copied(array, there) if isinstance(array, dict) else array.copy()
        infos[f"_{key}"] = there.copy()
    return infos


def _clear(infos: Infos, which: BoolArray) -> None:
    """Zeros for some worlds, as Gymnasium has them where nothing is told."""
    for key, value in infos.items():
        if isinstance(value, dict):
            _clear(value, which)
        elif not key.startswith("_"):
            value[which] = 0


def enter(infos: Infos, info: Info, world: int, count: int) -> None:
    """Enter the info of one of `count` worlds. The first world that has a key decides its type and shape."""
    for key, value in info.items():
        mask = infos.get(f"_{key}")
        if isinstance(value, dict) and key != "final_obs":
            array = infos.setdefault(key, {})
            enter(array, value, world, count)
        else:
            array = infos.get(key)
            if array is None:
                array = infos[key] = _empty("object" if key == "final_obs" else value, count)
            array[world] = value
        if mask is None:
            mask = infos[f"_{key}"] = np.zeros(count, np.bool_)
        mask[world] = True


def _empty(value: Any, count: int) -> NDArray[Any]:
    """An array (count, …) for values like this one."""
    if type(value) in (int, float, bool) or isinstance(value, np.number):
        return np.zeros(count, type(value))
    if isinstance(value, np.ndarray):
        return np.zeros((count, *value.shape), value.dtype)
    return np.full(count, None, object)


def plainest(infos: Sequence[Info]) -> Info:
    """The one with the fewest keys: the last of an episode tells more than others."""
    return min(infos, key=len)
