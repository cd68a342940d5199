"""Map quality against closed forms and invariances."""

import itertools
import math

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from slam_gym.geometry import transform
from slam_gym.metrics.map_quality import (
    align_se2,
    ate,
    cells_of,
    coverage,
    gospa,
    landmark_rmse,
    map_error,
    map_error_aligned,
)
from slam_gym.metrics.point_assignment import assign, indexed
from slam_gym.types import UNPAIRED
from tests.oracles.statistics import for_seeds


def test_map_error_runs_from_one_for_nothing_to_zero_for_the_truth():
    true = np.random.default_rng(0).uniform(0, 20, (50, 2))
    assert map_error(np.empty((0, 2)), true, 0.5) == 1.0
    assert map_error(true[::-1].copy(), true, 0.5) == 0.0
    assert map_error(true[:10], true, 0.5) == pytest.approx(0.8)
    assert map_error(true + np.array([0.05, 0.0]), true, 0.5) == pytest.approx(0.1)
    assert map_error(np.vstack([true, true]), true, 0.5) == pytest.approx(1.0)  # each duplicate costs as much as a miss
    assert map_error(true + 1000.0, true, 0.5) == pytest.approx(2.0)
    assert map_error(np.empty((0, 2)), np.empty((0, 2)), 0.5) == 0.0


def test_map_error_is_gospa_with_its_parameters():
    rng = np.random.default_rng(1)
    true, estimated = rng.uniform(0, 10, (40, 2)), rng.uniform(0, 10, (35, 2))
    distance = gospa(estimated, true, p=1.0, cutoff=1.4)
    assert map_error(estimated, true, 0.7) == pytest.approx(distance.total / (0.7 * 40))
    assert distance.total == pytest.approx(distance.localisation + distance.missed + distance.false)


def test_gospa_parts():
    true = np.array([[0.0, 0.0], [5.0, 0.0], [9.0, 9.0]])
    estimated = np.array([[0.3, 0.4], [0.0, 0.6], [5.0, 0.0]])  # the second is a duplicate
    parts = gospa(estimated, true)
    assert parts.localisation == pytest.approx(0.5)
    assert parts.missed == parts.false == pytest.approx(math.sqrt(0.5))
    assert parts.total == pytest.approx(math.sqrt(0.25 + 1.0))


def test_bad_points_are_refused():
    good, bad = np.zeros((2, 2)), np.array([[0.0, np.nan]])
    with pytest.raises(ValueError, match="a position is not finite"):
        map_error(bad, good, 1.0)
    with pytest.raises(ValueError, match="a position is not finite"):
        gospa(good, np.array([[np.inf, 0.0]]))
    with pytest.raises(ValueError, match="sigma0"):
        map_error(good, good, 0.0)
    for wrong in ({"cutoff": -1.0}, {"p": np.inf}):
        with pytest.raises(ValueError, match="GOSPA needs a finite p"):
            gospa(good, good, **wrong)
    with pytest.raises(ValueError, match=r"\(m, 2\)"):
        gospa(np.zeros((3, 3)), good)
    with pytest.raises(ValueError, match="one shape"):
        landmark_rmse(good, np.zeros((3, 2)))
    with pytest.raises(ValueError, match="finite"):
        landmark_rmse(bad, np.zeros((1, 2)))


@for_seeds(20)
def test_alignment_recovers_a_rigid_motion_and_beats_its_neighbours(seed):
    rng = np.random.default_rng(seed)
    points, pose = rng.uniform(-10, 10, (12, 2)), rng.uniform(-3, 3, 3)
    np.testing.assert_allclose(align_se2(points, transform(pose, points)), pose, atol=1e-12)
    noisy = transform(pose, points) + rng.normal(0, 0.5, points.shape)
    best = align_se2(points, noisy)
    least = landmark_rmse(transform(best, points), noisy)
    assert landmark_rmse(points, noisy, aligned=True) == pytest.approx(least)
    for nudge in rng.normal(0, 0.05, (20, 3)):
        assert landmark_rmse(transform(best + nudge, points), noisy) >= least


def test_points_at_one_place_have_no_heading():
    for value in (0.1, 1.0 / 3.0, -7.7):
        assert align_se2(np.full((3, 2), value), np.random.default_rng(0).normal(size=(3, 2)))[2] == 0.0


def test_coverage_counts_points_in_known_cells():
    cells = np.zeros((3, 4), np.uint8)
    cells[0, 0], cells[2, 3] = 1, 2
    points = np.array([[-0.9, 2.1], [0.9, 3.4], [0.0, 2.6], [-1.1, 2.1], [5.0, 5.0]])
    assert coverage(cells, cells_of(points, cells.shape, np.array([-1.0, 2.0]), 0.5)) == 2 / 5
    assert math.isnan(coverage(cells, cells_of(np.empty((0, 2)), cells.shape, np.zeros(2), 0.5)))


def test_the_trajectory_error_is_that_of_the_positions():
    true = np.random.default_rng(3).uniform(-5, 5, (50, 3))
    assert ate(true + np.array([0.3, 0.4, 1.0]), true) == pytest.approx(0.5)
    moved = transform(np.array([1.0, -2.0, 2.5]), true[:, :2].copy())
    assert ate(moved, true) > 0.5 and ate(moved, true, aligned=True) == pytest.approx(0.0, abs=1e-12)
    assert math.isnan(ate(np.empty((0, 3)), np.empty((0, 3)))) and math.isnan(ate([], []))


def blurred(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Points of a map, and the true ones: some missed, some false, the others off by a tenth of a metre."""
    rng = np.random.default_rng(seed)
    true = rng.uniform(-10.0, 10.0, (30, 2))
    return np.concatenate([true[:24] + rng.normal(0.0, 0.1, (24, 2)), rng.uniform(-10.0, 10.0, (4, 2))]), true


@for_seeds(20)
def test_a_map_that_was_moved_is_as_good_as_it_was(seed) -> None:
    estimated, true = blurred(seed)
    before = map_error_aligned(estimated, true, 0.5)
    rng = np.random.default_rng(seed)
    moved = transform(np.array([*rng.normal(0.0, 3.0, 2), rng.uniform(-np.pi, np.pi)]), estimated)
    assert map_error_aligned(moved, true, 0.5, (moved[:24], true[:24])) == pytest.approx(before, abs=2e-3)
    assert before <= map_error(estimated, true, 0.5) < map_error(moved, true, 0.5)


@pytest.mark.parametrize("seed", range(6))
def test_no_motion_of_a_grid_is_better(seed) -> None:
    """Turns by up to 10° and shifts by up to 0.6 m, from a map that is off by as much."""
    estimated, true = blurred(seed)
    rng = np.random.default_rng(seed)
    moved = transform(np.array([*rng.uniform(-0.3, 0.3, 2), rng.uniform(-0.1, 0.1)]), estimated)
    shifts, turns = np.linspace(-0.6, 0.6, 13), np.deg2rad(np.linspace(-10.0, 10.0, 21))
    grid = [map_error(transform(np.array(T), moved), true, 0.5) for T in itertools.product(shifts, shifts, turns)]
    for known in (None, (moved[:24], true[:24])):
        assert map_error_aligned(moved, true, 0.5, known) <= min(grid) + 1e-9


def test_nothing_and_one_point_are_aligned_too() -> None:
    nothing, one = np.empty((0, 2)), np.array([[3.0, 4.0]])
    assert map_error_aligned(nothing, one, 0.5) == 1.0
    assert map_error_aligned(one + 5.0, one, 0.5, (one + 5.0, one)) == pytest.approx(0.0, abs=1e-6)
    with pytest.raises(ValueError, match="sigma0"):
        map_error_aligned(one, one, 0.0)


# --- the sparse assignment of points against the dense one ------------------------------------------------------------


def dense_optimum(estimated, true, cutoff, p):
    """Textbook: every point of either set may also go to a dummy of its own, for half the cutoff."""
    e, n = len(estimated), len(true)
    cost = np.full((e + n, e + n), 0.5 * cutoff**p)
    cost[:e, :n] = np.linalg.norm(estimated[:, None] - true[None], axis=2) ** p
    cost[e:, n:] = 0.0
    return cost[linear_sum_assignment(cost)].sum()


@for_seeds(300)
def test_sparse_assignment_is_the_dense_optimum(seed):
    rng = np.random.default_rng(seed)
    cutoff, p = rng.choice([0.1, 1.0, 3.0, 30.0]), rng.choice([1.0, 1.5, 2.0])
    true = rng.uniform(-4, 4, (rng.integers(0, 40), 2)) * rng.choice([0.2, 1.0, 1.0, 5.0], size=2)
    copies = true[rng.integers(0, len(true), rng.integers(0, 40))] if len(true) else true
    estimated = np.vstack([copies + rng.normal(0, 0.5, copies.shape), rng.uniform(-5, 5, (rng.integers(0, 6), 2))])
    features, total, pairings = assign(estimated, indexed(true, cutoff), p)
    paired = features != UNPAIRED
    assert paired.sum() == pairings == len(set(features[paired].tolist()))
    distances = np.linalg.norm(estimated[paired] - true[features[paired]], axis=1)
    assert total == pytest.approx((distances**p).sum()) and (distances < cutoff).all()
    unpaired = len(estimated) + len(true) - 2 * pairings
    assert total + 0.5 * cutoff**p * unpaired == pytest.approx(dense_optimum(estimated, true, cutoff, p), abs=1e-9)
