"""Which places to see, in which order, before time is up: orienteering, by many greedy tours that chance varies."""

from __future__ import annotations

import numpy as np

from agents.drivers.true_views import Bits
from slam_gym._compile import compiled
from slam_gym.types import Array


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


Legs = tuple[Array, Bits]
"""How long ways take [ticks], to viewpoints (…, v), and what is seen on them, (…, v, w)."""


@compiled
def best_tour(start: Legs, between: Legs, left: float, seen: Bits, worth: Array, chance: Array, early: float) -> float:
    """What the best of some tours through viewpoints brings: the `worth` (n,) of new features, each of which counts up
    to `early` more the earlier it is seen.

    Legs lead from the `start` to each viewpoint, and `between` any two of them; `left` [ticks] is what is left, `seen`
    (w,) what is known. There are as many tours as rows of `chance` (tours, v).
    """
    best = 0.0
    for tour in range(chance.shape[0]):
        power = 0.6 + 0.2 * (tour % 4)
        best = max(best, _tour(start, between, left, seen.copy(), worth, chance[tour], power, early))
    return best


@compiled
def _tour(
    start: Legs, between: Legs, left: float, seen: Bits, worth: Array, chance: Array, power: float, early: float
) -> float:
    """A tour that goes on with the leg of the most gain / ticks^`power`, times the `chance` (v,) of its end."""
    (costs, views), (ticks, legs), rest, total = start, between, left, 0.0
    while True:
        chosen, top, found = -1, 0.0, 0.0
        for v in range(len(chance)):
            if costs[v] > rest:
                continue
            gain = gained(seen, views[v], worth)
            if gain > 0.0 and gain / costs[v] ** power * chance[v] > top:
                chosen, top, found = v, gain / costs[v] ** power * chance[v], gain
        if chosen < 0:
            return total
        rest -= costs[chosen]
        for w in range(len(seen)):
            seen[w] |= views[chosen, w]
        total += found * (1.0 + early * rest / max(left, 1.0))
        costs, views = ticks[chosen], legs[chosen]
