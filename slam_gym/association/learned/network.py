"""The network behind the learned log odds, as plain loops over plain arrays: no learning library is needed to run it.

With x_c the inputs of pairing c, centred, scaled and kept within ±2.5, and the greatest over the pairings of a
measurement, or of a feature,

    h_c = max(0, A x_c + a),   g_c = (h_c, max of h over the rivals of its measurement, over those of its feature),
    odds_c = wᵀx_c + vᵀ max(0, B g_c + b) + w₀.

A pairing is judged beside its rivals: that is all the attention that it took. Where an input lies farther than ±2.5
from the centre nobody has trained: each such input halves the odds, so that the model decides where little is like it.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slam_gym._compile import compiled
from slam_gym.types import Array, IntArray
from slam_gym.weights import load

FARTHEST = 2.5  # [scales] of an input from the centre; what lies beyond counts as so far, and halves the odds


class Network(NamedTuple):
    """The weights, for n inputs and h hidden numbers; without hidden ones it is a logistic model."""

    centre: Array  # (n,)
    scale: Array  # (n,)
    linear: Array  # (n,) w
    offset: Array  # (1,) w₀
    first: Array  # (h, n) A
    first_offset: Array  # (h,) a
    second: Array  # (h, 3h) B
    second_offset: Array  # (h,) b
    last: Array  # (h,) v


@functools.cache
def load_network(weights: str | Path, version: int, inputs: tuple[str, ...]) -> Network:
    """The network by weights that ship, or by a `.npz` of one's own, for inputs of that version. Raises ValueError as
    `slam_gym.weights.load`."""
    found = load(weights, version, inputs, shapes_for(len(inputs)))
    return network_of({name: np.asarray(array) for name, array in found.arrays.items()})


def shapes_for(inputs: int) -> dict[str, tuple[int, ...]]:
    """The shape of each array, −1 standing for the number of hidden numbers or three times that."""
    n, h = inputs, -1
    return {
        "centre": (n,), "scale": (n,), "linear": (n,), "offset": (1,), "first": (h, n), "first_offset": (h,),
        "second": (h, h), "second_offset": (h,), "last": (h,),
    }  # fmt: skip


def network_of(arrays: dict[str, Array]) -> Network:
    """From arrays of those shapes. Raises ValueError where their hidden numbers are not as many everywhere."""
    network = Network(**{name: np.array(arrays[name], np.float64, order="C") for name in Network._fields})
    h = len(network.last)
    if not len(network.first) == len(network.first_offset) == len(network.second) == len(network.second_offset) == h:
        raise ValueError(f"first, second, last: not {h} hidden numbers everywhere")
    if network.second.shape[1] != 3 * h:
        raise ValueError(f"second: {network.second.shape[1]} columns, expected {3 * h}")
    if not (network.scale > 0.0).all():
        raise ValueError("scale: not positive")
    return network


@compiled
def log_odds(network: Network, inputs: Array, measured: IntArray, slots: IntArray) -> Array:
    """(c,) of pairings of measurements `measured` (c,) with features `slots` (c,)."""
    count, h = len(inputs), len(network.last)
    given = (inputs - network.centre) / network.scale
    x = np.minimum(np.maximum(given, -FARTHEST), FARTHEST)
    out, trust = np.full(count, network.offset[0]), np.ones(count)
    for c in range(count):
        for n in range(x.shape[1]):
            out[c] += network.linear[n] * x[c, n]
            trust[c] *= 1.0 if x[c, n] == given[c, n] else 0.5
    if h == 0 or count == 0:
        out *= trust
        return out
    own = np.zeros((count, h))
    of_measurement, of_feature = np.zeros((measured.max() + 1, h)), np.zeros((slots.max() + 1, h))
    for c in range(count):
        for k in range(h):
            total = network.first_offset[k]
            for n in range(x.shape[1]):
                total += network.first[k, n] * x[c, n]
            own[c, k] = max(total, 0.0)
            of_measurement[measured[c], k] = max(of_measurement[measured[c], k], own[c, k])
            of_feature[slots[c], k] = max(of_feature[slots[c], k], own[c, k])
    for c in range(count):
        mine, others = of_measurement[measured[c]], of_feature[slots[c]]
        for k in range(h):
            total = network.second_offset[k]
            for n in range(h):
                total += network.second[k, n] * own[c, n]
                total += network.second[k, h + n] * mine[n] + network.second[k, 2 * h + n] * others[n]
            out[c] += network.last[k] * max(total, 0.0)
    out *= trust
    return out
