"""The logs on which estimators are compared are what they say."""

import itertools
import math

import numpy as np
import pytest

from slam_gym.bench.consistency.logs import LoopSpec, explored, floor, hall, loop, park
from slam_gym.geometry import observe, relative, wrap_angle
from slam_gym.scenarios import get_scenario

SHORT = LoopSpec(heading=1.0, side=12, spacing=4.0)


def test_the_loop_ends_where_it_has_been_and_its_odometry_is_off_as_it_says():
    nees, steps = [], 0
    for seed in range(20):
        driven = loop(seed, SHORT).steps
        assert len(driven) == 61
        np.testing.assert_allclose(driven[48][2].pose, [0.0, 0.0, 0.0], atol=1e-9)
        for (_, _, before), (odometry, _, after) in itertools.pairwise(driven):
            error = odometry.motion - relative(before.pose, after.pose)
            error[2] = wrap_angle(error[2])
            nees.append(error @ np.linalg.solve(odometry.covariance, error))
            steps += 1
    assert np.mean(nees) == pytest.approx(3.0, abs=4.0 * math.sqrt(6.0 / steps))


def test_the_loop_shows_features_of_its_walls_with_the_noise_it_states():
    nees = []
    for seed in range(10):
        log = loop(seed, SHORT)
        features = np.array([log.landmarks[k] for k in range(len(log.landmarks))])
        off = np.abs(features - 0.5 * SHORT.side).max(axis=1) - 0.5 * SHORT.side
        assert np.isclose(np.abs(off), 0.5 * SHORT.width).all() and {*np.sign(off)} == {-1.0, 1.0}
        for _, scan, truth in log.steps:
            seen = observe(truth.pose, features[truth.sources])
            assert (np.hypot(*seen.T) <= SHORT.reach).all() and (seen[:, 0] >= -1e-9).all()
            nees += [e @ np.linalg.solve(R, e) for e, R in zip(scan.points - seen, scan.covariances)]
    assert np.mean(nees) == pytest.approx(2.0, abs=0.15)


def test_an_exploration_is_written_down_tick_by_tick():
    log = explored("the hall", 0, get_scenario("hall"), 40)
    again = hall(0, 40)
    assert log.world == "the hall" and len(log.steps) == len(again.steps) == 41
    for (odometry, scan, truth), (_, same, _) in zip(log.steps, again.steps):
        np.testing.assert_array_equal(scan.points, same.points)
        assert np.isfinite(odometry.motion).all() and len(truth.sources) == len(scan)
        real = truth.sources >= 0
        seen = observe(truth.pose, np.array([log.landmarks[k] for k in truth.sources[real].tolist()]).reshape(-1, 2))
        assert (np.hypot(*(seen - scan.points[real]).T) < 1.0).all()


def test_a_floor_plan_is_explored_likewise(data_dir):
    log = floor(data_dir / "willow_garage" / "willow-full.pgm", 0, 20)
    assert log.world == "willow-full" and len(log.steps) == 21 and len(log.landmarks) > 100


def test_the_park_comes_with_its_reference_and_its_recording(data_dir):
    log, recording = park(data_dir / "victoria_park", 300)
    assert len(log.steps) == len(recording) == 300
    assert (np.diff(log.checked) > 0).all() and log.checked[-1] == 299 and len(log.checked) == log.checkpoints
    known = {source for _, _, truth in log.steps for source in truth.sources.tolist() if source >= 0}
    assert known <= set(log.landmarks)
