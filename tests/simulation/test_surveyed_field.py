"""A surveyed field: the errors of its map are as large as the map says, and its scans show what is there."""

import numpy as np
import pytest

from slam_gym import UNPAIRED
from slam_gym.association.relocation.location import locate
from slam_gym.geometry import wrap_angle
from slam_gym.simulation.surveyed_field import LOCALITIES, REACH, surveyed_field


def test_distances_between_neighbours_are_as_certain_as_the_map_says_and_positions_are_not() -> None:
    errors, of_neighbours = [], []
    for seed in range(40):
        field = surveyed_field(150, np.random.default_rng(seed))
        m = field.landmarks
        off = m.positions - field.features
        row, other = np.repeat(np.arange(150), np.diff(m.block_starts)), m.block_columns
        kept = (row < other) & (np.hypot(*(m.positions[row] - m.positions[other]).T) < REACH)
        row, other, cross = row[kept], other[kept], m.blocks[kept, 0, 0]
        variance = m.covariances[row, 0, 0] + m.covariances[other, 0, 0] - 2.0 * cross
        errors.append(np.mean(off**2 / m.covariances[:, [0], [0]]))
        of_neighbours.append(np.mean((off[row] - off[other]) ** 2 / variance[:, None]))
        assert np.median(variance) < 0.4 * np.median(m.covariances[:, 0, 0])
    assert np.mean(errors) == pytest.approx(1.0, abs=0.3) and np.mean(of_neighbours) == pytest.approx(1.0, abs=0.1)


def test_scans_from_inside_show_features_in_reach_and_those_from_outside_none() -> None:
    rng = np.random.default_rng(1)
    field = surveyed_field(200, rng)
    for _ in range(10):
        drawn = field.scan_inside(8, 2, rng)
        assert len(drawn.scan) == 8 and (drawn.truth == UNPAIRED).sum() == 2
        error = locate(drawn.scan, field.landmarks, drawn.truth).pose - drawn.pose
        assert np.hypot(error[0], error[1]) < 2.0 and abs(wrap_angle(float(error[2]))) < 0.2
        off = field.scan_outside(8, rng)
        assert len(off.scan) == 8 and (off.truth == UNPAIRED).all() and np.isnan(off.pose).all()
        assert (np.hypot(*off.scan.points.T) < 1.1 * REACH).all()
    assert (field.scan_inside(3, 3, rng).truth == UNPAIRED).all()
    with pytest.raises(ValueError, match="spurious: 4"):
        field.scan_inside(3, 4, rng)


def test_every_locality_has_a_name_and_contains_the_feature_itself() -> None:
    field = surveyed_field(100, np.random.default_rng(2))
    for name in LOCALITIES:
        locality = field.locality(name)
        assert locality is None or all(j in locality.of(j) for j in range(100))
    with pytest.raises(ValueError, match="locality='rooms'; known: covisibility"):
        field.locality("rooms")
