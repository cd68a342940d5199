"""Floors of equal density, on which line of sight is timed."""

import numpy as np
import pytest

from slam_gym.bench.runner import main
from slam_gym.bench.speed.sight import BEAMS, DOOR, PLACES, ROOM, floor, interior_poses, sight_calls


@pytest.mark.parametrize(("rows", "columns", "segments"), [(5, 5, 100), (25, 50, 5000)])
def test_floors_have_their_walls_and_jambs(rows, columns, segments):
    plan = floor(rows, columns)
    assert len(plan.walls) == segments
    outer, inner = 2 * (rows + columns), rows * (columns - 1) + columns * (rows - 1)
    lengths = np.hypot(*(plan.walls[:, 2:] - plan.walls[:, :2]).T)
    assert lengths.sum() == pytest.approx(outer * ROOM + inner * (ROOM - DOOR))
    assert len(plan.features) == 2 * inner


def test_places_are_in_rooms_with_neighbours_all_around_and_away_from_walls():
    poses = interior_poses(6, 8, np.random.default_rng(0))
    assert len(poses) == PLACES
    within = poses[:, :2] % ROOM
    assert within.min() >= 0.3 and within.max() <= ROOM - 0.3
    assert poses[:, 0].min() >= ROOM and poses[:, 0].max() <= 7 * ROOM and poses[:, 1].max() <= 5 * ROOM


def test_everything_seen_is_seen_from_every_place():
    rng = np.random.default_rng(0)
    calls = sight_calls(floor(4, 4), interior_poses(4, 4, rng), rng)
    for name in (f"{BEAMS} beams", "features in range"):
        np.testing.assert_array_equal(calls[name](3), calls[name](PLACES + 3))
    assert calls["features in range"](3).any()
    scan, _ = calls["Sensor.scan"](PLACES + 3)
    assert len(scan) > 0 and calls["Sensor.beams"](PLACES + 3).ranges.min() > 0.0


def test_the_command_has_both_floors_and_a_tick(monkeypatch, capsys):
    monkeypatch.setattr("slam_gym.bench.speed.sight.PLACES", 5)
    main(["sight", "--repeats", "1"])
    shown = capsys.readouterr().out
    assert "5 000 segments" in shown and "40 beams" in shown and "World.tick" in shown
