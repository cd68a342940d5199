"""The errors of a map are what it states."""

import itertools

import numpy as np
import pytest

from slam_gym.bench.locality.fields import surveyed_field
from slam_gym.bench.locality.mapping_pass import FieldSpec, lawn_mower_pass, sightings, station_covariance
from slam_gym.geometry import observe


def dense(landmarks):
    """(2n, 2n) from the blocks; only where all pairs have one."""
    n = len(landmarks)
    assert len(landmarks.blocks) == n * n
    return landmarks.blocks.reshape(n, n, 2, 2).transpose(0, 2, 1, 3).reshape(2 * n, 2 * n)


def test_map_errors_have_the_covariance_that_the_map_states():
    """NEES over maps of 8 features, all pairs of which a scan can span: its mean is 2n within sampling error."""
    nees, n = [], 8
    for seed in range(300):
        area = surveyed_field(n, np.random.default_rng(seed))
        P = dense(area.landmarks)
        np.testing.assert_allclose(P, P.T, atol=1e-12)
        error = (area.landmarks.positions - area.features).ravel()
        nees.append(error @ np.linalg.solve(P, error))
    assert np.mean(nees) == pytest.approx(2 * n, abs=4.0 * np.sqrt(4 * n / 300))


@pytest.mark.parametrize("seed", range(4))
def test_blocks_are_kept_for_all_pairs_that_a_scan_can_span_both_ways(seed):
    area = surveyed_field(150, np.random.default_rng(seed))
    landmarks = area.landmarks
    row = np.repeat(np.arange(150), np.diff(landmarks.block_starts))
    blocks = {(j, l): block for j, l, block in zip(row.tolist(), landmarks.block_columns.tolist(), landmarks.blocks)}
    for j, l in itertools.combinations(range(150), 2):
        if np.hypot(*(area.features[j] - area.features[l])) < 2.0 * area.spec.reach:
            np.testing.assert_allclose(blocks[j, l], blocks[l, j].T, atol=1e-12)
            spread = landmarks.covariances[j] + landmarks.covariances[l] - blocks[j, l] - blocks[l, j]
            assert np.linalg.eigvalsh(spread).min() > 0.0
            # errors are shared: neighbours are known better relative to each other than either in the map
            assert np.trace(blocks[j, l]) > 0.0


@pytest.mark.parametrize("side", [10.0, 50.0, 200.0])
def test_the_pass_covers_the_square_and_looks_where_it_drives(side):
    spec = FieldSpec()
    way = lawn_mower_pass(side, spec)
    assert (np.diff(way.arcs) > 0.0).all() and way.poses[:, :2].min() >= 0.0 and way.poses[:, :2].max() <= side
    ahead = np.column_stack([np.cos(way.poses[:-1, 2]), np.sin(way.poses[:-1, 2])])
    assert ((np.diff(way.poses[:, :2], axis=0) * ahead).sum(axis=1) >= -1e-9).all()
    heights = np.unique(way.poses[np.abs(np.sin(way.poses[:, 2])) < 0.5, 1])
    assert np.diff([-heights[0], *heights, 2 * side - heights[-1]]).max() <= spec.lane + 1e-9


def test_sightings_are_of_what_lies_near_and_ahead():
    rng = np.random.default_rng(0)
    features, poses = rng.uniform(0.0, 40.0, (80, 2)), rng.uniform([0, 0, -3], [40, 40, 3], (20, 3))
    for pose, seen in zip(poses, sightings(features, poses, 9.0)):
        local = observe(pose, features)
        assert seen.tolist() == np.flatnonzero((np.hypot(*local.T) <= 9.0) & (local[:, 0] >= 0.0)).tolist()


def test_drift_grows_along_the_pass_and_little_between_neighbours():
    spec = FieldSpec()
    K = station_covariance(lawn_mower_pass(150.0, spec), spec)
    assert np.linalg.eigvalsh(K).min() > 0.0 and K[0, 0] < K[-1, -1]
    steps = [K[k, k] + K[k + 1, k + 1] - 2.0 * K[k, k + 1] for k in range(len(K) - 1)]
    assert max(steps) <= spec.along**2 * (1 + 1e-9) < K[-1, -1]
