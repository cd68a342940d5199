"""The batch optimum of a log: exact without noise, stationary with it, and the published figure of Victoria Park."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slam_gym.geometry import compose, inverse, transform
from slam_gym.mapping.stochastic_map import MapSpec
from slam_gym.recordings.least_squares import _Problem, least_squares
from slam_gym.recordings.reading import read_matlab, starts_of
from slam_gym.recordings.recording import Recording
from slam_gym.recordings.victoria_park import SOURCE
from slam_gym.simulation.judged import JudgedSlam
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import UNLABELLED, Truth
from tests.recordings import drive


def test_without_noise_the_optimum_is_the_truth() -> None:
    log = drive(noise=0.0)
    best, into_log = least_squares(log), compose(log.motions[0], inverse(log.reference_poses[0]))
    assert best.chi2 < 1e-12
    np.testing.assert_allclose(best.poses, [compose(into_log, pose) for pose in log.reference_poses], atol=1e-6)
    np.testing.assert_allclose(best.landmarks, transform(into_log, log.landmarks[best.ids]), atol=1e-6)


def test_the_jacobian_is_that_of_the_residuals() -> None:
    problem = _Problem(drive(1, steps=6))
    x = problem.start(problem.dead_reckoning())
    x += 0.1 * np.random.default_rng(2).standard_normal(len(x))
    columns = []
    for i in range(len(x)):
        step = np.zeros(len(x))
        step[i] = 1e-6
        columns.append((problem.linearise(x + step)[0] - problem.linearise(x - step)[0]) / 2e-6)
    np.testing.assert_allclose(problem.linearise(x)[1].toarray(), np.column_stack(columns), rtol=1e-4, atol=1e-3)


def test_at_the_optimum_nothing_is_to_be_gained_and_chi2_is_what_the_noise_says() -> None:
    chi2, dof = 0.0, 0
    for seed in range(10):
        log = drive(seed)
        best, problem = least_squares(log), _Problem(log)
        x = np.concatenate([best.poses.ravel(), best.landmarks.ravel()])
        residuals, jacobian = problem.linearise(x)
        scale = np.sqrt((jacobian.multiply(jacobian)).sum(axis=0))
        assert np.abs((jacobian.T @ residuals) / scale).max() < 1e-2
        chi2, dof = chi2 + best.chi2, dof + len(residuals) - len(x)
    assert abs(chi2 - dof) < 4.0 * np.sqrt(2.0 * dof)


def test_a_log_without_identities_has_no_optimum() -> None:
    unlabelled = replace(drive(), sources=np.full_like(drive().sources, UNLABELLED))
    with pytest.raises(ValueError, match="'arc': no measurement has an identity"):
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
