"""The batch optimum of a log: exact without noise, stationary with it, and the published figure of Victoria Park."""

import functools

import numpy as np
import pytest

from slam_gym.association import true_association
from slam_gym.geometry import compose, observe
from slam_gym.mapping.stochastic_map import MapSpec
from slam_gym.metrics.association import Identities
from slam_gym.recordings.least_squares import _Problem, least_squares
from slam_gym.recordings.recording import Recording
from slam_gym.recordings.victoria_park import victoria_park_clean
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import NONE, Truth

MOTION, NOISE = np.diag([0.05, 0.05, 0.03]) ** 2, 0.05**2 * np.eye(2)


def round_trip(rng: np.random.Generator, noisy: float, steps: int = 40) -> tuple[Recording, np.ndarray, np.ndarray]:
    """A circle among landmarks, some of the measurements spurious; with its true poses and landmarks."""
    landmarks = rng.uniform(-8.0, 8.0, (15, 2))
    motion = np.array([0.8, 0.0, 2.0 * np.pi / steps])
    poses = [np.zeros(3)]
    for _ in range(steps - 1):
        poses.append(compose(poses[-1], motion))
    points, sources, starts = [], [], [0]
    for pose in poses:
        seen = observe(pose, landmarks)
        near = np.flatnonzero(np.hypot(*seen.T) < 7.0)
        points += [*(seen[near] + noisy * rng.multivariate_normal([0, 0], NOISE, len(near))), [3.0, 3.0]]
        sources += [*near, NONE]
        starts.append(len(points))
    motions = np.vstack([np.zeros(3), motion + noisy * rng.multivariate_normal(np.zeros(3), MOTION, steps - 1)])
    unknown = np.full(len(points), np.nan)
    log = Recording(
        "round trip", "", "", np.arange(float(steps)), motions, np.tile(MOTION, (steps, 1, 1)), np.array(starts),
        np.array(points), np.tile(NOISE, (len(points), 1, 1)), unknown, unknown.copy(), np.array(sources), np.empty(0),
        np.empty((0, 3)), np.empty(0, np.int64), np.empty((0, 2)), 20.0, 6.0,
    )  # fmt: skip
    return log, np.array(poses), landmarks


def test_without_noise_the_optimum_is_the_truth() -> None:
    log, poses, landmarks = round_trip(np.random.default_rng(0), 0.0)
    best = least_squares(log)
    assert best.chi2 < 1e-12
    np.testing.assert_allclose(best.poses, poses, atol=1e-6)
    np.testing.assert_allclose(best.landmarks, landmarks[best.ids], atol=1e-6)


def test_the_jacobian_is_that_of_the_residuals() -> None:
    log, *_ = round_trip(np.random.default_rng(1), 1.0, steps=6)
    problem = _Problem(log)
    x = problem.start(problem.dead_reckoning()) + 0.1 * np.random.default_rng(2).standard_normal(
        3 * 6 + 2 * len(problem.ids)
    )
    columns = []
    for i in range(len(x)):
        step = np.zeros(len(x))
        step[i] = 1e-6
        columns.append((problem.residuals(x + step) - problem.residuals(x - step)) / 2e-6)
    np.testing.assert_allclose(problem.linearise(x)[1].toarray(), np.column_stack(columns), rtol=1e-4, atol=1e-3)


def test_at_the_optimum_nothing_is_to_be_gained_and_chi2_is_what_the_noise_says() -> None:
    chi2, dof = 0.0, 0
    for seed in range(10):
        log, *_ = round_trip(np.random.default_rng(seed), 1.0)
        best, problem = least_squares(log), _Problem(log)
        x = np.concatenate([best.poses.ravel(), best.landmarks.ravel()])
        residuals, jacobian = problem.linearise(x)
        scale = np.sqrt((jacobian.multiply(jacobian)).sum(axis=0))
        assert np.abs((jacobian.T @ residuals) / scale).max() < 1e-2
        chi2, dof = chi2 + best.chi2, dof + len(residuals) - len(x)
    assert abs(chi2 - dof) < 4.0 * np.sqrt(2.0 * dof)


def test_a_log_without_identities_has_no_optimum() -> None:
    log, *_ = round_trip(np.random.default_rng(0), 0.0)
    unlabelled = Recording(**{**vars(log), "sources": np.full(len(log.sources), -2)})
    with pytest.raises(ValueError, match="'round trip': no measurement has an identity"):
        least_squares(unlabelled)


@pytest.mark.slow
def test_the_published_optimum_of_victoria_park(data_dir) -> None:
    log = victoria_park_clean(data_dir / "victoria_park" / "VicPark_clean_data.mat")
    slam = Slam(SlamSpec(MapSpec(unconfirmed_age=None), reach=1e3), true_association)
    identities, poses = Identities(), []
    for odometry, scan, sources in log.steps():
        known = identities.source_of(slam.map.ids)
        step = slam.step(odometry, scan, functools.partial(true_association, sources=sources, identities=known))
        identities.update(step, Truth(np.zeros(3), sources))
        poses.append(slam.map.pose)
    best = least_squares(log, np.array(poses))
    assert len(best.ids) == 299 and abs(best.chi2 - 9012.7193) < 1e-3
