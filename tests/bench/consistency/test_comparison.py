"""Figures tell good estimators from bad ones: tables and the command."""

import numpy as np
import pytest

from slam_gym.bench.consistency import comparison
from slam_gym.bench.consistency.comparison import CLOSED, Workload, differences_table, park_estimates, runs_table
from slam_gym.bench.consistency.estimators import ASSOCIATORS, METHODS
from slam_gym.bench.consistency.logs import LoopSpec
from slam_gym.bench.runner import main
from slam_gym.metrics.statistics import Interval

SHORT = LoopSpec(heading=1.0, side=12, spacing=4.0)


def made_up(world, seed, method, associator, **changes):
    figures = ("ANEES", "error [m]", "final [m]", "final [°]", "heading σ [°]", "map RMSE [m]", "seconds", "GPS [m]")
    record = {"world": world, "seed": seed, "method": method, "associator": associator, **dict.fromkeys(figures, 1.0)}
    return record | {"optimistic": 0.0, "duplicates": 0, "features": 10} | changes


def test_differences_are_paired_by_seed():
    """Runs that differ by a constant from seed to seed alike: the interval has no width, whatever the seeds do."""
    rng, records = np.random.default_rng(0), []
    for seed in rng.permutation(9).tolist():
        level = float(rng.uniform(0.0, 50.0))
        for shift, method in zip((0.0, 2.0, -1.0, -1.0), METHODS, strict=True):
            changes = {"error [m]": level + shift, "duplicates": seed if shift else seed + 1}
            records += [made_up("loop", seed, method, a, **changes) for a in ASSOCIATORS]
    by_method = [record for method in METHODS for record in records if record["method"] == method]
    rows = differences_table(by_method)
    assert len(rows) == 6
    for row in rows:
        shift = 2.0 if row["method"] == METHODS[1] else -1.0
        found = row["error [m]"]
        assert (found.estimate, found.low, found.high) == pytest.approx((shift, shift, shift))
        assert row["duplicates"] == Interval(-1.0, -1.0, -1.0) and row["log10 ANEES"] == Interval(0.0, 0.0, 0.0)


def test_a_loop_with_many_duplicates_is_not_closed():
    records = [
        made_up("loop", s, m, a, duplicates=CLOSED * (s % 2)) for s in range(8) for m in METHODS for a in ASSOCIATORS
    ]
    assert all(row["closed"].estimate == 0.5 for row in runs_table(records))
    assert all(row["closed"] == "" for row in runs_table([record | {"world": "hall"} for record in records]))


def test_the_command_prints_its_tables_and_says_what_it_leaves_out(monkeypatch, tmp_path, capsys):
    monkeypatch.delenv("SLAM_GYM_DATA", raising=False)
    monkeypatch.setattr(comparison, "QUICK", Workload(3, 1, 30, 1, 30, 100, (SHORT,)))
    main(["consistency", "--quick", "--out", str(tmp_path)])
    shown = capsys.readouterr().out
    for words in (
        "park: left out, no data",
        "floor: left out",
        "right-invariant",
        "Differences",
        "loop, 1°",
    ):
        assert words in shown
    assert len((tmp_path / "consistency.csv").read_text(encoding="utf-8").splitlines()) == 1 + 4 * 6
    with pytest.raises(SystemExit):
        main(["consistency", "--quick", "--only", "park"])
    assert "nothing was run" in capsys.readouterr().err


def test_the_park_is_compared_with_the_reference_and_the_gps(data_dir):
    records = park_estimates(data_dir / "victoria_park", 600)
    assert len(records) == 6
    for record in records:
        assert record["error [m]"] < 3.0 and record["GPS [m]"] < 6.0 and record["ANEES"] < 3.0
