"""The curve over the size of the map."""

import csv

import numpy as np
import pytest

from slam_gym.bench.runner import main
from slam_gym.bench.speed.scale import large_slam


def test_every_size_has_a_row_of_steps_that_pair_what_they_see(tmp_path, capsys) -> None:
    main(
        ["scale", "--features", "20", "60", "--steps", "2", "--drives", "60", "--per_map", "20", "--out", str(tmp_path)]
    )
    with (tmp_path / "scale.csv").open(encoding="utf-8") as file:
        rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
    assert [row["features"] for row in rows] == [20, 60]
    for row in rows:
        assert row["pairings"] == pytest.approx(10.0, abs=1.0)
        assert row["steps/s"] * row["step ms"] == pytest.approx(1e3) and row["dsyrk ms"] > 0.0
        assert row["triangle MB"] == pytest.approx(0.5 * 8e-6 * (3 + 2 * row["features"]) ** 2)
    with (tmp_path / "scale_drives.csv").open(encoding="utf-8") as file:
        one, local = csv.DictReader(file)
    assert (one["map"], local["map"]) == ("one", "local") and int(local["maps"]) > 1
    assert one["steps"] == local["steps"] and float(local["off m"]) < 1.0
    assert int(local["duplicates, joined"]) < int(local["duplicates"])  # lanes see what the ones beside them have seen


def test_the_robot_stands_amid_neighbours_that_were_seen_together() -> None:
    slam = large_slam(80, np.random.default_rng(0))
    positions, edges = slam.map.positions, slam.covisibility.edges().pairs
    apart = np.hypot(*(positions[edges[:, 0]] - positions[edges[:, 1]]).T)
    assert slam.map.n == 80 and apart.max() <= 6.0 and len(edges) > 80
