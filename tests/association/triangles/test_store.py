"""What an index remembers, against all triples of features, before and after some are dropped; and how much room."""

import numpy as np

from slam_gym.association.triangles.index import FeatureIndex
from slam_gym.association.triangles.store import COUNT, START, bit_number, enter_grid, features_around, paint, place_of
from tests.association.triangles.small_maps import (
    SIGMA,
    assert_same,
    field,
    landmarks_at,
    store_of,
    triangles_within,
    view,
)


def test_growing_it_feature_by_feature_changes_nothing() -> None:
    rng = np.random.default_rng(7)
    truth = field(rng, 150)
    landmarks = landmarks_at(truth + SIGMA * rng.standard_normal(truth.shape))
    whole = FeatureIndex(landmarks, reach=11.0, noise=0.07)
    grown = FeatureIndex(reach=11.0, noise=0.07)
    for j in range(150):
        assert grown.add(landmarks.positions[j : j + 1], landmarks.covariances[j : j + 1]).tolist() == [j]
    assert grown.triangles == whole.triangles > 1000
    for _ in range(40):
        scan, _, _ = view(rng, truth, 10, 3)
        assert_same(whole.relocate(scan), grown.relocate(scan))


def test_dropping_features_is_as_if_they_had_never_been() -> None:
    rng = np.random.default_rng(8)
    truth = field(rng, 200)
    landmarks = landmarks_at(truth)
    index = FeatureIndex(landmarks, reach=11.0, noise=0.07)
    kept = np.flatnonzero(rng.random(200) < 0.7)
    index.keep(kept)
    fresh = FeatureIndex(landmarks_at(truth[kept]), reach=11.0, noise=0.07)
    assert index.triangles == fresh.triangles and index.n == fresh.n == len(kept)
    for extra in (index, fresh):
        extra.add(truth[:5] + 100.0, np.tile(1e-4 * np.eye(2), (5, 1, 1)))
    for _ in range(40):
        scan, _, _ = view(rng, truth[kept], 10, 2)
        assert_same(index.relocate(scan), fresh.relocate(scan))


def test_memory_is_bounded_by_the_number_of_features() -> None:
    rng = np.random.default_rng(14)
    spread = FeatureIndex(landmarks_at(field(rng, 2000)))
    assert spread.nbytes <= 2048 * 2000 and spread.truncated == 0
    crowd = FeatureIndex(landmarks_at(rng.uniform(0.0, 5.0, (2000, 2))), reach=11.0, noise=0.07)
    assert crowd.nbytes <= 3072 * 2000 and crowd.truncated > 0
    line = np.column_stack([np.arange(2000) * 1e3, np.zeros(2000)])
    assert FeatureIndex(landmarks_at(line), reach=11.0, noise=0.07).nbytes <= 2048 * 2000


def test_features_that_crowd_take_what_others_leave_where_the_reach_was_chosen_for_all() -> None:
    """Along streets some stand close and others do not, whichever come first."""
    rng = np.random.default_rng(15)
    crowded, scattered = rng.uniform(0.0, [40.0, 4.0], (80, 2)), rng.uniform(100.0, [300.0, 300.0], (160, 2))
    for positions in (np.concatenate([crowded, scattered]), np.concatenate([scattered, crowded])):
        index = FeatureIndex(landmarks_at(positions))
        assert index.truncated == 0 and index.triangles <= 64 * len(positions)
        triangles = FeatureIndex(landmarks_at(positions), reach=index.reach, triangles=1e4).triangles
        assert index.triangles == triangles


def _entered(index: FeatureIndex) -> list[tuple[int, list[int]]]:
    """Cell, and the three features, of each triangle in the pool."""
    store = store_of(index)
    return [
        (cell, entry[:3].tolist())
        for cell, row in enumerate(store.cells)
        for entry in store.pool[row[START] : row[START] + row[COUNT]]
    ]


def test_triangles_entered_are_those_of_all_near_features_and_those_of_dropped_ones_are_gone() -> None:
    rng = np.random.default_rng(40)
    positions = field(rng, 70)
    index = FeatureIndex(landmarks_at(positions), reach=10.0, noise=0.07, triangles=1e4)
    for kept in (np.arange(70), np.flatnonzero(rng.random(70) < 0.6), np.array([2, 3])):
        if len(kept) < index.n:
            index.keep(kept)
            positions = positions[kept]
        entered = _entered(index)
        triples = [frozenset(corners) for _, corners in entered]
        assert len(triples) == len(set(triples)) == index.triangles
        assert set(triples) == triangles_within(positions, 10.0)
        for cell, corners in entered:
            *same, place, _ = place_of(positions, *corners, store_of(index).settings[2])
            assert same == corners and place == cell


def test_features_around_a_place_are_those_within_the_radius_wherever_the_grid_wraps() -> None:
    rng = np.random.default_rng(41)
    positions = rng.uniform(-40.0, 40.0, (300, 2))
    heads, following, found = np.full((8, 8), -1, np.int32), np.empty(300, np.int32), np.empty(300, np.int64)
    enter_grid(heads, following, 3.0, positions, 0, 300)
    for _ in range(50):
        x, y, radius = *rng.uniform(-45.0, 45.0, 2), rng.uniform(0.5, 30.0)
        count = features_around(heads, following, 3.0, positions, x, y, radius, found)
        near = np.flatnonzero(np.hypot(*(positions - [x, y]).T) <= radius)
        assert np.array_equal(np.sort(found[:count]), near)


def test_a_disc_painted_covers_all_its_points_and_little_else() -> None:
    rng, power, size = np.random.default_rng(42), 6, 0.5
    for _ in range(20):
        bits = np.zeros(1 << (2 * power - 5), np.uint32)
        at, radius = rng.uniform(-50.0, 50.0, 2), rng.uniform(0.1, 5.0)
        paint(bits, power, size, *at, radius)
        places = at + rng.uniform(-8.0, 8.0, (500, 2))
        columns, rows = (np.floor(places.T / size).astype(int)) & ((1 << power) - 1)
        numbers = np.array([bit_number(column, row, power) for column, row in zip(columns, rows)])
        painted = (bits[numbers >> 5] >> (numbers & 31) & 1).astype(bool)
        off = np.hypot(*(places - at).T)
        assert painted[off <= radius].all() and not painted[off > radius + size * np.sqrt(2.0)].any()
