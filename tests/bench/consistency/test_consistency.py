"""The benchmark of consistency: its worlds are what they say, and its figures tell good estimators from bad ones."""

import importlib.util
import itertools
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from slam_gym.bench.consistency import consistency
from slam_gym.bench.consistency.consistency import CLOSED, Setting, paired_table, runs_table
from slam_gym.bench.consistency.runs import ASSOCIATORS, METHODS, Result, run, true_duplicates
from slam_gym.bench.consistency.worlds import LoopSpec, hall, loop
from slam_gym.geometry import observe, relative, wrap_angle
from slam_gym.types import NONE, Odometry

SHORT = LoopSpec(heading=1.0, side=12, spacing=4.0)


def test_the_loop_ends_where_it_has_been_and_its_odometry_is_off_as_it_says():
    nees, steps = [], 0
    for seed in range(20):
        looks = loop(seed, SHORT).looks
        assert len(looks) == 61
        np.testing.assert_allclose(looks[48][2].pose, [0.0, 0.0, 0.0], atol=1e-9)
        for (_, _, before), (odometry, _, after) in itertools.pairwise(looks):
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
        for _, scan, truth in log.looks:
            seen = observe(truth.pose, features[truth.sources])
            assert (np.hypot(*seen.T) <= SHORT.reach).all() and (seen[:, 0] >= -1e-9).all()
            nees += [e @ np.linalg.solve(R, e) for e, R in zip(scan.points - seen, scan.covariances)]
    assert np.mean(nees) == pytest.approx(2.0, abs=0.15)


def test_the_same_seed_gives_the_same_log_and_the_same_result():
    first, second = (run(loop(3, SHORT), "local maps", "jcbb")[0] for _ in range(2))
    assert replace(first, seconds=0.0, gps=0.0) == replace(second, seconds=0.0, gps=0.0)


@pytest.mark.parametrize("method", METHODS)
def test_with_little_noise_every_estimator_is_consistent(method):
    quiet = replace(SHORT, heading=0.1, along=0.01)
    results = [run(loop(seed, quiet), method, "true association")[0] for seed in range(12)]
    assert all(r.duplicates == 0 and r.final < 0.3 and r.landmarks < 0.3 for r in results)
    assert 0.5 < np.mean([r.anees for r in results]) < 1.6


@pytest.mark.parametrize("method", METHODS)
def test_a_filter_that_is_told_too_little_noise_is_found_out(method):
    log = loop(0, SHORT)
    told = [(Odometry(o.motion, 0.01 * o.covariance), s, t) for o, s, t in log.looks]
    honest, lied = (run(each, method, "true association")[0] for each in (log, replace(log, looks=told)))
    assert lied.anees > 3.0 > honest.anees and lied.optimistic > honest.optimistic


def test_first_estimates_are_the_estimates_where_nothing_is_ever_corrected():
    """Without noise, both EKFs are the same filter."""
    log = loop(1, replace(SHORT, heading=1e-6, along=1e-8))
    exact = [(Odometry(o.motion, o.covariance), s, t) for o, s, t in log.looks]
    a, b = (run(replace(log, looks=exact), m, "true association") for m in METHODS[:2])
    np.testing.assert_allclose(a[2], b[2], atol=1e-4)


def test_the_truth_joins_each_source_once():
    sources = np.array([5, 5, 7, NONE, 9, 5, 7, 7, NONE, 11])
    identities = SimpleNamespace(source_of=lambda ids: sources[ids])
    joined = SimpleNamespace(ids=np.arange(10))
    found = true_duplicates(joined, np.arange(5), np.arange(5, 10), identities=identities)
    assert found.pairs.tolist() == [[0, 5], [2, 6]]
    nothing = true_duplicates(joined, np.arange(0), np.arange(10), identities=identities)
    assert nothing.pairs.shape == (0, 2)


def test_what_is_driven_does_not_depend_on_who_looks_at_it():
    log = hall(0, 60)
    assert len(log.looks) == 61
    before = [scan.points.copy() for _, scan, _ in log.looks]
    for method in METHODS:
        assert run(log, method, "jcbb")[0].error < 0.3
    for points, (_, scan, _) in zip(before, log.looks):
        np.testing.assert_array_equal(points, scan.points)


def made_up(world, seed, method, associator, **changes):
    values = dict(
        anees=1.0, optimistic=0.0, error=1.0, final=1.0, final_degrees=1.0, claimed=1.0, landmarks=1.0, duplicates=0,
        features=10, seconds=1.0,
    )  # fmt: skip
    return Result(world, seed, method, associator, **(values | changes))


def test_differences_are_paired_by_seed():
    """Runs that differ by a constant from seed to seed alike: the interval has no width, whatever the seeds do."""
    rng, rows = np.random.default_rng(0), []
    for seed in rng.permutation(9).tolist():
        level = float(rng.uniform(0.0, 50.0))
        for shift, method in zip((0.0, 2.0, -1.0), METHODS):
            rows += [
                made_up("loop", seed, method, a, error=level + shift, duplicates=seed if shift else seed + 1)
                for a in ASSOCIATORS
            ]
    rows = [rows[i] for i in rng.permutation(len(rows)).tolist()]
    columns, table = paired_table(rows)
    assert len(table) == 4
    for line in table:
        at = dict(zip(columns, line))
        assert at["error [m]"] == ("+2.00 [+2.00, +2.00]" if at["method"] == METHODS[1] else "-1.00 [-1.00, -1.00]")
        assert at["duplicates"] == "-1.00 [-1.00, -1.00]" and at["log10 ANEES"] == "+0.00 [+0.00, +0.00]"


def test_a_loop_with_many_duplicates_is_not_closed():
    rows = [
        made_up("loop", s, m, a, duplicates=CLOSED * (s % 2)) for s in range(8) for m in METHODS for a in ASSOCIATORS
    ]
    columns, table = runs_table(rows)
    assert all(dict(zip(columns, line))["closed"].startswith("0.500") for line in table)


def test_the_command_prints_its_tables_and_says_what_it_leaves_out(monkeypatch, tmp_path, capsys):
    monkeypatch.delenv("SLAM_GYM_DATA", raising=False)
    monkeypatch.setattr(consistency, "QUICK", Setting(3, 1, 30, 1, 30, 100, (SHORT,)))
    consistency.main(["--quick", "--out", str(tmp_path)])
    shown = capsys.readouterr().out
    for words in ("park: left out, no data", "floor: left out", "first estimates", "Differences", "loop, 1°"):
        assert words in shown
    assert len((tmp_path / "consistency.csv").read_text(encoding="utf-8").splitlines()) == 1 + 4 * 6
    assert not importlib.util.find_spec("matplotlib") or (tmp_path / "consistency.png").stat().st_size > 10_000


def test_the_park_is_compared_with_the_reference_and_the_gps(data_dir):
    rows = consistency.park_results(data_dir / "victoria_park", 600)
    assert len(rows) == 6
    for row in rows:
        assert row.error < 3.0 and row.gps < 6.0 and row.anees < 3.0
