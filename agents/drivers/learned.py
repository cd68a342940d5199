"""The shipped learned driver: information gain, corrected by a network that has learned from trying goals out.

The network runs on numpy arrays, without torch; `agents.learning.driver` trains it. Its tokens are goals: each
describes a goal, the map around it, and the state of the episode. Of mapped features, tokens contain only positions,
and the value of revisits is not learned.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agents.drivers.base import LOOK_AROUND, Agent, Info, Observation
from agents.drivers.baselines import InformationGain, rates
from slam_gym.envs.observation import METRES, PIXELS, unsquash_goals
from slam_gym.simulation.goals import Tried
from slam_gym.types import Array, BoolArray, IntArray
from slam_gym.weights import Weights, load

VERSION = 3  # of the tokens; weights for another version raise an error

_REACHES = (1, 3, 6)  # [pixels] half the sides of the squares around a goal over which the image is averaged
_AROUND = tuple(f"{what} within {reach}" for reach in _REACHES for what in ("free", "wall", "features", "unknown"))
TOKEN_FIELDS = (
    "is look around", "is frontier", "distance", "cosine of the bearing", "path", "area", "log rate",
    "beyond the image", "fraction of the time left", *_AROUND,
    "budget", "log ticks left", "ticks used", "frontiers", "area in all", "free in all", "wall in all",
    "features in all", "features per free",
)  # fmt: skip
"""Columns of a token: those of its goal, and from `budget` on those that all goals of an observation share."""

GAP = 5.0  # [m] the unit of distances between goals
CHOICES = 4  # goals that are compared at a decision, those of the highest rates; the others are rarely better
_MOST_TICKS = 5_000.0  # [ticks] that are assumed to be left while the budget is unknown


class Tokens(NamedTuple):
    """The input of the network for k goals, of one state or of many."""

    fields: Any  # (…, k, len(TOKEN_FIELDS))
    gaps: Any  # (…, k, k) distances between goals, in units of `GAP` and below 4
    greedy: Any  # (…, k) the score of information gain by new area, on the scale of the network's scores
    legal: Any  # (…, k)


def tokens_of(observation: Observation, used: float, legal: BoolArray) -> tuple[IntArray, Tokens]:
    """(CHOICES,) the `legal` goals of the highest rates, best first, and their tokens, after `used` ticks.

    Illegal goals come last."""
    goals = unsquash_goals(observation["goals"])
    goals |= {"area": np.where(goals["revisit"] > 0.5, 0.0, goals["area"]), "reduction": np.zeros(len(goals["x"]))}
    places = np.column_stack([goals["x"], goals["y"]])
    budget, greedy = float(observation["budget"][0]), np.log10(rates(goals) + 1e-3)
    left = min(_MOST_TICKS, used * budget / (1.0 - budget)) if budget < 1.0 and used > 0.0 else _MOST_TICKS
    distances = np.hypot(*places.T)
    free, wall, features = observation["image"].reshape(3, -1).mean(axis=1) / 255.0
    common = [
        budget, math.log10(left + 1.0) - 2.0, used / 500.0, goals["frontier"].sum() / 10.0, goals["area"].sum() / 500.0,
        free, wall, 10.0 * features, features / (free + 0.02),
    ]  # fmt: skip
    fields = np.column_stack([
        np.arange(len(places)) == LOOK_AROUND, goals["frontier"], distances / 10.0,
        places[:, 0] / np.maximum(distances, 0.1), goals["path"] / 10.0, goals["area"] / 50.0, greedy,
        np.abs(places).max(axis=1) > 0.5 * METRES, np.minimum(2.0, (5.0 + 12.0 * goals["path"]) / max(left, 1.0)),
        _around(observation["image"], places), np.tile(common, (len(places), 1)),
    ])  # fmt: skip
    rows = np.argsort(-np.where(legal, greedy, -np.inf), kind="stable")[:CHOICES]
    gaps = np.minimum(np.hypot(*(places[rows, None] - places[rows]).transpose(2, 0, 1)) / GAP, 4.0)
    return rows, Tokens(np.clip(fields[rows], -4.0, 4.0), gaps, greedy[rows], legal[rows])


def _around(image: Array, places: Array) -> Array:
    """(k, 4 · len(_REACHES)) means of free, wall, features and unknown in squares around the places, clipped at the
    edge of the image."""
    layers = image.astype(np.float64) / 255.0
    unknown = np.maximum(0.0, 1.0 - layers[0] - layers[1])
    summed = np.zeros((4, PIXELS + 1, PIXELS + 1))  # of all pixels before
    summed[:, 1:, 1:] = np.concatenate([layers, unknown[None]]).cumsum(axis=1).cumsum(axis=2)
    pixel, out = METRES / PIXELS, []
    rows, columns = np.floor((METRES / 2.0 - places) / pixel).astype(np.int64).T
    for reach in _REACHES:
        top, bottom = np.clip(rows - reach, 0, PIXELS), np.clip(rows + reach + 1, 0, PIXELS)
        left, right = np.clip(columns - reach, 0, PIXELS), np.clip(columns + reach + 1, 0, PIXELS)
        sums = summed[:, bottom, right] - summed[:, top, right] - summed[:, bottom, left] + summed[:, top, left]
        out.append((sums / np.maximum((bottom - top) * (right - left), 1)).T)
    return np.concatenate(out, axis=1)


# -- the network -------------------------------------------------------------------------------------------------------

Arrays = Mapping[str, Any]
"""Weights by name: arrays (members, …) of all members, or tensors of one member in training."""

_EPSILON = 1e-5  # of the layer norms
WIDTH, HEADS, LAYERS = 32, 4, 2
MEMBERS = 3  # networks of the ensemble, whose scores are averaged

_BLOCK = {
    "nearness": (HEADS,), "before.weight": (WIDTH,), "before.bias": (WIDTH,), "between.weight": (WIDTH,),
    "between.bias": (WIDTH,), "attend.weight": (3 * WIDTH, WIDTH), "attend.bias": (3 * WIDTH,),
    "mix.weight": (WIDTH, WIDTH), "mix.bias": (WIDTH,), "wide.weight": (2 * WIDTH, WIDTH), "wide.bias": (2 * WIDTH,),
    "narrow.weight": (WIDTH, 2 * WIDTH), "narrow.bias": (WIDTH,),
}  # fmt: skip
SHAPES: dict[str, tuple[int, ...]] = {
    "greed": (), "shift": (len(TOKEN_FIELDS),), "scale": (len(TOKEN_FIELDS),),
    "embed.weight": (WIDTH, len(TOKEN_FIELDS)), "embed.bias": (WIDTH,),
    **{f"blocks.{i}.{name}": shape for i in range(LAYERS) for name, shape in _BLOCK.items()},
    "last.weight": (WIDTH,), "last.bias": (WIDTH,), "score.weight": (1, WIDTH), "score.bias": (1,),
}  # fmt: skip
"""The arrays of one member."""


def load_driver(weights: str | Path) -> Weights:
    """Weights of all members, by a name in `slam_gym.weights` or the path of a file. Raises ValueError as `load`."""
    return load(weights, VERSION, TOKEN_FIELDS, {name: (MEMBERS, *shape) for name, shape in SHAPES.items()})


def scores(arrays: Arrays, tokens: Tokens, xp: Any = np) -> Any:
    """A score for each goal: by how many hundredths of E it is better than the others.

    The shape is (members, k) for the arrays of all members and one state, and (…, k) for the arrays of one member. `xp`
    is the library of the arrays: numpy, or torch in training. Scores of illegal goals are meaningless.
    """
    x = _linear(arrays, "embed", (tokens.fields - arrays["shift"][..., None, :]) * arrays["scale"][..., None, :])
    for i in range(LAYERS):
        x = _block(arrays, f"blocks.{i}", x, tokens, xp)
    residual = _linear(arrays, "score", _normed(arrays, "last", x))[..., 0]
    return arrays["greed"][..., None] * tokens.greedy + residual


def _block(arrays: Arrays, name: str, x: Any, tokens: Tokens, xp: Any) -> Any:
    """A transformer block: attention to all legal goals, biased by distance, and a feed-forward layer."""
    qkv = _linear(arrays, f"{name}.attend", _normed(arrays, f"{name}.before", x))
    qkv = qkv.reshape(*x.shape[:-1], 3, HEADS, WIDTH // HEADS)
    q, k, v = (qkv[..., part, :, :] for part in range(3))  # each (…, goals, heads, width / heads)
    products = xp.einsum("...ihd,...jhd->...hij", q, k) / math.sqrt(WIDTH / HEADS)
    logits = products - arrays[f"{name}.nearness"][..., :, None, None] * tokens.gaps[..., None, :, :]
    logits = xp.where(tokens.legal[..., None, None, :], logits, -1e9)
    attention = xp.exp(logits - xp.amax(logits, axis=-1, keepdims=True))
    attention = attention / attention.sum(axis=-1, keepdims=True)
    x = x + _linear(arrays, f"{name}.mix", xp.einsum("...hij,...jhd->...ihd", attention, v).reshape(x.shape))
    hidden = _linear(arrays, f"{name}.wide", _normed(arrays, f"{name}.between", x)).clip(0.0)
    return x + _linear(arrays, f"{name}.narrow", hidden)


def _linear(arrays: Arrays, name: str, x: Any) -> Any:
    return x @ arrays[f"{name}.weight"].swapaxes(-1, -2) + arrays[f"{name}.bias"][..., None, :]


def _normed(arrays: Arrays, name: str, x: Any) -> Any:
    centred = x - x.mean(axis=-1, keepdims=True)
    scaled = centred / ((centred**2).mean(axis=-1, keepdims=True) + _EPSILON) ** 0.5
    return scaled * arrays[f"{name}.weight"][..., None, :] + arrays[f"{name}.bias"][..., None, :]


# -- the driver --------------------------------------------------------------------------------------------------------


class LearnedDriver(Agent):
    """Chooses the frontier with the highest score, or to look around, once at each place.

    With no frontier left, it drives by information gain. It uses only the observation, and counts the ticks that it has
    driven, from which it estimates how many are left.
    """

    name = "learned"

    def __init__(self, weights: str | Path = "driver") -> None:
        """`weights` are a name or path as for `load_driver`."""
        self._arrays = load_driver(weights).arrays
        self.reset(0)

    def reset(self, seed: int) -> None:
        self._ticks, self._looked, self._without_frontiers = 0.0, Tried(), InformationGain()

    def act(self, observation: Observation, info: Info) -> int:
        self._ticks += float(info["ticks"])
        legal = info["action_mask"] & (unsquash_goals(observation["goals"])["frontier"] > 0.5)
        if not legal.any():
            return self._without_frontiers.act(observation, info)
        place = np.asarray(info["pose"], float)[None, :2]
        legal[LOOK_AROUND] = self._looked.times(place)[0] == 0
        rows, tokens = tokens_of(observation, self._ticks, legal)
        values = scores(self._arrays, tokens).mean(axis=0)
        chosen = int(rows[np.argmax(np.where(tokens.legal, values, -np.inf))])
        if chosen == LOOK_AROUND:
            self._looked.add(place[0])
        return chosen
