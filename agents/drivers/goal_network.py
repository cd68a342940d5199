"""A trained network of goals on plain arrays: what `agents.learning.driver` has learned, without torch."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.drivers.goal_tokens import TOKEN_FIELDS, Tokens, most_promising
from slam_gym.types import Array, BoolArray

Arrays = Mapping[str, NDArray[Any]]

GAP = 5.0  # [m] the unit of distances between goals
_EPSILON = 1e-5  # of the layer norms, as torch has it


class Size(NamedTuple):
    """Of the network; its number of goals is that of the observation."""

    width: int = 32
    heads: int = 4
    layers: int = 2
    members: int = 3  # networks that were trained alike, whose mean counts


def shapes(size: Size) -> dict[str, tuple[int, ...]]:
    """The arrays of a network of some size, of all members together."""
    w, fields = size.width, len(TOKEN_FIELDS)
    out: dict[str, tuple[int, ...]] = {
        "greed": (), "shift": (fields,), "scale": (fields,), "embed.weight": (w, fields), "embed.bias": (w,),
    }  # fmt: skip
    for i in range(size.layers):
        parts = {
            "nearness": (size.heads,), "before.weight": (w,), "before.bias": (w,), "between.weight": (w,),
            "between.bias": (w,), "attend.weight": (3 * w, w), "attend.bias": (3 * w,), "mix.weight": (w, w),
            "mix.bias": (w,), "wide.weight": (2 * w, w), "wide.bias": (2 * w,), "narrow.weight": (w, 2 * w),
            "narrow.bias": (w,),
        }  # fmt: skip
        out |= {f"blocks.{i}.{name}": shape for name, shape in parts.items()}
    out |= {"last.weight": (w,), "last.bias": (w,), "score.weight": (1, w), "score.bias": (1,)}
    return {name: (size.members, *shape) for name, shape in out.items()}


def greedy_score(rates: Array) -> Array:
    """(k,) what the greedy driver orders goals by, on the scale of the network's scores."""
    out: Array = np.log10(rates + 1e-3)
    return out


def gaps_between(places: Array) -> Array:
    """(k, k) distances between goals, squashed below 4 and in units of `GAP`."""
    out: Array = np.minimum(np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1)) / GAP, 4.0)
    return out


def scores(arrays: Arrays, size: Size, tokens: Tokens, legal: BoolArray) -> Array:
    """(k,) a score for each goal: by how many hundredths of E it beats the others; −inf where it is not legal."""
    members = ({name: array[i] for name, array in arrays.items()} for i in range(size.members))
    found: Array = np.mean([_scores(member, size, tokens, legal) for member in members], axis=0)
    return np.where(legal, found, -np.inf)


def choose(arrays: Arrays, size: Size, tokens: Tokens, legal: BoolArray) -> int:
    """The goal of the highest score among the most promising of those that are legal."""
    rows, weighed = most_promising(tokens, legal)
    return int(rows[np.argmax(scores(arrays, size, weighed, legal[rows]))])


def _scores(arrays: Arrays, size: Size, tokens: Tokens, legal: BoolArray) -> Array:
    """(k,) those of one member."""
    x = _linear(arrays, "embed", (tokens.fields - arrays["shift"]) * arrays["scale"])
    gaps = gaps_between(tokens.places)
    for i in range(size.layers):
        x = _block(arrays, f"blocks.{i}", x, gaps, legal, size.heads)
    residual = _linear(arrays, "score", _normed(arrays, "last", x))[:, 0]
    return float(arrays["greed"]) * greedy_score(tokens.rates) + residual


def _block(arrays: Arrays, name: str, x: Array, gaps: Array, legal: BoolArray, heads: int) -> Array:
    goals, width = x.shape
    qkv = _linear(arrays, f"{name}.attend", _normed(arrays, f"{name}.before", x))
    q, k, v = qkv.reshape(goals, 3, heads, -1).transpose(1, 2, 0, 3)  # each (heads, goals, width / heads)
    match = q @ k.transpose(0, 2, 1) / math.sqrt(width / heads) - arrays[f"{name}.nearness"][:, None, None] * gaps
    match = np.where(legal, match, -np.inf)
    share = np.exp(match - match.max(axis=2, keepdims=True))
    share /= share.sum(axis=2, keepdims=True)
    x = x + _linear(arrays, f"{name}.mix", (share @ v).transpose(1, 0, 2).reshape(goals, width))
    thought = np.maximum(_linear(arrays, f"{name}.wide", _normed(arrays, f"{name}.between", x)), 0.0)
    return x + _linear(arrays, f"{name}.narrow", thought)


def _linear(arrays: Arrays, name: str, x: Array) -> Array:
    out: Array = x @ arrays[f"{name}.weight"].T + arrays[f"{name}.bias"]
    return out


def _normed(arrays: Arrays, name: str, x: Array) -> Array:
    centred = x - x.mean(axis=-1, keepdims=True)
    out: Array = centred / np.sqrt((centred**2).mean(axis=-1, keepdims=True) + _EPSILON)
    return out * arrays[f"{name}.weight"] + arrays[f"{name}.bias"]
