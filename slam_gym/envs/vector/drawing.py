"""Worlds drawn ahead: a process that draws the next world of each while their episodes run.

Which world comes next is known when an episode begins, and what a world is depends on its number alone. So it does not
matter whether it comes in time: where it does not, the worker draws the world itself, and the episode is the same.
"""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Iterable, Mapping
from pathlib import Path

from slam_gym.envs.vector.buffers import Layout
from slam_gym.envs.vector.worker import WorkerWorlds
from slam_gym.envs.vector.worlds import Making


class Drawing:
    """Draws worlds that were asked for, one after the other, in a process of low priority."""

    def __init__(self, making: Making, layout: Layout, block: Path) -> None:
        self._asked: queue.SimpleQueue[tuple[int, int] | None] = queue.SimpleQueue()
        self._ready: dict[int, tuple[int, bytes]] = {}
        self._worker = WorkerWorlds(making, range(1), layout, block, niceness=10)
        self._worker.answer()
        threading.Thread(target=self._draw, daemon=True, name="worlds drawn ahead").start()

    def ask(self, upcoming: Mapping[int, int]) -> None:
        """Draw, for each of these worlds of the vector, the one with that number in the split."""
        for world, number in upcoming.items():
            self._asked.put((world, number))

    def ready(self, rows: Iterable[int]) -> dict[int, tuple[int, bytes]]:
        """What has been drawn for these worlds of the vector, with its number; handed out once."""
        return {world: self._ready.pop(world) for world in rows if world in self._ready}

    def close(self) -> None:
        """End the process."""
        self._asked.put(None)
        self._worker.close()

    def _draw(self) -> None:
        with contextlib.suppress(RuntimeError, ValueError):  # the process has ended: then nothing is drawn ahead
            while (asked := self._asked.get()) is not None:
                world, number = asked
                self._worker.request("call", "draw", (number,), {}, range(1))
                self._ready[world] = number, self._worker.answer()[0]
