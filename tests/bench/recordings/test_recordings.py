"""Relocation on real data: how scans are judged, and what is counted."""

import importlib.util
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from slam_gym.association.relocation.location import locate
from slam_gym.bench.locality.acceptance import RULE
from slam_gym.bench.recordings import recordings
from slam_gym.bench.recordings.places import (
    LOCALITIES,
    Look,
    Place,
    gps_at,
    into_map,
    park,
    poses_apart,
    room,
    spread,
)
from slam_gym.bench.recordings.recordings import LEAST, Attempt, Setting, attempts, outcome, without_sizes
from slam_gym.geometry import compose, observe, transform, wrap_angle
from slam_gym.recordings.mrclam_groups import stationary
from slam_gym.types import NONE


def mapped(rng, moved, wrong=0):
    """A reference of 12 landmarks, and a map of them that lies `moved`, some made of something else."""
    landmarks = rng.uniform(-40.0, 40.0, (12, 2))
    positions = transform(moved, landmarks)
    positions[:wrong] += rng.uniform(60.0, 90.0, (wrong, 2))
    optimum = SimpleNamespace(ids=np.arange(100, 112), landmarks=landmarks)
    run = SimpleNamespace(sources=np.arange(100, 112), slam=SimpleNamespace(map=SimpleNamespace(positions=positions)))
    return optimum, run


@pytest.mark.parametrize("seed", range(40))
def test_the_reference_is_moved_into_the_map_as_its_features_were(seed):
    rng = np.random.default_rng(seed)
    moved = rng.uniform([-5, -5, -0.3], [5, 5, 0.3])
    optimum, run = mapped(rng, moved)
    pose = rng.uniform([-30, -30, -3], [30, 30, 3])
    np.testing.assert_allclose(into_map(optimum, run, pose, 80.0), moved, atol=1e-9)
    optimum, run = mapped(rng, moved, wrong=2)
    np.testing.assert_allclose(into_map(optimum, run, pose, 80.0), moved, atol=1e-9)
    run.sources[0] = NONE  # clutter has no place in the reference
    np.testing.assert_allclose(into_map(optimum, run, pose, 80.0), moved, atol=1e-9)


def test_only_the_surroundings_say_where_the_map_lies():
    """A map bent in the middle: each half is aligned with its own features."""
    rng = np.random.default_rng(0)
    optimum, run = mapped(rng, np.zeros(3))
    optimum.landmarks[:, 0] = np.where(np.arange(12) < 6, -100.0, 100.0) + 5.0 * rng.standard_normal(12)
    run.slam.map.positions = optimum.landmarks + np.where(np.arange(12) < 6, -1.0, 1.0)[:, None]
    for x, shift in ((-100.0, -1.0), (100.0, 1.0)):
        found = into_map(optimum, run, np.array([x, 0.0, 0.0]), 60.0)
        np.testing.assert_allclose(transform(found, np.array([[x, 0.0]]))[0], [x + shift, shift], atol=1e-9)


def test_gps_is_interpolated_between_near_fixes_only():
    log = SimpleNamespace(
        reference_times=np.array([0.0, 1.0, 10.0]), reference_poses=np.array([[0, 0, 0], [2, 4, 0], [9, 9, 0.0]])
    )
    np.testing.assert_allclose(gps_at(log, 0.25), [0.5, 1.0])
    for time in (-0.1, 5.0, 10.1):
        assert np.isnan(gps_at(log, time)).all()


@pytest.mark.parametrize("count", [1, 2, 5, 9, 10, 30])
def test_items_are_spread_in_their_order(count):
    items = list(range(10))
    chosen = spread(items, count)
    assert len(chosen) == min(count, 10) and chosen == sorted(set(chosen))
    assert count == 1 or (chosen[0], chosen[-1]) == (0, 9)


def test_groups_taken_have_moved_and_others_have_not(data_dir):
    cases = stationary(data_dir / "mrclam" / "stationary" / "mrclam1.mat")
    kept = poses_apart(cases)
    assert 100 < len(kept) < len(cases) / 5

    def moved(a, b):
        turn = abs(wrap_angle(float(cases.poses[a, 2] - cases.poses[b, 2])))
        return np.hypot(*(cases.poses[a, :2] - cases.poses[b, :2])) >= 0.1 or turn >= np.radians(5.0)

    last = 0
    for case in range(1, len(cases)):
        assert moved(case, last) == (case in set(kept))
        last = case if case in set(kept) else last


@pytest.fixture(scope="module")
def quarter(data_dir):
    """Places of the first 3000 steps of the park."""
    return park(data_dir / "victoria_park", ("JCBB", "true association"), 60, 3000)


def test_looks_inside_are_where_their_pairings_put_them(quarter):
    """Each searched for with the true pairings: what GCBB pairs at the reference pose puts the robot there."""
    for place in quarter:
        inside = [look for look in place.looks if look.inside]
        assert len(inside) == 60
        near = []
        for look in inside:
            seen = observe(look.pose, place.landmarks.positions)
            away = np.hypot(*(look.scan.points[:, None] - seen[None]).transpose(2, 0, 1))
            features = np.where(away.min(axis=1) < 1.0, away.argmin(axis=1), NONE)
            if len(set(features[features != NONE].tolist())) == (features != NONE).sum() >= 3:
                near.append(np.hypot(*(locate(look.scan, place.landmarks, features).pose - look.pose)[:2]))
        assert len(near) > 40 and np.percentile(near, 90) < 0.5


def test_gps_agrees_with_the_reference_to_metres(quarter):
    away = np.array([np.hypot(*(look.gps - look.pose[:2])) for look in quarter[0].looks])
    assert np.isfinite(away).sum() > 10 and np.nanmedian(away) < 4.0


def test_the_park_comes_with_all_localities_on_its_first_map(quarter):
    assert tuple(quarter[0].localities) == LOCALITIES and tuple(quarter[1].localities) == ("covisibility",)
    for name, locality in quarter[0].localities.items():
        assert (locality is None) == (name == "everything")
        assert locality is None or len(locality) == len(quarter[0].landmarks)


def test_groups_of_other_sets_were_not_measured_among_these_landmarks(data_dir):
    for place in room(data_dir / "mrclam" / "stationary", 50):
        errors = {True: [], False: []}
        for look in place.looks:
            seen = observe(look.pose, place.landmarks.positions)
            away = np.hypot(*(look.scan.points[:, None] - seen[None]).transpose(2, 0, 1)).min(axis=1)
            errors[look.inside].append(away.max())
        assert np.median(errors[True]) < 0.5 < 0.7 < np.median(errors[False])


def attempt(**changes):
    row = Attempt("p", "gcbb", "covisibility", True, True, 8, 5, 6, False, False, True, 0.1, 1.0, 2.0, 10, False, 1.0)
    return replace(row, **changes)


def test_every_scan_counts_once_and_answers_become_fewer():
    rng = np.random.default_rng(1)
    rows = [
        attempt(
            inside=bool(rng.random() < 0.6),
            pairings=int(rng.integers(0, 10)),
            right=bool(rng.random() < 0.5),
            accepted=bool(rng.random() < 0.3),
        )
        for _ in range(300)
    ]
    found = {least: outcome(rows, least) for least in LEAST}
    inside = sum(row.inside for row in rows)
    for o in found.values():
        assert (o.inside, o.outside) == (inside, 300 - inside)
    for least in range(4, 10):
        more, less = found[least - 1], found[least]
        assert more.right >= less.right and more.wrong >= less.wrong and more.wrong_outside >= less.wrong_outside
    assert found[RULE].right == sum(r.accepted and r.inside and r.right for r in rows)
    assert found[6].wrong == sum(r.pairings >= 6 and r.inside and not r.right for r in rows)


def test_without_sizes_nothing_else_is_forgotten(quarter):
    landmarks, scan = quarter[0].landmarks, quarter[0].looks[0].scan
    assert np.isfinite(landmarks.sizes).all() and np.isfinite(scan.sizes).all()
    for given in (landmarks, scan):
        bare = without_sizes(given)
        assert np.isnan(bare.sizes).all() and np.isnan(bare.size_variances).all()
        np.testing.assert_array_equal(bare.covariances, given.covariances)


def test_an_answer_is_right_within_the_bounds_of_its_place(quarter):
    """The same looks, with the pose that they are judged by moved away: nothing is right any more."""
    place = replace_looks(quarter[1], quarter[1].looks[:6], 0.0)
    moved = replace_looks(quarter[1], quarter[1].looks[:6], 5.0)
    setting = Setting(6, 0, 2000)
    here = [row for row in attempts([place], setting) if row.search == "gcbb" and row.sizes]
    there = [row for row in attempts([moved], setting) if row.search == "gcbb" and row.sizes]
    assert sum(row.right for row in here) >= 3 and not any(row.right for row in there)
    for a, b in zip(here, there):
        assert (a.pairings, a.nodes, a.accepted) == (b.pairings, b.nodes, b.accepted)


def replace_looks(place, looks, away):
    moved = [Look(l.scan, compose(l.pose, np.array([away, 0.0, 0.0])), l.inside, l.gps) for l in looks]
    return Place(place.name, place.landmarks, place.localities, moved, place.near)


def test_the_command_prints_its_tables_and_writes_files(data_dir, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(recordings, "QUICK", Setting(0, 20, 1000, ()))
    recordings.main(["--quick", "--data", str(data_dir), "--only", "room", "--out", str(tmp_path)])
    shown = capsys.readouterr().out
    for words in ("Answers by the least number", "Localities", "rule", ">= 6", "limit hit", "room, surveyed"):
        assert words in shown
    lines = (tmp_path / "relocations.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 1 + 40 * 3 * 3
    assert not importlib.util.find_spec("matplotlib") or (tmp_path / "answers.png").stat().st_size > 10_000


def test_without_data_the_command_asks_for_it(monkeypatch, capsys):
    monkeypatch.delenv("SLAM_GYM_DATA", raising=False)
    with pytest.raises(SystemExit):
        recordings.main([])
    assert "SLAM_GYM_DATA" in capsys.readouterr().err
