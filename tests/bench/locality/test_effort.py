"""The law that the benchmark is about, and its command."""

import importlib.util

import numpy as np
import pytest

from slam_gym.bench.locality import effort
from slam_gym.bench.locality.effort import Workload, searches
from slam_gym.bench.locality.effort_tables import power
from slam_gym.bench.locality.hypothesis_count import hypotheses
from slam_gym.bench.locality.sweep import SweepSpec, sweep
from slam_gym.bench.records import column, grouped
from slam_gym.bench.runner import main


def test_pairing_tests_grow_linearly_under_locality_and_quadratically_without():
    """On small maps; counts, not times."""
    spec = SweepSpec(searches(), ("covisibility", "everything"), 10, 0, 1e12)
    attempts, localities = sweep(spec, [(200, 6), (400, 6), (800, 6)])
    assert len(attempts) == 12 * 10 and len(localities) == 18
    for key, series in grouped(attempts, "search", "locality"):
        exponent = power(series, "n", "pairing tests", np.random.default_rng(0)).estimate
        assert 0.7 < exponent < 1.35 if key["locality"] == "covisibility" else 1.7 < exponent < 2.35
        for point, group in grouped(series, "n", "m"):
            assert column(group, "nodes").mean() <= hypotheses(np.full(point["n"], point["n"]), point["m"])
            if key["locality"] == "everything":  # true pairings mostly pass gates of .99
                found = column(group, "right pairings").sum() / column(group, "true pairings").sum()
                assert found > 0.75 and column(group, "right").mean() > 0.75


def test_the_command_prints_its_tables_and_writes_files(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(effort, "QUICK", Workload((50, 100), (4, 6), 50, 4, 1e7, 6, (6,), 50))
    main(["locality", "--quick", "--out", str(tmp_path)])
    shown = capsys.readouterr().out
    for words in ("Equation 9.22", "Exponents in n", "Growth in m", "Gates", "Answers", "(n+1)^m", "rule"):
        assert words in shown
    counted = shown.split("one by one")[1].split("Localities")[0].strip().splitlines()
    assert counted[0].endswith("holds") and all(line.endswith("yes") for line in counted[1:])
    names = {path.name for path in tmp_path.iterdir()}
    assert {"bound.csv", "map_size.csv", "measurements.csv", "localities.csv", "settings.csv", "answers.csv"} <= names
    if importlib.util.find_spec("matplotlib"):
        assert {"map_size.png", "measurements.png", "losses.png", "answers.png"} <= names
    with pytest.raises(SystemExit):
        main(["locality", "--no-such-option"])
