"""The candidate goals of `Explore-v0`: look around, go to a frontier, or revisit a place. They use no truth."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.navigation.active_slam import expected_reduction, features_in_sight
from slam_gym.navigation.explored_grid import ExploredGrid
from slam_gym.navigation.frontiers import frontiers
from slam_gym.navigation.planner import DistanceField, distance_field
from slam_gym.scenarios import Scenario
from slam_gym.types import Array, BoolArray, IntArray

LOOK = 0  # the slot that looks around, always legal
FRONTIERS = 10  # slots 1 … 10: the nearest frontiers
REVISITS = 5  # slots 11 … 15: known places from which the map is expected to improve
SLOTS = 1 + FRONTIERS + REVISITS

CLEARANCE = 0.05  # [m] that paths keep from walls, in addition to the robot's radius
SQUEEZE = 0.6  # fraction of the robot's radius that paths keep if there is no other way: walls are drawn too thick
_LARGEST = 4  # frontiers offered for their large unknown area per path length; the others are the nearest
_SHORT = 10.0  # [m] added to that path length
_SAME = 1.0  # [m] within which places count as the same
_TRIES = 2  # attempts after which a frontier is offered only when no other is left
PLACE_SPACING = 1.5  # [m] between the remembered places along the robot's path
_PLACES = 32  # greatest number of places considered at a decision
_REVISIT_SPACING = 3.0  # [m] between the revisits offered
_LOOKOUT = 2.0  # [m] along a path between predictions of what is in view
_LOOKS = 5  # number of independent scans that a stay counts for, a rule of thumb
ENOUGH = 2  # features in view that determine position and heading
WORTH_SEEING = 0.5  # [m²] a frontier with less unknown area in view is not offered, or out of date


@dataclass(frozen=True)
class Goals:
    """The goals that the agent may choose from, one row per slot; rows that are not legal are zero."""

    positions: Array  # (SLOTS, 2) [m] in B
    lengths: Array  # (SLOTS,) [m] of the path there
    areas: Array  # (SLOTS,) [m²] unknown area in view from there
    reductions: Array  # (SLOTS,) [m²] expected decrease of Σ tr P over the mapped features
    legal: BoolArray  # (SLOTS,)
    in_view: Array = field(default_factory=lambda: np.zeros(SLOTS))  # (SLOTS,) features expected in view on the path
    ways: DistanceField | None = None  # paths from here to all places, at the first of `clearances`


class Places:
    """Places where the robot has been, `PLACE_SPACING` apart: the candidates for revisits."""

    def __init__(self) -> None:
        self._points: list[tuple[float, float]] = []  # no arrays, since every tick compares them

    def pass_by(self, position: Array) -> None:
        """Remember `position` (2,) in B, unless it is near a remembered place."""
        x, y = position.tolist()
        for other_x, other_y in reversed(self._points):
            if abs(other_x - x) < PLACE_SPACING and abs(other_y - y) < PLACE_SPACING:
                return
        self._points.append((x, y))

    def candidates(self) -> Array:
        """(q, 2) places, chosen evenly among all that are remembered."""
        if not self._points:
            return np.empty((0, 2))
        chosen = np.unique(np.linspace(0, len(self._points) - 1, _PLACES).astype(np.int64))
        return np.array(self._points)[chosen]


class Tried:
    """Counts how often each place has been tried."""

    def __init__(self) -> None:
        self._points: list[Array] = []
        self._times: list[int] = []

    def add(self, position: Array) -> None:
        """Count `position` (2,) in B, or the first counted place within `_SAME` of it, once more."""
        for i, point in enumerate(self._points):
            if math.dist(point, position) < _SAME:
                self._times[i] += 1
                return
        self._points.append(position.copy())
        self._times.append(1)

    def times(self, positions: Array) -> IntArray:
        """(q,) how often each of `positions` (q, 2), or a place within `_SAME` of it, has been tried."""
        points, times = np.array(self._points).reshape(-1, 2), np.array(self._times, np.int64)
        near = np.hypot(*(positions[:, None] - points).transpose(2, 0, 1)) < _SAME
        return np.asarray(np.where(near, times, 0).max(axis=1, initial=0))


def clearances(radius: float) -> tuple[float, float]:
    """[m] clearances of paths of a robot of `radius` [m] from walls: the usual one, and that of narrow passages."""
    return radius + CLEARANCE, SQUEEZE * radius


def propose(scenario: Scenario, slam_map: StochasticMap, grid: ExploredGrid, places: Places, tried: Tried) -> Goals:
    """The goals at the estimated pose of the robot, over the explored grid.

    Frontiers that have been `tried` twice, but were not reached or are still frontiers, are offered only when no other
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
    """(≤ FRONTIERS, 2) reachable frontiers with enough unknown area in view, nearest first.

    If there are more, the nearest are offered, and those with the largest area per path length, so that a wing of the
    building is not neglected in favour of the corners of all rooms nearby.
    """
    centres = frontiers(grid, field.reachable)
    areas = grid.expected_area(centres, reach)
    lengths = field.lengths_to(centres)
    useful = (areas >= WORTH_SEEING) & np.isfinite(lengths)
    centres, areas, lengths, times = centres[useful], areas[useful], lengths[useful], tried.times(centres[useful])
    if len(centres) == 0:
        return centres
    offered = np.flatnonzero(times < max(_TRIES, int(times.min()) + 1))
    nearest = offered[np.argsort(lengths[offered], kind="stable")]
    if len(nearest) > FRONTIERS:
        far = nearest[FRONTIERS - _LARGEST :]
        largest = far[np.argsort(-areas[far] / (lengths[far] + _SHORT), kind="stable")[:_LARGEST]]
        nearest = np.concatenate([nearest[: FRONTIERS - _LARGEST], largest])
        nearest = nearest[np.argsort(lengths[nearest], kind="stable")]
    return np.asarray(centres[nearest])


def _views(
    scenario: Scenario, slam_map: StochasticMap, grid: ExploredGrid, reached: DistanceField, spots: Array
) -> tuple[Array, Array]:
    """The features in view on the paths to `spots` (q, 2), the first of which is the position of the robot.

    Returns the fraction of each path with fewer than `ENOUGH` features in view (q,), and the mean number of features in
    view (q,), from predictions every `_LOOKOUT` metres.
    """
    points, counts = reached.along_each(spots[1:], _LOOKOUT)
    counts = np.append(1, counts)
    looks = np.concatenate([spots[:1], points])
    seen = features_in_sight(slam_map.mean, grid, looks, scenario.sensor.range)
    starts = np.cumsum(counts) - counts
    blind = np.add.reduceat(seen < ENOUGH, starts, dtype=np.int64) / counts
    field_fraction = scenario.sensor.field_of_view / (2.0 * math.pi)
    return blind, field_fraction * np.add.reduceat(seen, starts) / counts


def _reductions(scenario: Scenario, slam_map: StochasticMap, grid: ExploredGrid, spots: Array, blind: Array) -> Array:
    """(q,) [m²] expected reduction of the map's variance by a stay at each spot.

    The known map limits the drift to that of one metre, plus that of the `blind` length (q,) [m] of the path, where too
    few features are in view to determine the pose.
    """
    sigma = scenario.sensor.sigma_halfway / math.sqrt(_LOOKS)
    odometry = scenario.odometry
    drift = np.array([odometry.forward, odometry.forward, odometry.turn_per_metre]) * np.sqrt(1.0 + blind[:, None])
    return expected_reduction(
        slam_map.mean, slam_map.covariance, grid, spots, reach=scenario.sensor.range, sigma=sigma, drift=drift
    )


def _best_revisits(places: Array, reductions: Array, lengths: Array) -> NDArray[np.int64]:
    """Indices of the places with the greatest reduction per metre, at a distance from each other and from the robot."""
    chosen: list[int] = []
    for i in np.argsort(-reductions / (lengths + 1.0), kind="stable"):
        near = any(np.hypot(*(places[i] - places[j])) < _REVISIT_SPACING for j in chosen)
        if not near and lengths[i] > PLACE_SPACING:
            chosen.append(int(i))
        if len(chosen) == REVISITS:
            break
    return np.array(chosen, np.int64)
