"""The batch optimum of a log: exact without noise, stationary with it, and the published figure of Victoria Park."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slam_gym.geometry import compose, observe
from slam_gym.mapping.stochastic_map import MapSpec
from slam_gym.recordings.least_squares import _Problem, least_squares
from slam_gym.recordings.reading import read_matlab, starts_of
from slam_gym.recordings.recording import Recording
from slam_gym.recordings.victoria_park import SOURCE
from slam_gym.simulation.judged import JudgedSlam
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import SPURIOUS, Truth

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
        sources += [*near, SPURIOUS]
        starts.append(len(points))
    motions = np.vstack([np.zeros(3), motion + noisy * rng.multivariate_normal(np.zeros(3), MOTION, steps - 1)])
    log = Recording(
        name="round trip", source="", terms="", times=np.arange(float(steps)), motions=motions,
        motion_covariances=np.tile(MOTION, (steps, 1, 1)), starts=np.array(starts), points=np.array(points),
        covariances=np.tile(NOISE, (len(points), 1, 1)), sources=np.array(sources), range=20.0, field_of_view=6.0,
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
        columns.append((problem.linearise(x + step)[0] - problem.linearise(x - step)[0]) / 2e-6)
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
    unlabelled = replace(log, sources=np.full(len(log.sources), -2))
    with pytest.raises(ValueError, match="'round trip': no measurement has an identity"):
        least_squares(unlabelled)


def victoria_park_clean(path: Path) -> Recording:
    """The log as Huang, Wang and Dissanayake cleaned it (`VicPark_clean_data.mat`): motions and labelled points.

    Its least-squares optimum is known: χ² = 9012.7193. Steps are numbered, not timed.
    """
    rows = read_matlab(path, ("VicPark_clean_data",), SOURCE)["VicPark_clean_data"]
    moves, looks = rows[rows[:, 0] == 1.0], rows[rows[:, 0] == 0.0]
    steps = len(moves) + 1
    assert np.array_equal(moves[:, 2], np.arange(1, steps)) and np.array_equal(moves[:, 1], np.arange(steps - 1))
    looks = looks[np.argsort(looks[:, 1], kind="stable")]
    motions, covariances = np.zeros((steps, 3)), np.tile(1e-4**2 * np.eye(3), (steps, 1, 1))
    motions[1:] = moves[:, 3:6]
    covariances[1:] = moves[:, [6, 7, 8, 7, 9, 10, 8, 10, 11]].reshape(-1, 3, 3)
    return Recording(
        name="victoria_park_clean",
        source=SOURCE,
        terms="",
        times=np.arange(steps, dtype=np.float64),
        motions=motions,
        motion_covariances=covariances,
        starts=starts_of(np.bincount(looks[:, 1].astype(np.int64), minlength=steps)),
        points=looks[:, 3:5].copy(),
        covariances=looks[:, [5, 6, 6, 7]].reshape(-1, 2, 2).copy(),
        sources=looks[:, 2].astype(np.int64),
        range=80.0,
        field_of_view=math.pi,
    )


@pytest.mark.slow
def test_the_published_optimum_of_victoria_park(data_dir) -> None:
    log = victoria_park_clean(data_dir / "victoria_park" / "VicPark_clean_data.mat")
    slam, poses = Slam(SlamSpec(MapSpec(unconfirmed_age=None), reach=1e3)), []
    judged = JudgedSlam(slam, "true_association")
    for odometry, scan, sources in log.steps():
        judged.step(odometry, scan, Truth(np.zeros(3), sources))
        poses.append(slam.map.pose)
    best = least_squares(log, np.array(poses))
    assert len(best.ids) == 299 and abs(best.chi2 - 9012.7193) < 1e-3
