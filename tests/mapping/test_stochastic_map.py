"""What a map keeps of its features, what it hands out, how features lie; its equations are those of `test_ekf`."""

import copy
import pickle
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from slam_gym.mapping.ekf import relative_covariance
from slam_gym.mapping.linear_algebra import is_covariance
from slam_gym.mapping.stochastic_map import MapSpec, MapState, StochasticMap
from slam_gym.types import UNKNOWN_KIND, UNPAIRED, Odometry, Scan
from tests.mapping.small_maps import KEEP, h, mapped, predicted
from tests.oracles.map import Q, make_scan, random_covariances

NOISE = np.tile(0.01 * np.eye(2), (3, 1, 1))


# --- features come and go ---------------------------------------------------------------------------------------------


def test_removal_is_marginalisation() -> None:
    m, _, _ = mapped()
    before, gone = m.copy(), np.array([7, 0, 3])
    kept = m.remove(gone)
    np.testing.assert_array_equal(kept, np.setdiff1d(np.arange(before.n), gone))
    rows = np.concatenate([[0, 1, 2], *([3 + 2 * j, 4 + 2 * j] for j in kept)])
    np.testing.assert_array_equal(m.mean, before.mean[rows])
    np.testing.assert_array_equal(m.covariance, before.covariance[np.ix_(rows, rows)])
    for name in ("ids", "seen", "first_seen", "last_seen", "sizes", "size_variances"):
        np.testing.assert_array_equal(getattr(m, name), getattr(before, name)[kept])
    np.testing.assert_array_equal(m.remove(np.arange(m.n)), [])
    assert m.n == 0 == len(predicted(m))


@pytest.mark.parametrize("duplicate", [StochasticMap.copy, copy.deepcopy, lambda m: pickle.loads(pickle.dumps(m))])
def test_copies_go_their_own_way(duplicate) -> None:
    m, _, _ = mapped(steps=5)
    other, mean, covariance = duplicate(m), m.mean, m.covariance
    rng = np.random.default_rng(0)
    scan = make_scan(h(m.mean, np.arange(3)).reshape(-1, 2) + 0.05, random_covariances(rng, 0.1, 3))
    for either in (other, m):
        either.predict(Odometry(np.array([0.1, 0.0, 0.1]), Q))
        either.update(scan, np.arange(3))
        either.add(scan, np.array([1]))
        if either is other:
            np.testing.assert_array_equal(m.mean, mean)
            np.testing.assert_array_equal(m.covariance, covariance)
    np.testing.assert_array_equal(m.mean, other.mean)
    np.testing.assert_array_equal(m.covariance, other.covariance)


# --- bookkeeping ------------------------------------------------------------------------------------------------------


def look(m: StochasticMap, *features: int) -> None:
    """Measure some features exactly where they are predicted, then end the step."""
    rows = np.array(features, dtype=np.int64)
    m.update(Scan.from_points(h(m.mean, rows).reshape(-1, 2), sigma=1.0), rows)
    m.end_of_step()


def fresh(m: StochasticMap, count: int) -> None:
    m.add(Scan.from_points(np.ones((count, 2)), sigma=1.0), np.arange(count))


def test_counts_the_steps_in_which_a_feature_was_seen() -> None:
    m = StochasticMap()
    fresh(m, 3)
    look(m, 0)
    np.testing.assert_array_equal(m.seen, [1, 1, 1])  # the step that added it
    look(m, 1, 1)
    look(m, 1, 2)
    np.testing.assert_array_equal(m.seen, [1, 3, 2])
    np.testing.assert_array_equal(m.first_seen, [0, 0, 0])
    np.testing.assert_array_equal(m.last_seen, [0, 2, 2])
    np.testing.assert_array_equal(m.provisional, [True, False, False])
    assert m.step == 3


def test_an_id_is_never_given_twice() -> None:
    m = StochasticMap()
    fresh(m, 4)
    m.remove(np.array([0, 2]))
    fresh(m, 1)
    np.testing.assert_array_equal(m.ids, [1, 3, 4])


def test_sizes_are_averaged_by_their_variances() -> None:
    m, R = StochasticMap(), np.tile(np.eye(2), (3, 1, 1))
    points = np.ones((3, 2))
    m.add(make_scan(points, R, np.array([0.5, np.nan, 0.7]), np.array([0.01, np.nan, 0.01])), np.arange(3))
    measured = make_scan(points, R, np.array([0.8, 0.3, np.nan]), np.array([0.02, 0.04, np.nan]))
    m.update(measured, np.arange(3))
    np.testing.assert_allclose(m.sizes, [0.6, 0.3, 0.7])
    np.testing.assert_allclose(m.size_variances, [0.01 * 0.02 / 0.03, 0.04, 0.01])


def test_kinds_are_those_last_reported_and_unknown_before() -> None:
    slam_map = StochasticMap()
    points = np.array([[1.0, 0.0], [2.0, 1.0], [0.0, 3.0]])
    slam_map.add(replace(make_scan(points, NOISE), kinds=np.array([1, UNKNOWN_KIND, 2])), np.arange(2))
    slam_map.add(make_scan(points, NOISE), np.array([2]))
    assert slam_map.kinds.tolist() == [1, UNKNOWN_KIND, UNKNOWN_KIND]
    told = replace(make_scan(points, NOISE), kinds=np.array([UNKNOWN_KIND, 0, 3]))
    slam_map.update(told, np.array([0, 1, UNPAIRED]))
    assert slam_map.kinds.tolist() == [1, 0, UNKNOWN_KIND] == predicted(slam_map, 9.0).kinds.tolist()


def test_what_is_handed_out_is_no_window_into_the_map() -> None:
    m, _, _ = mapped()
    before = m.mean, m.covariance, m.sizes, m.ids
    names = ("pose", "pose_covariance", "positions", "covariances", "mean", "covariance", "ids", "seen", "sizes")
    for name in (*names, "first_seen", "last_seen", "size_variances", "provisional"):
        getattr(m, name)[...] = 0
    for old, new in zip(before, (m.mean, m.covariance, m.sizes, m.ids)):
        np.testing.assert_array_equal(old, new)


# --- relocation -------------------------------------------------------------------------------------------------------


def test_landmarks_are_the_features_with_all_their_covariance_and_stay_as_they_were() -> None:
    slam_map = mapped(seed=5)[0]
    features = slam_map.landmarks()
    np.testing.assert_array_equal(features.positions.ravel(), slam_map.mean[3:])
    np.testing.assert_array_equal(features.covariance, slam_map.covariance[3:, 3:])
    before = features.covariance.copy()
    slam_map.update(make_scan(np.array([[1.0, 0.0]]), NOISE[:1]), np.array([0]))
    np.testing.assert_array_equal(features.covariance, before)


def test_a_robot_that_was_placed_knows_nothing_of_the_features_and_leaves_them_alone() -> None:
    slam_map = mapped(seed=6)[0]
    features, P = slam_map.mean[3:], slam_map.covariance[3:, 3:]
    covariance = np.diag([4.0, 4.0, 1.0])
    slam_map.place([1.0, 2.0, 7.0], covariance)
    np.testing.assert_allclose(slam_map.pose, [1.0, 2.0, 7.0 - 2.0 * np.pi])
    np.testing.assert_array_equal(slam_map.covariance[:3, :3], covariance)
    np.testing.assert_array_equal(slam_map.covariance[:3, 3:], 0.0)
    np.testing.assert_array_equal(slam_map.mean[3:], features)
    np.testing.assert_array_equal(slam_map.covariance[3:, 3:], P)
    with pytest.raises(ValueError, match=r"pose_covariance: a σ above 1e\+06"):
        slam_map.place([0.0, 0.0, 0.0], 1e300 * np.eye(3))


# --- how features lie to each other -----------------------------------------------------------------------------------


def test_what_is_told_of_some_features_is_that_of_the_whole_map() -> None:
    m, _, _ = mapped()
    P, x = m.covariance[3:, 3:], m.positions
    chosen = np.array([7, 2, 9])
    entries = (2 * chosen[:, None] + np.arange(2)).ravel()
    np.testing.assert_array_equal(m.covariance_of(chosen), P[np.ix_(entries, entries)])
    first, second = np.array([4, 0, 8]), np.array([0, 3, 5, 6])
    gate = 1e4
    found, told = m.distances_between(first, second, gate), [relative_covariance(m.arrays[1], 4, j) for j in second]
    for b, j in enumerate(second):
        for a, i in enumerate(first):
            if i == j:
                assert found[a, b] == np.inf
                continue
            D = np.hstack([np.eye(2), -np.eye(2)])
            rows = np.array([2 * i, 2 * i + 1, 2 * j, 2 * j + 1])
            S, apart = D @ P[np.ix_(rows, rows)] @ D.T, x[i] - x[j]
            distance = apart @ np.linalg.solve(S, apart)
            assert found[a, b] == (pytest.approx(distance, rel=1e-6) if distance < gate else np.inf)
            if i == 4:
                assert told[b] == pytest.approx((S[0, 0], S[0, 1], S[1, 1]), rel=1e-6, abs=1e-12)


# --- taken apart, and put together again ------------------------------------------------------------------------------


def used_map() -> StochasticMap:
    """A map that has lost features, so that ids are no indices, and knows some sizes and kinds."""
    m, _, _ = mapped()
    known = make_scan(np.ones((2, 2)), np.tile(np.eye(2), (2, 1, 1)), np.array([0.3, np.nan]), np.array([0.01, np.nan]))
    m.add(replace(known, kinds=np.array([3, UNKNOWN_KIND])), np.arange(2))
    m.remove(np.array([0, 4]))
    m.end_of_step()
    return m


def test_put_together_from_its_state_it_is_the_same_map_and_stays_so() -> None:
    m = used_map()
    again = StochasticMap.of_state(KEEP, m.state)
    scan = make_scan(predicted(m).positions[:3] + 0.05, np.tile(0.01 * np.eye(2), (3, 1, 1)))
    for each in (m, again):
        each.predict(Odometry(np.array([0.1, 0.0, 0.2]), Q))
        each.update(scan, np.array([2, 0, -1]))
        each.add(scan, np.array([2]))
        each.remove(np.array([1]))
        each.end_of_step()
    for field in fields(MapState):
        np.testing.assert_array_equal(getattr(m.state, field.name), getattr(again.state, field.name))


@pytest.mark.parametrize(
    "spoil",
    [
        lambda state: replace(state, mean=state.mean[:-1]),
        lambda state: replace(state, covariance=state.covariance[:, :-1]),
        lambda state: replace(state, mean=np.full_like(state.mean, np.nan)),
        lambda state: replace(state, covariance=-state.covariance),
    ],
)
def test_a_state_that_cannot_be_is_refused(spoil) -> None:
    with pytest.raises(ValueError, match="covariance"):
        StochasticMap.of_state(KEEP, spoil(used_map().state))


# --- what is refused --------------------------------------------------------------------------------------------------


TWO = Scan.from_points(np.ones((2, 2)), sigma=1.0)
BAD_SCANS = {
    "NaN point": replace(TWO, points=np.array([[1.0, 1.0], [1.0, np.nan]])),
    "indefinite": replace(TWO, covariances=np.array([np.eye(2), [[1.0, 2.0], [2.0, 1.0]]])),
    "asymmetric": replace(TWO, covariances=np.array([np.eye(2), [[1.0, 0.1], [0.2, 1.0]]])),
}


@pytest.mark.parametrize("name", BAD_SCANS)
def test_a_bad_measurement_is_refused_by_number_and_changes_nothing(name: str) -> None:
    m, _, _ = mapped()
    before = m.mean, m.covariance, m.seen
    with pytest.raises(ValueError, match="measurement 1"):
        m.update(BAD_SCANS[name], np.array([0, 1]))
    with pytest.raises(ValueError, match="measurement 1"):
        m.add(BAD_SCANS[name], np.array([1]))
    for old, new in zip(before, (m.mean, m.covariance, m.seen)):
        np.testing.assert_array_equal(old, new)
    m.update(BAD_SCANS[name], np.array([0, UNPAIRED]))  # unpaired, it does no harm


@pytest.mark.parametrize("features", [[0, -2], [0, 1000], [0], [0.9, 1.2], [True, False]])
def test_pairings_that_make_no_sense_are_refused(features: list[float]) -> None:
    m, _, _ = mapped()
    mean = m.mean
    with pytest.raises(ValueError, match="features"):
        m.update(TWO, np.array(features))
    np.testing.assert_array_equal(m.mean, mean)
    absent = np.array([m.n])
    for refusing in (m.remove, m.covariance_of, lambda features: m.distances_between(features, features, 1.0)):
        with pytest.raises(ValueError, match="features"):
            refusing(absent)
    for beyond in ([2], [-1], [True, False]):
        with pytest.raises(ValueError, match="measurements"):
            m.add(TWO, np.array(beyond))
    with pytest.raises(ValueError, match="features: bool"):
        m.remove(m.provisional)


def test_no_uncertainty_anywhere_is_refused() -> None:
    m, exact = StochasticMap(), replace(TWO, covariances=np.zeros((2, 2, 2)))
    m.add(exact, np.array([0]))
    with pytest.raises(ValueError, match="singular"):
        m.update(exact, np.array([0, UNPAIRED]))


@pytest.mark.parametrize(
    "arguments",
    [
        {"pose": [0.0, 0.0]},
        {"pose": [0.0, np.nan, 0.0]},
        {"pose_covariance": -np.eye(3)},
        {"pose_covariance": np.eye(2)},
        {"capacity": 0},
    ],
)
def test_a_map_that_cannot_start_says_why(arguments: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=next(iter(arguments))):
        StochasticMap(**arguments)


def test_a_saved_map_comes_back_as_it_was(tmp_path: Path) -> None:
    m = StochasticMap(MapSpec(confirmations=3), pose=[1.0, 2.0, 0.5])
    m.add(Scan.from_points([[3.0, 1.0], [4.0, -2.0]], sigma=0.1, sizes=[0.2, np.nan], size_sigma=0.05), np.arange(2))
    m.end_of_step()
    m.save(tmp_path / "map.npz")
    back = StochasticMap.load(tmp_path / "map.npz")
    StochasticMap().save(tmp_path / "empty.npz")
    assert StochasticMap.load(tmp_path / "empty.npz").n == 0
    assert back.spec == m.spec and (back.n, back.step, back.next_id) == (m.n, m.step, m.next_id)
    for name in ("mean", "covariance", "counted", "sized"):
        np.testing.assert_array_equal(getattr(back.state, name), getattr(m.state, name))


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"\x93NUMPY"])
def test_a_file_that_holds_no_map_is_named(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "map.npz").write_bytes(content)
    with pytest.raises(ValueError, match=r"map\.npz: no map"):
        StochasticMap.load(tmp_path / "map.npz")
    np.savez(tmp_path / "other.npz", mean=np.zeros(3))
    with pytest.raises(ValueError, match=r"other\.npz: no map"):
        StochasticMap.load(tmp_path / "other.npz")
    m = StochasticMap()
    m.add(TWO, np.arange(2))
    asymmetric, impossible, indefinite = m.covariance, m.covariance, m.covariance
    asymmetric[5, 3], impossible[3, 5], impossible[5, 3] = 1e3, 50.0, 50.0
    indefinite[3:6, 3:6] = [[1.0, 0.9, 0.9], [0.9, 1.0, -0.9], [0.9, -0.9, 1.0]]  # with correlations within ±1
    for name, damaged in (
        ("next_id", 1),
        ("step", -1),
        ("step", 1 << 60),
        *(("covariance", P) for P in (-m.covariance, asymmetric, impossible, indefinite)),
        ("counted", m.state.counted[:1]),
        ("counted", -m.state.counted),
        ("counted", np.array([[0, 1], *np.zeros((5, 2))], np.int64)),  # never seen
        ("mean", np.append(m.mean[:3], m.mean[3:] + 1e300)),
        ("sized", np.full((2, 2), np.inf)),
    ):
        m.save(tmp_path / "map.npz")
        np.savez(tmp_path / "map.npz", **{**np.load(tmp_path / "map.npz"), name: damaged})
        with pytest.raises(ValueError, match=rf"map\.npz: no map .*{name}"):
            StochasticMap.load(tmp_path / "map.npz")


# --- what is a covariance, and arrays that cannot be written to -------------------------------------------------------


def test_a_covariance_may_miss_symmetry_and_definiteness_by_rounding_only() -> None:
    A, flat = np.diag([1.0, 4.0, 9.0]), np.outer([1.0, -2.0, 0.5], [1.0, -2.0, 0.5])
    assert is_covariance(flat) and not is_covariance(-A) and not is_covariance(np.full((3, 3), np.inf))
    for entry, slight, much in (((0, 1), 1e-10, 1e-6), ((2, 0), 1e-10, 1e-6)):
        for change, fine in ((slight, True), (much, False)):
            B = A.copy()
            B[entry] += change
            assert is_covariance(B) is fine
    assert is_covariance(np.diag([1.0, -1e-10])) and not is_covariance(np.diag([1.0, -1e-6]))
