"""Goals as tokens, what a network of goals looks at: each goal, the map around it, and the state of the episode.

Of the map that is known already they tell nothing but where its features are: what a revisit is worth is not learned.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from agents.drivers.base import LOOK_AROUND, Observation
from agents.drivers.information_gain import GainSpec, rates
from slam_gym.envs.goal_observation import unsquash_goals
from slam_gym.envs.observation import METRES, PIXELS
from slam_gym.types import Array, BoolArray, IntArray

_REACHES = (1, 3, 6)  # [pixels] half the sides of the squares around a goal in which the image is summed up
_AROUND = tuple(f"{what} within {reach}" for reach in _REACHES for what in ("free", "wall", "features", "unknown"))
OWN = (
    "is look around", "is frontier", "distance", "cosine of the bearing", "path", "area", "log rate",
    "beyond the image", "fraction of the time left", *_AROUND,
)  # fmt: skip
COMMON = (
    "budget", "log ticks left", "ticks used", "frontiers", "area in all", "free in all", "wall in all",
    "features in all", "features per free",
)  # fmt: skip
TOKEN_FIELDS = (*OWN, *COMMON)
"""Columns of a token: a goal's own, and what all goals of an observation share."""

CHOICES = 4  # goals that are weighed at a decision, those of the highest rates: further down hardly any is better
_MOST_TICKS = 5_000.0  # [ticks] that are taken to be left while the budget is not known


class Tokens(NamedTuple):
    """One row a goal."""

    fields: Array  # (k, len(TOKEN_FIELDS))
    places: Array  # (k, 2) [m] in the robot frame
    rates: Array  # (k,) [m² per tick] of information gain by new area, the greedy score


def ticks_left(budget: float, used: float) -> float:
    """[ticks] from the fraction of the `budget` that is left and the ticks `used`; many at the start, untold then."""
    return min(_MOST_TICKS, used * budget / (1.0 - budget)) if budget < 1.0 and used > 0.0 else _MOST_TICKS


def most_promising(tokens: Tokens, legal: BoolArray) -> tuple[IntArray, Tokens]:
    """(CHOICES,) the goals of the highest rates, best first, and their tokens; goals that are not legal come last."""
    rows = np.argsort(-np.where(legal, tokens.rates, -np.inf), kind="stable")[:CHOICES]
    return rows, Tokens(*(part[rows] for part in tokens))


def tokens_of(observation: Observation, used: float) -> Tokens:
    """The tokens of all goals of an observation, those that are not legal among them, after `used` ticks."""
    goals = unsquash_goals(observation["goals"])
    goals |= {"area": np.where(goals["revisit"] > 0.5, 0.0, goals["area"]), "reduction": np.zeros(len(goals["x"]))}
    places = np.column_stack([goals["x"], goals["y"]])
    budget = float(observation["budget"][0])
    left, rate = ticks_left(budget, used), rates(goals, GainSpec())
    own = np.zeros((len(places), len(OWN)))
    own[LOOK_AROUND, 0], own[:, 1] = 1.0, goals["frontier"]
    distances = np.hypot(*places.T)
    own[:, 2], own[:, 3] = distances / 10.0, places[:, 0] / np.maximum(distances, 0.1)
    own[:, 4], own[:, 5] = goals["path"] / 10.0, goals["area"] / 50.0
    own[:, 6] = np.log10(rate + 1e-3)
    own[:, 7] = np.abs(places).max(axis=1) > 0.5 * METRES
    own[:, 8] = np.minimum(2.0, (5.0 + 12.0 * goals["path"]) / max(left, 1.0))
    own[:, 9:] = _around(_summed(observation["image"]), places)
    fields = np.concatenate([own, np.tile(_common(observation, goals, left, used), (len(own), 1))], axis=1)
    return Tokens(np.clip(fields, -4.0, 4.0), places, rate)


def _common(observation: Observation, goals: dict[str, Array], left: float, used: float) -> Array:
    free, wall, features = observation["image"].reshape(3, -1).mean(axis=1) / 255.0
    return np.array([
        float(observation["budget"][0]), math.log10(left + 1.0) - 2.0, used / 500.0,
        goals["frontier"].sum() / 10.0, goals["area"].sum() / 500.0, free, wall, 10.0 * features,
        features / (free + 0.02),
    ])  # fmt: skip


def _summed(image: Array) -> Array:
    """Sums (4, PIXELS + 1, PIXELS + 1) of free, wall, features and unknown over all pixels before each."""
    layers = image.astype(np.float64) / 255.0
    unknown = np.maximum(0.0, 1.0 - layers[0] - layers[1])
    out = np.zeros((4, PIXELS + 1, PIXELS + 1))
    out[:, 1:, 1:] = np.concatenate([layers, unknown[None]]).cumsum(axis=1).cumsum(axis=2)
    return out


def _around(summed: Array, places: Array) -> Array:
    """(k, 4 · len(_REACHES)) means of the layers in squares around the places, as far as the image goes."""
    pixel, out = METRES / PIXELS, []
    rows, columns = np.floor((METRES / 2.0 - places) / pixel).astype(np.int64).T
    for reach in _REACHES:
        top, bottom = np.clip(rows - reach, 0, PIXELS), np.clip(rows + reach + 1, 0, PIXELS)
        left, right = np.clip(columns - reach, 0, PIXELS), np.clip(columns + reach + 1, 0, PIXELS)
        sums = summed[:, bottom, right] - summed[:, top, right] - summed[:, bottom, left] + summed[:, top, left]
        out.append((sums / np.maximum((bottom - top) * (right - left), 1)).T)
    return np.concatenate(out, axis=1)
