"""The feature index against brute force over all poses that two pairings imply, and the laws it must keep."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from scipy.stats import chi2

from slam_gym.association.triangles.index import FeatureIndex, indexed
from slam_gym.geometry import observe
from slam_gym.types import SPURIOUS, UNPAIRED, Array, Landmarks, Scan
from slam_gym.world import corridor
from tests.association.triangles.small_maps import SIGMA, assert_same, field, is_near, landmarks_at, scan_at, view


def brute_force(scan: Scan, landmarks: Landmarks) -> tuple[int, list[set[tuple[int, int]]]]:
    """Most pairings over the poses that any two pairings imply, fitted anew to what they bring: number, and which.

    Variances are equal for all here, so the fit is Umeyama's, unweighted.
    """
    z, F = scan.points, landmarks.positions
    variance = scan.covariances[0, 0, 0] + landmarks.covariances[0, 0, 0]
    best, found = 0, []
    for i, k in itertools.combinations(range(len(z)), 2):
        length = np.hypot(*(z[k] - z[i]))
        apart = np.hypot(*(F[:, None] - F[None]).transpose(2, 0, 1))
        gate = math.sqrt(chi2.ppf(0.99, 1) * 2.0 * variance)
        for j, l in np.argwhere(np.abs(apart - length) < gate):
            if j == l:
                continue
            pairs = [(i, int(j)), (k, int(l))]
            for _ in range(3):
                heading, shift = fit(z, F, pairs)
                pairs = around(z @ heading.T + shift, F, chi2.ppf(0.99, 2) * variance)
                if len(pairs) < max(best, 3):
                    break
            else:
                heading, shift = fit(z, F, pairs)
                rows, columns = np.array(pairs).T
                errors = F[columns] - (z[rows] @ heading.T + shift)
                if (errors**2).sum() / variance > chi2.ppf(0.99, 2 * len(pairs) - 3):
                    continue
                if len(pairs) > best:
                    best, found = len(pairs), []
                if set(pairs) not in found:
                    found.append(set(pairs))
    return best, found


def fit(z: Array, F: Array, pairs: list[tuple[int, int]]) -> tuple[Array, Array]:
    rows, columns = np.array(pairs).T
    a, b = z[rows] - z[rows].mean(0), F[columns] - F[columns].mean(0)
    angle = math.atan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
    heading = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    return heading, F[columns].mean(0) - heading @ z[rows].mean(0)


def around(places: Array, F: Array, gate: float) -> list[tuple[int, int]]:
    squares = ((places[:, None] - F[None]) ** 2).sum(2)
    pairs, used = [], set()
    for i in np.argsort(squares.min(1)):
        j = int(np.argmin(squares[i]))
        if squares[i, j] < gate and j not in used:
            pairs.append((int(i), j))
            used.add(j)
    return pairs


@pytest.mark.parametrize("spurious", [0, 2, 3])
def test_as_many_pairings_as_brute_force(spurious: int) -> None:
    rng = np.random.default_rng(spurious)
    for _ in range(40):
        truth = field(rng, 18)
        landmarks = landmarks_at(truth + SIGMA * rng.standard_normal(truth.shape))
        scan, pose, _ = view(rng, truth, 7, spurious, half=bool(rng.integers(2)))
        answer = FeatureIndex(landmarks).relocate(scan, min_pairings=4, exhaustive=True)
        most, hypotheses = brute_force(scan, landmarks)
        decided = {(i, int(j)) for i, j in enumerate(answer.features) if j != UNPAIRED}
        # Gates are taken at slightly different poses, which may cost either one pairing at their edge.
        assert abs(answer.pairings - most) <= 1
        if most >= 5 and len(hypotheses) == 1:
            assert len(decided & hypotheses[0]) >= most - 1
            assert is_near(answer, pose)


@pytest.mark.parametrize("half", [False, True])
@pytest.mark.parametrize("spurious", [0, 3])
def test_recovers_the_pose_in_larger_maps(spurious: int, half: bool) -> None:
    rng = np.random.default_rng(10 + spurious)
    truth = field(rng, 500)
    index = FeatureIndex(landmarks_at(truth + SIGMA * rng.standard_normal(truth.shape)))
    right = 0
    for _ in range(60):
        scan, pose, sources = view(rng, truth, 10, spurious, half=half)
        answer = index.relocate(scan)
        assert not answer.accepted or is_near(answer, pose)
        right += answer.accepted
        assert np.all(
            (answer.features == sources) | (answer.features == UNPAIRED) | (sources == SPURIOUS) | ~answer.accepted
        )
    assert right >= 57


def test_refuses_what_was_never_mapped() -> None:
    rng = np.random.default_rng(3)
    index = FeatureIndex(landmarks_at(field(rng, 1000)))
    accepted = sum(
        index.relocate(view(rng, field(rng, 100), m, 0)[0]).accepted for m in (6, 8, 10, 14) for _ in range(30)
    )
    assert accepted <= 4  # 2 % of 120 are expected at most


def test_says_ambiguous_where_two_places_look_alike() -> None:
    rng = np.random.default_rng(6)
    room = rng.uniform(0.0, 20.0, (25, 2))
    twin = FeatureIndex(landmarks_at(np.concatenate([room, room + np.array([40.0, 0.0])])))
    alone = FeatureIndex(landmarks_at(room))
    for _ in range(30):
        scan, pose, _ = view(rng, room, 10, 2)
        answer = twin.relocate(scan)
        assert answer.ambiguous and answer.ties >= 1 and not answer.accepted
        single = alone.relocate(scan)
        assert single.accepted and is_near(single, pose)


def test_the_corridor_has_four_places_like_every_one_until_it_is_thinned() -> None:
    rng = np.random.default_rng(23)
    world = corridor.features()
    thinned = world[rng.random(len(world)) < 0.6]
    for features, symmetric in ((world, True), (thinned, False)):
        index, accepted = FeatureIndex(landmarks_at(features + 0.01 * rng.standard_normal(features.shape), 0.01)), 0
        for _ in range(40):
            turn = 0.5 * np.pi * rng.integers(4)
            heading = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
            place = heading @ (np.array([rng.uniform(0.0, 10.0), 0.0]) - 5.0) + 5.0
            pose = np.array([*place, turn])
            seen = observe(pose, features)
            seen = seen[(np.hypot(*seen.T) < corridor.RANGE) & (seen[:, 0] > 0.0)]
            answer = index.relocate(scan_at(seen + 0.01 * rng.standard_normal(seen.shape), 0.01))
            assert answer.ambiguous or not symmetric
            assert not answer.accepted or is_near(answer, pose)
            accepted += answer.accepted
            if symmetric and answer.ties == 3:  # its own place, and those a quarter turn apart about the centre
                centre, at = np.array([5.0, 5.0]), answer.pose[:2]
                apart = np.hypot(*(place - centre)) - np.hypot(*(at - centre))
                quarters = (answer.pose[2] - turn) / (0.5 * np.pi)
                assert abs(apart) < 0.1 and abs(quarters - round(quarters)) < 0.05
        assert accepted == 0 if symmetric else accepted >= 24


def test_two_runs_are_equal() -> None:
    answers = []
    for _ in range(2):
        rng = np.random.default_rng(9)
        truth = field(rng, 300)
        index = FeatureIndex(landmarks_at(truth))
        answers.append([index.relocate(view(rng, truth, 12, 4)[0]) for _ in range(20)])
    for a, b in zip(*answers):
        assert_same(a, b)
        assert dataclasses.replace(a.effort, seconds=0.0) == dataclasses.replace(b.effort, seconds=0.0)


def test_work_grows_slower_than_pairs_of_features() -> None:
    work = []
    for n in (500, 8000):
        rng = np.random.default_rng(15)
        truth = field(rng, n)
        index = FeatureIndex(landmarks_at(truth))
        effort = [index.relocate(view(rng, truth, 10, 3)[0], min_pairings=6).effort for _ in range(20)]
        work.append(np.median([e.nodes + e.binary_tests for e in effort]))
    # 16 times the features: linear at most, and far below one test per feature and measurement
    assert work[1] < 24 * work[0] and work[1] < 2.0 * 8000


@pytest.mark.parametrize("m", [0, 1, 2])
def test_too_few_measurements_say_nothing(m: int) -> None:
    rng = np.random.default_rng(17)
    index = FeatureIndex(landmarks_at(field(rng, 50)))
    answer = index.relocate(scan_at(rng.uniform(-5.0, 5.0, (m, 2))))
    assert not answer.accepted and answer.pairings == 0 and np.isnan(answer.pose).all() and len(answer.features) == m


@pytest.mark.parametrize("n", [0, 1, 2])
def test_too_small_maps_know_nothing(n: int) -> None:
    rng = np.random.default_rng(18)
    landmarks = landmarks_at(rng.uniform(0.0, 5.0, (n, 2)))
    scan = scan_at(rng.uniform(-5.0, 5.0, (8, 2)))
    for answer in (FeatureIndex(landmarks).relocate(scan), indexed(scan, landmarks)):
        assert not answer.accepted and answer.pairings == 0


def test_measurements_on_a_line_and_duplicates_are_handled() -> None:
    rng = np.random.default_rng(19)
    truth = np.concatenate([field(rng, 60), np.column_stack([np.cumsum(rng.uniform(1.0, 3.0, 12)), np.full(12, 50.0)])])
    index = FeatureIndex(landmarks_at(truth, 0.01))
    pose = np.array([10.0, 48.0, 0.3])
    answer = index.relocate(scan_at(observe(pose, truth[60:]), 0.01))
    assert answer.accepted and is_near(answer, pose)
    twice = FeatureIndex(landmarks_at(np.concatenate([truth, truth]), 0.01))
    answer = twice.relocate(scan_at(observe(pose, truth[60:]), 0.01))
    assert is_near(answer, pose) and answer.pairings == 12
    same = index.relocate(scan_at(np.zeros((6, 2)), 0.01))
    assert not same.accepted


def test_bad_input_is_refused_by_name() -> None:
    rng = np.random.default_rng(20)
    positions = field(rng, 20)
    index = FeatureIndex(landmarks_at(positions))
    scan = view(rng, positions, 8, 0)[0]
    with pytest.raises(ValueError, match="measurement 3"):
        points = scan.points.copy()
        points[3] = np.nan
        index.relocate(dataclasses.replace(scan, points=points))
    with pytest.raises(ValueError, match="measurement 0"):
        index.relocate(dataclasses.replace(scan, covariances=-scan.covariances))
    with pytest.raises(ValueError, match="feature 1"):
        index.add([[0.0, 0.0], [np.inf, 0.0]], np.tile(np.eye(2), (2, 1, 1)))
    with pytest.raises(ValueError, match="feature 0"):
        index.add([[0.0, 0.0]], [[[1.0, 2.0], [2.0, 1.0]]])
    with pytest.raises(ValueError, match="covariances: shape"):
        index.add([[0.0, 0.0]], np.eye(2))
    assert index.n == 20
    for wrong in ({"min_pairings": 2}, {"confidence": 1.0}):
        with pytest.raises(ValueError):
            index.relocate(scan, **wrong)
    with pytest.raises(ValueError, match="landmarks: of 3"):
        index.relocate(scan, landmarks_at(positions[:3]))
    with pytest.raises(ValueError, match="reach"):
        FeatureIndex(reach=-1.0)
    with pytest.raises(ValueError, match="kept"):
        index.keep(np.array([3, 1]))


def test_a_crowd_of_likenesses_ends_at_the_default_limit_and_says_so():
    """On a lattice every pose looks like every other: there are more of them than are worth verifying."""
    lattice = np.stack(np.meshgrid(np.arange(12.0), np.arange(12.0)), axis=-1).reshape(-1, 2)
    landmarks = Landmarks.from_points(lattice, sigma=0.05)
    scan = Scan.from_points(np.random.default_rng(0).uniform(-4.0, 4.0, (20, 2)), sigma=0.05)
    index = FeatureIndex(landmarks)
    bounded, short = index.relocate(scan, min_pairings=9), index.relocate(scan, min_pairings=9, node_limit=50)
    assert bounded.effort.limit_hit and short.effort.limit_hit
    assert short.effort.nodes < bounded.effort.nodes < 40_000
    assert not index.relocate(scan, min_pairings=20).effort.limit_hit


def test_with_as_many_pairings_as_chance_hardly_ever_brings_the_search_ends_at_once() -> None:
    rng, tries, patiently = np.random.default_rng(48), 0, 0
    truth = field(rng, 1000)
    index = FeatureIndex(landmarks_at(truth))
    for _ in range(30):
        scan, pose, _ = view(rng, truth, 20, 11)
        answer = index.relocate(scan)
        other = index.relocate(scan, min_pairings=answer.min_pairings)
        assert answer.accepted == other.accepted and (not answer.accepted or is_near(answer, pose))
        np.testing.assert_array_equal(answer.features, other.features)
        tries, patiently = tries + answer.effort.tries, patiently + other.effort.tries
    assert tries < 0.8 * patiently
