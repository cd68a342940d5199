"""The number of hypotheses under locality, equation 9.22, against a count of them one by one.

A hypothesis decides each of m measurements: paired with a feature, or `*`. With locality, all pairings after the first
one take their features from L(j), the locality of the first one's feature j. If the first pairing is that of
measurement t, there are n choices for it and c + 1 for each of the m − t that follow, where c = |L(j)|, so

    N_h = n (c + 1)^(m−1) + … + n + 1 = n ((c + 1)^m − 1) / c + 1.                                            (9.22)

What makes this exact: j itself counts in c, and a feature may serve two measurements, as in the (n + 1)^m of the
unrestricted tree, which is the case c = n. Where the localities differ in size, N_h = 1 + Σ_j ((|L(j)| + 1)^m − 1) /
|L(j)|, and (9.22) with c = max |L(j)| bounds it from above. It is convex in c: with the *mean* size it is no bound, but
lies below.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.locality import covisible, locality_sizes, same_local_map, within
from slam_gym.types import UNPAIRED, IntArray, Locality

_LARGEST = 5  # features and measurements of the trees that are enumerated


def bound(n: int, m: int, c: float) -> float:
    """Equation 9.22 for n features, m measurements and localities of c ≥ 1 features; c may be a mean."""
    return float(n * ((c + 1.0) ** m - 1.0) / c + 1.0)


def exact_bound(n: int, m: int, c: int) -> int:
    """Equation 9.22 in integers, by its sum: n (c+1)^(m−1) + … + n + 1. Raises ValueError for a negative argument."""
    if min(n, m, c) < 0:
        raise ValueError(f"n, m, c: {n}, {m}, {c}: negative")
    return 1 + sum(n * int((c + 1) ** level) for level in range(m))


def hypotheses(sizes: IntArray, m: int) -> float:
    """N_h = 1 + Σ_j ((|L(j)| + 1)^m − 1) / |L(j)| for localities of these sizes (n,), each at least 1."""
    c = np.asarray(sizes, dtype=np.float64)
    return float(1.0 + (((c + 1.0) ** m - 1.0) / c).sum())


def enumerate_hypotheses(n: int, m: int, locality: Locality | None, *, each_once: bool = False) -> int:
    """Hypotheses of the whole tree, counted one by one: no formula, no constraint, no bound.

    With `each_once` no feature is given to two measurements of a hypothesis.
    """
    everything = list(range(n))

    def count(path: list[int]) -> int:
        if len(path) == m:
            return 1
        taken = [feature for feature in path if feature != UNPAIRED]
        choices = everything if locality is None or not taken else locality.of(taken[0]).tolist()
        below = count([*path, UNPAIRED])
        return below + sum(count([*path, feature]) for feature in choices if not (each_once and feature in taken))

    return count([])


class SmallMap(NamedTuple):
    """A small map and its localities."""

    name: str
    n: int
    locality: Locality | None


def small_maps(rng: np.random.Generator) -> list[SmallMap]:
    """Localities of one size (all, itself only, local maps, a ring) and of several (a random covisibility graph)."""
    maps = [SmallMap("everything", n, None) for n in (1, 3, _LARGEST)]
    maps.append(SmallMap("itself only", 4, same_local_map(np.arange(4))))
    maps.append(SmallMap("2 local maps of 2", 4, same_local_map([0, 0, 1, 1])))
    maps.append(SmallMap("2 local maps of 3", 6, same_local_map([0, 0, 0, 1, 1, 1])))
    angles = 2.0 * np.pi * np.arange(6) / 6
    maps.append(SmallMap("ring, next of kin", 6, within(np.column_stack([np.cos(angles), np.sin(angles)]), 1.1)))
    for n in (4, _LARGEST, _LARGEST):
        graph = CovisibilityGraph()
        graph.add(n)
        graph.see_together(np.sort(rng.permutation(n)[:3]))
        graph.see_together(np.sort(rng.permutation(n)[:2]))
        maps.append(SmallMap("covisibility, random", n, covisible(graph)))
    return maps


def verify(
    rng: np.random.Generator, measurements: Sequence[int] = tuple(range(1, _LARGEST + 1))
) -> list[dict[str, object]]:
    """Each map at each m: counted, by the sum over features, and by (9.22) with the mean and the largest c."""
    return [verify_one(small, m) for small in small_maps(rng) for m in measurements]


def verify_one(small: SmallMap, m: int) -> dict[str, object]:
    """One row of the table."""
    sizes = locality_sizes(small.locality, small.n)
    counted, largest = enumerate_hypotheses(small.n, m, small.locality), exact_bound(small.n, m, int(sizes.max()))
    by_sum = 1 + sum(Fraction((int(c) + 1) ** m - 1, int(c)) for c in sizes)
    of_one_size = sizes.min() == sizes.max()
    return {
        "locality": small.name,
        "n": small.n,
        "m": m,
        "min c": int(sizes.min()),
        "max c": int(sizes.max()),
        "counted": counted,
        "sum over features": int(by_sum),
        "9.22, max c": largest,
        "9.22, mean c": bound(small.n, m, float(sizes.mean())),
        "(n+1)^m": (small.n + 1) ** m,
        "each feature once": enumerate_hypotheses(small.n, m, small.locality, each_once=True),
        "holds": counted == by_sum and (counted == largest if of_one_size else counted <= largest),
    }
