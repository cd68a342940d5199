"""The candidate goals of `Explore-v0`: look around, go to a frontier, or revisit a place. Estimate side only."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.navigation.expected_gain import expected_reduction, features_in_sight
from slam_gym.navigation.explored_grid import ExploredGrid
from slam_gym.navigation.frontiers import frontiers
from slam_gym.navigation.planner import DistanceField, distance_field
from slam_gym.scenarios import Scenario
from slam_gym.types import Array, BoolArray, IntArray

LOOK = 0  # the slot that looks around, always legal
FRONTIERS = 10  # slots 1 … 10: the nearest frontiers
REVISITS = 5  # slots 11 … 15: known places that promise to improve the map
SLOTS = 1 + FRONTIERS + REVISITS

CLEARANCE = 0.05  # [m] beyond the robot's radius that paths keep from walls
SQUEEZE = 0.6  # of the robot's radius that they keep where there is no other way: walls are drawn too thick
_LARGEST = 4  # of the frontiers on offer, those that promise most on the way there; the others are the nearest
_SHORT = 10.0  # [m] that are added to the length of that way
_SAME = 1.0  # [m] within which places are one and the same
_TRIES = 2  # after which a frontier is offered only when no other is left
PLACE_SPACING = 1.5  # [m] between the remembered places along the robot's way
_PLACES = 32  # at most so many are weighed at a decision
_REVISIT_SPACING = 3.0  # [m] between the revisits on offer
_LOOKOUT = 2.0  # [m] of a way between looks at what is in view
_LOOKS = 5  # independent scans that a look is taken to be worth, a rule of thumb
ENOUGH = 2  # features in view that hold position and heading
WORTH_SEEING = 0.5  # [m²] a frontier from which less than this is to be seen is none, or has become out of date


@dataclass(frozen=True)
class Goals:
    """What the agent may choose from, one row per slot; rows that are not legal are zero."""

    positions: Array  # (SLOTS, 2) [m] in B
    lengths: Array  # (SLOTS,) [m] of the path there
    areas: Array  # (SLOTS,) [m²] unknown area in view from there
    reductions: Array  # (SLOTS,) [m²] expected decrease of Σ tr P over the mapped features
    legal: BoolArray  # (SLOTS,)
    in_view: Array = field(default_factory=lambda: np.zeros(SLOTS))  # (SLOTS,) features expected in view on the way
    ways: DistanceField | None = None  # to all places from here, at the clearance that paths keep


class Places:
    """Where the robot has been, thinned out: the candidates for revisits."""

    def __init__(self) -> None:
        self._points: list[tuple[float, float]] = []  # plain numbers, since they are looked at in every tick

    def pass_by(self, position: Array) -> None:
        """Remember `position` (2,) in B unless a remembered place is near."""
        x, y = position.tolist()
        for other_x, other_y in reversed(self._points):
            if abs(other_x - x) < PLACE_SPACING and abs(other_y - y) < PLACE_SPACING:
                return
        self._points.append((x, y))

    def candidates(self) -> Array:
        """(q, 2) evenly chosen among all remembered places."""
        if not self._points:
            return np.empty((0, 2))
        chosen = np.unique(np.linspace(0, len(self._points) - 1, _PLACES).astype(np.int64))
        return np.array(self._points)[chosen]


class Tried:
    """Where something has been tried, and how often."""

    def __init__(self) -> None:
        self._points: list[Array] = []
        self._times: list[int] = []

    def add(self, position: Array) -> None:
        """Once more at `position` (2,) in B, or at the first place that was nearly the same."""
        for i, point in enumerate(self._points):
            if math.dist(point, position) < _SAME:
                self._times[i] += 1
                return
        self._points.append(position.copy())
        self._times.append(1)

    def times(self, positions: Array) -> IntArray:
        """(q,) how often at each of `positions` (q, 2), or nearly there."""
        if not self._points:
            return np.zeros(len(positions), np.int64)
        points, times = np.array(self._points), np.array(self._times)
        near = np.hypot(*(positions[:, None] - points).transpose(2, 0, 1)) < _SAME
        out: IntArray = np.where(near, times, 0).max(axis=1)
        return out


def clearances(radius: float) -> tuple[float, float]:
    """[m] that paths of a robot of some radius keep from walls, and what they keep where there is no other way."""
    return radius + CLEARANCE, SQUEEZE * radius


def propose(scenario: Scenario, slam_map: StochasticMap, grid: ExploredGrid, places: Places, tried: Tried) -> Goals:
    """The goals from where the robot believes to be, over what it believes to have explored.

    Frontiers that have been `tried` twice, but were not reached or are frontiers still, are offered when no other one
    is left.
    """
    here, ways = slam_map.pose[:2], None
    for clearance in clearances(scenario.robot.radius):
        reached = distance_field(grid, here, clearance)
        ways = reached if ways is None else ways
        ends = frontiers_on_offer(grid, reached, scenario.beams.range, tried)
        if len(ends):
            break
    seen = places.candidates()
    seen = seen[np.isfinite(reached.lengths_to(seen))]
    spots = np.concatenate([here[None], ends, seen])
    lengths = np.concatenate([[0.0], reached.lengths_to(spots[1:])])
    blind, in_view = _views(scenario, slam_map, grid, reached, spots)
    reductions = _reductions(scenario, slam_map, grid, spots, lengths * blind)
    back = _best_revisits(seen, reductions[1 + len(ends) :], lengths[1 + len(ends) :])
    rows = np.concatenate([np.arange(1 + len(ends)), 1 + len(ends) + back])
    slots = np.concatenate([np.arange(1 + len(ends)), 1 + FRONTIERS + np.arange(len(back))])

    def by_slot(values: NDArray[Any]) -> NDArray[Any]:
        out = np.zeros((SLOTS, *values.shape[1:]), values.dtype)
        out[slots] = values
        return out

    return Goals(
        positions=by_slot(spots[rows]),
        lengths=by_slot(lengths[rows]),
        areas=by_slot(grid.expected_area(spots[rows], scenario.beams.range)),
        reductions=by_slot(reductions[rows]),
        legal=by_slot(np.ones(len(rows), np.bool_)),
        in_view=by_slot(in_view[rows]),
        ways=ways,
    )


def frontiers_on_offer(grid: ExploredGrid, field: DistanceField, reach: float, tried: Tried) -> Array:
    """Frontiers that a path leads to and that are worth it, nearest first, (≤ FRONTIERS, 2).

    Where there are more, the offer is of the nearest and of those that promise most for the way there, so that a wing
    of the building is not forgotten over the corners of all the rooms on this side.
    """
    centres = frontiers(grid, field.reachable)
    if len(centres) == 0:
        return centres
    areas = grid.expected_area(centres, reach)
    lengths = field.lengths_to(centres)
    worth = (areas >= WORTH_SEEING) & np.isfinite(lengths)
    centres, areas, lengths, times = centres[worth], areas[worth], lengths[worth], tried.times(centres[worth])
    if len(centres) == 0:
        return centres
    left = np.flatnonzero(times < max(_TRIES, int(times.min()) + 1))
    nearest = left[np.argsort(lengths[left], kind="stable")]
    if len(nearest) > FRONTIERS:
        far = nearest[FRONTIERS - _LARGEST :]
        largest = far[np.argsort(-areas[far] / (lengths[far] + _SHORT), kind="stable")[:_LARGEST]]
        nearest = np.concatenate([nearest[: FRONTIERS - _LARGEST], largest])
        nearest = nearest[np.argsort(lengths[nearest], kind="stable")]
    ends: Array = centres[nearest]
    return ends


def _views(
    scenario: Scenario, slam_map: StochasticMap, grid: ExploredGrid, reached: DistanceField, spots: Array
) -> tuple[Array, Array]:
    """Of the ways to `spots` (q, 2), the first of which is where the robot is, with a look every `_LOOKOUT` metres:
    the fraction with fewer than `ENOUGH` features in view (q,), and how many are in view on average (q,)."""
    points, counts = reached.along_each(spots[1:], _LOOKOUT)
    counts = np.append(1, counts)
    looks = np.concatenate([spots[:1], points])
    seen = features_in_sight(slam_map.mean, grid, looks, scenario.sensor.range)
    starts = np.cumsum(counts) - counts
    blind = np.add.reduceat(seen < ENOUGH, starts, dtype=np.int64) / counts
    turned_to = scenario.sensor.field_of_view / (2.0 * math.pi)
    return blind, turned_to * np.add.reduceat(seen, starts) / counts


def _reductions(scenario: Scenario, slam_map: StochasticMap, grid: ExploredGrid, spots: Array, blind: Array) -> Array:
    """Foreseen from each spot: the known map holds the drift down to that of a metre, but for the `blind` way (q,) [m].

    Where fewer features are in view than hold a pose, what the wheels are off by adds up.
    """
    sigma = scenario.sensor.sigma_halfway / math.sqrt(_LOOKS)
    odometry = scenario.odometry
    drift = np.array([odometry.forward, odometry.forward, odometry.turn_per_metre]) * np.sqrt(1.0 + blind[:, None])
    return expected_reduction(
        slam_map.mean, slam_map.covariance, grid, spots, reach=scenario.sensor.range, sigma=sigma, drift=drift
    )


def _best_revisits(places: Array, reductions: Array, lengths: Array) -> NDArray[np.int64]:
    """Indices of the places that promise most per metre, kept apart from each other and from here."""
    chosen: list[int] = []
    for i in np.argsort(-reductions / (lengths + 1.0), kind="stable"):
        near = any(np.hypot(*(places[i] - places[j])) < _REVISIT_SPACING for j in chosen)
        if not near and lengths[i] > PLACE_SPACING:
            chosen.append(int(i))
        if len(chosen) == REVISITS:
            break
    return np.array(chosen, np.int64)
