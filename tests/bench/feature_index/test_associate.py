"""The feature index against the size of the map, and the command."""

import numpy as np

from slam_gym.association.triangles.index import FeatureIndex
from slam_gym.bench.feature_index import associate
from slam_gym.bench.feature_index.associate import TARGETS, Workload, growth, loop_closure, relocations, scaling
from slam_gym.bench.feature_index.problems import QueryKind, point_map, query
from slam_gym.bench.runner import main


def test_a_row_of_growth_is_of_the_whole_map():
    row = growth(150, np.random.default_rng(0))
    assert row["n"] == 150 and row["triangles each"] > 5.0 and row["longest [ms]"] * 1e3 >= row["mean"]


def test_right_and_wrong_are_accepted_answers():
    rng = np.random.default_rng(1)
    truth, landmarks = point_map(300, rng)
    index = FeatureIndex(landmarks)
    inside = relocations(index, [query(truth, QueryKind(15, 0.0, False), rng) for _ in range(6)])
    assert inside["right"] == 1.0 and inside["wrong"] == 0.0
    outside = relocations(index, [query(truth, QueryKind(10, 0.3, False, inside=False), rng) for _ in range(6)])
    assert outside["right"] == 0.0 and outside["wrong"] + outside["ambiguous"] <= 1.0


def test_targets_are_of_sizes_and_of_sides():
    rows = scaling((1_000,), 1, np.random.default_rng(2))
    assert len(rows) == 11
    assert {row["target [ms]"] for row in rows if row["inside"]} == {TARGETS[1_000][0]}
    assert {row["target [ms]"] for row in rows if not row["inside"]} == {TARGETS[1_000][1]}


def test_jcbb_closes_loops_in_a_large_map():
    row = loop_closure(6, np.random.default_rng(3))
    assert row["problems"] == 6 and row["candidates each"] > 2.0 and row["scans exact"] >= 0.5


def test_the_command_writes_five_tables(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(associate, "QUICK", Workload((100,), 1, (60,), 1, 0.0, 1, 2))
    main(["associate", "--quick", "--out", str(tmp_path)])
    names = {f"associate_{name}.csv" for name in ("growth", "scaling", "cliques", "slam", "jcbb")}
    assert {path.name for path in tmp_path.iterdir()} == names
    shown = capsys.readouterr().out
    assert all(words in shown for words in ("corridor", "office, explored", "grown", "candidates each"))
