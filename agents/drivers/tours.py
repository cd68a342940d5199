"""Which places to see, in which order, before time is up: orienteering, by many greedy tours that chance varies."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from slam_gym._compile import compiled
from slam_gym.types import Array

Bits = NDArray[np.uint64]


@compiled
def popcount(word: np.uint64) -> int:
    """How many bits of a word are set."""
    v = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    v = (v & np.uint64(0x3333333333333333)) + ((v >> np.uint64(2)) & np.uint64(0x3333333333333333))
    v = (v + (v >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return int((v * np.uint64(0x0101010101010101)) >> np.uint64(56))


@compiled
def gained(seen: Bits, more: Bits, worth: Array) -> float:
    """What the features of `more` (w,) that are not among those `seen` (w,) are `worth` (n,) together."""
    total, one = 0.0, np.uint64(1)
    for w in range(len(seen)):
        word = more[w] & ~seen[w]
        while word:
            lowest = word & (~word + one)
            total += worth[64 * w + popcount(lowest - one)]
            word ^= lowest
    return total


@compiled
def best_tour(
    first_ticks: Array, first_seen: Bits, ticks: Array, legs: Bits, left: float, seen: Bits, worth: Array, noise: Array,
    early: float,
) -> float:
    """What the best of some tours through viewpoints brings: features, each worth `early` more the earlier it is seen.

    `first_ticks` (v,), `first_seen` (v, w): legs from the start; `ticks` (v, v), `legs` (v, v, w): between viewpoints.
    `left` [ticks] is what is left, `seen` (w,) what is known. A tour takes the leg that gains most per tick, times
    exp(`noise` (tours, v)) of its end.
    """
    best, now, words = 0.0, np.empty_like(seen), len(seen)
    for tour in range(noise.shape[0]):
        now[:] = seen
        at, rest, total = -1, left, 0.0
        power = 0.6 + 0.2 * (tour % 4)
        while True:
            chosen, top, found = -1, 0.0, 0.0
            for v in range(noise.shape[1]):
                cost = first_ticks[v] if at < 0 else ticks[at, v]
                if cost > rest:
                    continue
                gain = gained(now, first_seen[v] if at < 0 else legs[at, v], worth)
                if gain <= 0.0:
                    continue
                score = gain / cost**power * noise[tour, v]
                if score > top:
                    chosen, top, found = v, score, gain
            if chosen < 0:
                break
            rest -= first_ticks[chosen] if at < 0 else ticks[at, chosen]
            more = first_seen[chosen] if at < 0 else legs[at, chosen]
            for w in range(words):
                now[w] |= more[w]
            total += found * (1.0 + early * rest / max(left, 1.0))
            at = chosen
        best = max(best, total)
    return best
