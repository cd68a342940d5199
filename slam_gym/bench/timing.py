"""The one way in which benchmarks take time: in microseconds, by the clock or by the processor.

A single call is `timed`; of one that can be repeated, `fastest` gives the least time, since whatever else the machine
does only adds; calls that are to be compared with each other take turns (`medians_in_turns`), so that whatever else the
machine does falls on all of them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

T = TypeVar("T")

Clock = Callable[[], int]
"""Nanoseconds since whenever."""

WALL: Clock = time.perf_counter_ns
THREAD: Clock = time.thread_time_ns  # processor time of this thread
PROCESS: Clock = time.process_time_ns  # processor time of all threads


class Timed(NamedTuple, Generic[T]):
    """What a call returned, and how long it took."""

    answer: T
    microseconds: float


def timed(call: Callable[..., T], *arguments: Any, clock: Clock = WALL) -> Timed[T]:
    """One call."""
    start = clock()
    answer = call(*arguments)
    return Timed(answer, 1e-3 * (clock() - start))


def fastest(call: Callable[..., object], *arguments: Any, repeats: int = 5, clock: Clock = WALL) -> float:
    """Least time [µs] of so many calls."""
    return min(timed(call, *arguments, clock=clock).microseconds for _ in range(repeats))


def medians_in_turns(calls: Mapping[str, Callable[[int], object]], rounds: int, warm_up: int) -> dict[str, float]:
    """Median time [µs] of each call. In round k = 0, 1, … each is called once with k; the first `warm_up` count not."""
    times = {name: np.empty(warm_up + rounds) for name in calls}
    for k in range(warm_up + rounds):
        for name, call in calls.items():
            times[name][k] = timed(call, k).microseconds
    return {name: float(np.median(taken[warm_up:])) for name, taken in times.items()}
