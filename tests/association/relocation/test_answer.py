"""What every relocator answers: inside and outside the map, alike places, limits, bad numbers."""

from dataclasses import replace

import numpy as np
import pytest

from slam_gym.association import RELOCATORS
from slam_gym.geometry import wrap_angle
from slam_gym.types import Locality
from tests.oracles import relocation as oracles

NAMES = ["gcbb", "max_clique", "random_sampling"]


@pytest.mark.parametrize("name", NAMES)
def test_the_robot_is_found_inside_the_map_and_not_outside(name):
    search, right = RELOCATORS[name], 0
    for seed in range(25):
        pose, scan, landmarks = oracles.inside(seed)
        found = search(scan, landmarks, None)
        error = found.pose - pose
        right += found.accepted and np.hypot(*error[:2]) < 0.3 and abs(wrap_angle(error[2])) < np.radians(3.0)
        assert not search(oracles.inside(seed + 100)[1], landmarks, None).accepted
    assert right >= 22


@pytest.mark.parametrize("name", NAMES)
def test_a_mirrored_map_is_not_taken_for_the_map(name):
    _, scan, landmarks = oracles.inside(1, m=9, true=9)
    mirrored = replace(landmarks, positions=landmarks.positions * [1.0, -1.0], covariance=np.empty((0, 0)))
    assert not RELOCATORS[name](scan, mirrored, None).accepted


@pytest.mark.parametrize("name", [*NAMES, "indexed"])
@pytest.mark.parametrize(("apart", "common"), [(80.0, 0.0), (80.0, 1.0), (1.6, 0.5)])
def test_two_equal_rooms_are_ambiguous_however_uncertain_the_whole_map_is(name, apart, common):
    _, scan, landmarks = oracles.inside(2, m=8, true=8, n=16, keep="none")
    rooms = np.vstack([landmarks.positions, landmarks.positions + np.array([apart, 0.0])])
    twice = oracles.landmarks_of(rooms, 0.002 * np.eye(64) + np.tile(common**2 * np.eye(2), (32, 32)))
    found = RELOCATORS[name](scan, twice, None)
    assert found.pairings >= 7 and found.ambiguous and found.ties >= 1 and not found.accepted


@pytest.mark.parametrize("name", [*NAMES, "indexed"])
@pytest.mark.parametrize("m", [0, 1, 2, 6])
@pytest.mark.parametrize("n", [0, 1, 3])
def test_few_measurements_and_few_features_have_a_defined_answer(name, m, n):
    rng = np.random.default_rng(m)
    scan = oracles.scan_of(rng.uniform(-3, 3, (m, 2)), np.tile(0.01 * np.eye(2), (m, 1, 1)))
    landmarks = oracles.landmarks_of(rng.uniform(-3, 3, (n, 2)), 0.01 * np.eye(2 * n), keep="none")
    found = RELOCATORS[name](scan, landmarks, None)
    assert found.features.shape == (m,) and found.pairings <= min(m, n) and not found.accepted
    assert found.min_pairings >= 3 and (found.pairings >= 2 or np.isnan(found.pose).all())


@pytest.mark.parametrize("name", NAMES)
def test_a_line_duplicates_and_exact_points_have_a_defined_answer(name):
    line = np.column_stack([np.arange(5.0), np.zeros(5)])
    doubled = np.vstack([line, line])
    for points, places, variance in ((line, line, 0.01), (line, doubled, 0.01), (line * [1.3, 1.0], line, 0.0)):
        scan = oracles.scan_of(points, np.tile(variance * np.eye(2), (5, 1, 1)))
        found = RELOCATORS[name](scan, oracles.landmarks_of(places, variance * np.eye(2 * len(places))), None)
        assert found.pairings != 1 and np.isfinite(found.joint_distance)
        assert np.isfinite(found.pose).all() or found.pairings == 0


@pytest.mark.parametrize("name", NAMES)
def test_limits_are_reported(name):
    _, scan, landmarks = oracles.inside(0)
    found = RELOCATORS[name](scan, landmarks, None, node_limit=50)
    assert found.effort.limit_hit
    assert not RELOCATORS[name](scan, landmarks, None).effort.limit_hit
    assert found.effort.unary_tests > 0 and found.effort.seconds > 0.0


@pytest.mark.parametrize("name", [*NAMES, "indexed"])
def test_bad_numbers_are_refused_by_name(name):
    _, scan, landmarks = oracles.inside(0, n=20)
    search, points, P = RELOCATORS[name], scan.points.copy(), landmarks.covariances.copy()
    points[3, 0], P[5] = np.nan, [[1.0, 2.0], [2.0, 1.0]]
    with pytest.raises(ValueError, match="measurement 3"):
        search(replace(scan, points=points), landmarks, None)
    with pytest.raises(ValueError, match=r"covariances\[5\]"):
        search(scan, replace(landmarks, covariances=P), None)
    with pytest.raises(ValueError, match=r"Locality.starts"):
        search(scan, landmarks, Locality(np.zeros(3, np.int64), np.empty(0, np.int64)))
    with pytest.raises(ValueError, match=r"Locality.members"):
        search(scan, landmarks, Locality(np.arange(21), np.full(20, 20)))
