"""The arrays that all worlds of a vector write into: one block of memory, which worker processes map as well."""

from __future__ import annotations

import mmap
import os
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from slam_gym.types import Array, BoolArray

ALIGNED = 64  # bytes: every array begins on a cache line of its own
_MEMORY = Path("/dev/shm")  # files here never reach a disk


class Buffers(NamedTuple):
    """What the N worlds of a vector are told and hand out, a row for each."""

    actions: NDArray[np.int64] | Array  # (N,) whole numbers, or (N, d) float64, which holds a float32 exactly
    rewards: Array  # (N,)
    terminated: BoolArray  # (N,)
    truncated: BoolArray  # (N,)
    observations: dict[str, NDArray[np.generic]]  # (N, …) of each part of the observation

    def of(self, rows: range) -> Buffers:
        """The same memory, of some rows."""
        of_rows = slice(rows.start, rows.stop)
        actions, rewards, terminated, truncated, observations = self
        of_worlds = {name: part[of_rows] for name, part in observations.items()}
        return Buffers(actions[of_rows], rewards[of_rows], terminated[of_rows], truncated[of_rows], of_worlds)


class Layout(NamedTuple):
    """Where each array lies in the block."""

    places: tuple[tuple[str, int, tuple[int, ...], str], ...]  # name, first byte, shape, type
    size: int  # bytes

    @classmethod
    def of(cls, observation: spaces.Dict, action: spaces.Space[object], count: int) -> Layout:
        """For `count` worlds with these spaces."""
        acting: tuple[tuple[int, ...], str] = ((), "i8") if isinstance(action, spaces.Discrete) else ((2,), "f8")
        parts = {"actions": acting, "rewards": ((), "f8"), "terminated": ((), "?"), "truncated": ((), "?")}
        for name, box in observation.spaces.items():
            assert isinstance(box, spaces.Box)
            parts[name] = (box.shape, box.dtype.str)
        places, at = [], 0
        for name, (shape, kind) in parts.items():
            whole = (count, *shape)
            places.append((name, at, whole, kind))
            used = int(np.prod(whole)) * np.dtype(kind).itemsize
            at += -(-used // ALIGNED) * ALIGNED
        return cls(tuple(places), at)

    def buffers(self, block: bytearray | mmap.mmap) -> Buffers:
        """The arrays in a block of memory of this size."""
        arrays: dict[str, Any] = {name: np.ndarray(shape, kind, block, at) for name, at, shape, kind in self.places}
        actions, rewards, terminated, truncated = (arrays.pop(name) for name in Buffers._fields[:-1])
        return Buffers(actions, rewards, terminated, truncated, arrays)


class SharedBlock:
    """A block of memory that other processes open by the path of its file."""

    def __init__(self, size: int) -> None:
        folders = [_MEMORY, Path(tempfile.gettempdir())]
        for folder in folders:
            try:
                handle, name = tempfile.mkstemp(prefix="slam_gym-", dir=folder)
            except OSError:
                if folder is folders[-1]:
                    raise
                continue
            self.path = Path(name)
            try:
                with os.fdopen(handle, "r+b") as file:
                    file.write(bytes(size))  # all of it: a folder that is full says so now
                    file.flush()
                    self.memory = mmap.mmap(file.fileno(), size)
                return
            except OSError:
                self.forget()
                if folder is folders[-1]:
                    raise

    def forget(self) -> None:
        """Remove the file, once all have opened it; the memory lives as long as somebody maps it."""
        try:
            self.path.unlink(missing_ok=True)
        except PermissionError:  # Windows keeps files that are mapped; its temporary folder is cleaned by others
            return


def opened(path: Path, size: int) -> mmap.mmap:
    """The block of another process."""
    with path.open("r+b") as file:
        return mmap.mmap(file.fileno(), size)
