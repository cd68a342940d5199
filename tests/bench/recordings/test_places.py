"""Real places: where scans were taken, and which of them lie in the map."""

from types import SimpleNamespace

import numpy as np
import pytest

from slam_gym.association.relocation.location import locate
from slam_gym.bench.recordings.places import (
    LOCALITIES,
    PARK_NEAR,
    ROOM_NEAR,
    gps_at,
    into_map,
    map_log,
    park,
    poses_apart,
    reference,
    room,
    spread,
)
from slam_gym.geometry import observe, transform, wrap_angle
from slam_gym.recordings.mrclam import stationary
from slam_gym.recordings.victoria_park import victoria_park
from slam_gym.types import SPURIOUS, UNPAIRED


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
    run.sources[0] = SPURIOUS  # clutter has no place in the reference
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


def test_scans_inside_are_where_their_pairings_put_them(quarter):
    """Each searched for with the true pairings: what GCBB pairs at the reference pose puts the robot there."""
    for place in quarter:
        inside = [placed for placed in place.scans if placed.inside]
        assert len(inside) == 60
        near = []
        for placed in inside:
            seen = observe(placed.pose, place.landmarks.positions)
            away = np.hypot(*(placed.scan.points[:, None] - seen[None]).transpose(2, 0, 1))
            features = np.where(away.min(axis=1) < 1.0, away.argmin(axis=1), UNPAIRED)
            if len(set(features[features != UNPAIRED].tolist())) == (features != UNPAIRED).sum() >= 3:
                near.append(np.hypot(*(locate(placed.scan, place.landmarks, features).pose - placed.pose)[:2]))
        assert len(near) > 40 and np.percentile(near, 90) < 0.5


def test_gps_agrees_with_the_reference_to_metres(quarter):
    away = np.array([np.hypot(*(placed.gps - placed.pose[:2])) for placed in quarter[0].scans])
    assert np.isfinite(away).sum() > 10 and np.nanmedian(away) < 4.0


def test_the_park_comes_with_all_localities_on_its_first_map(quarter):
    assert tuple(quarter[0].localities) == LOCALITIES and tuple(quarter[1].localities) == ("covisibility",)
    assert [place.name for place in quarter] == ["park, map by JCBB", "park, map by true association"]
    assert all(place.near == PARK_NEAR for place in quarter)
    for name, locality in quarter[0].localities.items():
        assert (locality is None) == (name == "everything")
        assert locality is None or len(locality) == len(quarter[0].landmarks)


def test_groups_of_other_sets_were_not_measured_among_these_landmarks(data_dir):
    for place in room(data_dir / "mrclam" / "stationary", 50):
        assert place.near == ROOM_NEAR
        errors = {True: [], False: []}
        for placed in place.scans:
            seen = observe(placed.pose, place.landmarks.positions)
            away = np.hypot(*(placed.scan.points[:, None] - seen[None]).transpose(2, 0, 1)).min(axis=1)
            errors[placed.inside].append(away.max())
        assert np.median(errors[True]) < 0.5 < 0.7 < np.median(errors[False])


def test_a_log_is_mapped_and_its_reference_lies_near(data_dir):
    log = victoria_park(data_dir / "victoria_park").part(0, 300)
    mapped, optimum = map_log(log, "true_association"), reference(log)
    assert mapped.poses.shape == (300, 3) and len(mapped.sources) == mapped.slam.map.n
    labelled = mapped.sources[mapped.sources >= 0]
    assert len(labelled) > 50 and len(set(labelled.tolist())) == len(labelled)
    assert np.hypot(*(mapped.poses - optimum.poses)[:, :2].T).max() < 2.0
