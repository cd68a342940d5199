"""Searches without a prior: against the enumeration of every hypothesis, inside and outside the map, and bad input."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from slam_gym.association import RELOCATORS, gcbb, max_clique, random_sampling, resolve_relocator
from slam_gym.association.relocation.random_sampling import tries
from slam_gym.geometry import wrap_angle
from slam_gym.types import Locality
from tests.oracles import relocation as oracles

NAMES = ["gcbb", "max_clique", "random_sampling", "spectral"]
LOCALITIES = ["everything", "distance", "covisibility"]
KEEPS = ["dense", "blocks", "none"]


def plant(seed, *, largest=5):
    rng = np.random.default_rng(seed)
    m, n = int(rng.integers(3, largest + 1)), int(rng.integers(3, 9))
    scan, landmarks, P = oracles.problem(rng, min(m, n), n, keep=KEEPS[seed % 3])
    return scan, landmarks, P, oracles.localities(rng, landmarks)


def check_against(found, best, scan, landmarks, P, *, ties=True):
    """`found` is one of the best hypotheses, located as the oracle does, and ties are the others elsewhere."""
    if not best:
        assert found.pairings == 0 and np.isnan(found.pose).all() and not found.ambiguous
        return
    assert found.pairings == len(best[0])
    if found.pairings == 2:  # with one degree of freedom and close points the optimum need not be the only one
        return
    distinct = {tuple(oracles.decisions(pairs, len(scan))): pairs for pairs in best}
    fits = {key: oracles.quick_fit(scan, landmarks, P, pairs) for key, pairs in distinct.items()}
    assert tuple(found.features) in distinct
    pose, covariance, distance = fits[tuple(found.features)]
    least = min(distance for _, _, distance in fits.values())
    assert found.joint_distance == pytest.approx(distance, rel=1e-4, abs=1e-6)
    assert found.joint_distance == pytest.approx(least, rel=1e-4, abs=1e-6)
    assert found.dof == 2 * len(best[0]) - 3
    np.testing.assert_allclose(found.pose[:2], pose[:2], atol=1e-4)
    if not ties:
        return
    elsewhere = 0
    for other, spread, _ in fits.values():
        delta = other - pose
        delta[2] = wrap_angle(delta[2])
        elsewhere += delta @ np.linalg.solve(covariance + spread, delta) >= chi2.ppf(0.99, 3)
    assert found.ties == elsewhere and found.ambiguous == (elsewhere > 0)


@pytest.mark.parametrize("locality", LOCALITIES)
@pytest.mark.parametrize("seed", range(50))
def test_gcbb_finds_the_best_of_all_hypotheses(seed, locality):
    scan, landmarks, P, localities = plant(seed)
    found = gcbb(scan, landmarks, localities[locality])
    best = oracles.gcbb(scan, landmarks, P, localities[locality], 0.99)
    if len(best) < 200:
        check_against(found, best, scan, landmarks, P)
    strict = gcbb(scan, landmarks, localities[locality], rivals=False)
    assert strict.pairings == found.pairings
    assert strict.effort.nodes <= found.effort.nodes and strict.ties == 0


@pytest.mark.parametrize("locality", LOCALITIES)
@pytest.mark.parametrize("seed", range(12))
def test_random_sampling_with_every_sample_finds_the_best_that_a_sample_leads_to(seed, locality):
    scan, landmarks, P, localities = plant(seed + 500, largest=4)
    found = random_sampling(scan, landmarks, localities[locality], p_fail=1e-12, p_good=0.5)
    check_against(found, oracles.random_sampling(scan, landmarks, P, localities[locality], 0.99), scan, landmarks, P)


@pytest.mark.parametrize("library", ["cliquematch", "igraph"])
@pytest.mark.parametrize("seed", range(12))
def test_max_clique_finds_the_largest_set_of_mutually_consistent_pairings(seed, library):
    pytest.importorskip(library)
    scan, landmarks, P, localities = plant(seed)
    for locality in localities.values():
        found = max_clique(scan, landmarks, locality, library=library)
        related = oracles.relation(locality, len(landmarks))
        best = [b for b in oracles.mutual(scan, landmarks, P, related, 0.99) if len(b) > 1]
        most = max(map(len, best), default=0)
        largest = [b for b in best if len(b) == most and oracles.holds(scan, landmarks, P, b, 0.99)]
        if largest:
            # mirror images are among these cliques, and may have a second optimum: ties are not compared
            check_against(found, largest, scan, landmarks, P, ties=False)
        else:
            assert found.pairings < max(most, 1)


def inside(seed, *, m=10, true=7, n=60, keep="dense"):
    """A scan from inside a large map, and where it was taken."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(0.0, 4.0 * np.sqrt(n), (n, 2))
    P = oracles.correlated(rng, places, 0.03, 0.02)
    mapped = places + (np.linalg.cholesky(P) @ rng.standard_normal(2 * n)).reshape(n, 2)
    pose = np.array([*(places.mean(0) + rng.uniform(-2, 2, 2)), rng.uniform(-np.pi, np.pi)])
    near = np.argsort(np.linalg.norm(places - pose[:2], axis=1))[: m + 2]
    seen = np.vstack([places[rng.permutation(near)[:true]], pose[:2] + rng.uniform(-8.0, 8.0, (m - true, 2))])
    points, noise = oracles.view(rng, pose, seen, 0.03)
    return pose, oracles.scan_of(points, noise), oracles.landmarks_of(mapped, P, keep=keep)


@pytest.mark.parametrize("name", ["gcbb", "random_sampling", "max_clique"])
def test_the_robot_is_found_inside_the_map_and_not_outside(name):
    search, right = RELOCATORS[name], 0
    for seed in range(25):
        pose, scan, landmarks = inside(seed)
        found = search(scan, landmarks, None)
        error = found.pose - pose
        right += found.accepted and np.hypot(*error[:2]) < 0.3 and abs(wrap_angle(error[2])) < np.radians(3.0)
        assert not search(inside(seed + 100)[1], landmarks, None).accepted
    assert right >= 22


def test_spectral_finds_the_robot_often_and_believes_nothing_outside():
    right = 0
    for seed in range(25):
        pose, scan, landmarks = inside(seed, m=8, true=8)
        found = RELOCATORS["spectral"](scan, landmarks, None)
        right += found.accepted and np.hypot(*(found.pose - pose)[:2]) < 0.3
        assert not RELOCATORS["spectral"](inside(seed + 100)[1], landmarks, None).accepted
    assert right >= 15


@pytest.mark.parametrize("name", NAMES)
def test_a_mirrored_map_is_not_taken_for_the_map(name):
    _, scan, landmarks = inside(1, m=9, true=9)
    mirrored = replace(landmarks, positions=landmarks.positions * [1.0, -1.0], covariance=np.empty((0, 0)))
    assert not RELOCATORS[name](scan, mirrored, None).accepted


@pytest.mark.parametrize("name", NAMES)
def test_two_equal_rooms_are_ambiguous(name):
    _, scan, landmarks = inside(2, m=8, true=8, n=16, keep="none")
    twice = oracles.landmarks_of(
        np.vstack([landmarks.positions, landmarks.positions + np.array([80.0, 0.0])]), 0.002 * np.eye(64), keep="none"
    )
    found = RELOCATORS[name](scan, twice, None)
    if name != "spectral":
        assert found.pairings >= 7 and found.ambiguous and found.ties >= 1 and not found.accepted


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("m", [0, 1, 2, 6])
@pytest.mark.parametrize("n", [0, 1, 3])
def test_few_measurements_and_few_features_have_a_defined_answer(name, m, n):
    rng = np.random.default_rng(m)
    scan = oracles.scan_of(rng.uniform(-3, 3, (m, 2)), np.tile(0.01 * np.eye(2), (m, 1, 1)))
    landmarks = oracles.landmarks_of(rng.uniform(-3, 3, (n, 2)), 0.01 * np.eye(2 * n), keep="none")
    found = RELOCATORS[name](scan, landmarks, None)
    assert found.features.shape == (m,) and found.pairings <= min(m, n) and not found.accepted
    assert found.min_pairings >= 3 and (found.pairings >= 2 or np.isnan(found.pose).all())


@pytest.mark.parametrize("name", NAMES)
def test_a_line_duplicates_and_exact_points_have_a_defined_answer(name):
    line = np.column_stack([np.arange(5.0), np.zeros(5)])
    doubled = np.vstack([line, line])
    for points, places, variance in ((line, line, 0.01), (line, doubled, 0.01), (line * [1.3, 1.0], line, 0.0)):
        scan = oracles.scan_of(points, np.tile(variance * np.eye(2), (5, 1, 1)))
        found = RELOCATORS[name](scan, oracles.landmarks_of(places, variance * np.eye(2 * len(places))), None)
        assert found.pairings != 1 and np.isfinite(found.joint_distance)
        assert np.isfinite(found.pose).all() or found.pairings == 0


@pytest.mark.parametrize("name", NAMES)
def test_bad_numbers_are_refused_by_name(name):
    _, scan, landmarks = inside(0, n=20)
    search, points, P = RELOCATORS[name], scan.points.copy(), landmarks.covariances.copy()
    points[3, 0], P[5] = np.nan, [[1.0, 2.0], [2.0, 1.0]]
    with pytest.raises(ValueError, match="measurement 3"):
        search(replace(scan, points=points), landmarks, None)
    with pytest.raises(ValueError, match=r"covariances\[5\]"):
        search(scan, replace(landmarks, covariances=P), None)
    with pytest.raises(ValueError, match=r"Locality.starts"):
        search(scan, landmarks, Locality(np.zeros(3, np.int64), np.empty(0, np.int64)))
    with pytest.raises(ValueError, match=r"Locality.members"):
        search(scan, landmarks, Locality(np.arange(21), np.full(20, 20)))


@pytest.mark.parametrize("name", NAMES)
def test_limits_are_reported(name):
    _, scan, landmarks = inside(0)
    found = RELOCATORS[name](scan, landmarks, None, node_limit=50)
    assert found.effort.limit_hit
    assert not RELOCATORS[name](scan, landmarks, None).effort.limit_hit
    assert found.effort.unary_tests > 0 and found.effort.seconds > 0.0


def test_same_seed_same_answer():
    _, scan, landmarks = inside(4)
    first, second = (random_sampling(scan, landmarks, seed=5) for _ in range(2))
    assert first.features.tolist() == second.features.tolist()
    assert replace(first.effort, seconds=0.0) == replace(second.effort, seconds=0.0)


def test_tries_are_those_of_the_formula():
    """The figures of the source: P_fail .05, p = 3."""
    found = [tries(0.05, p_good, 3) for p_good in (0.9, 0.8, 0.7, 0.6, 0.5, 0.3)]
    assert found == [3, 5, 8, 13, 23, 110] and tries(0.05, 1.0, 3) == 1
    _, scan, landmarks = inside(4)
    assert random_sampling(scan, landmarks, p_good=0.5).effort.tries == 23
    with pytest.raises(ValueError, match="p_fail"):
        random_sampling(scan, landmarks, p_fail=0.0)


def test_names_resolve():
    assert resolve_relocator("gcbb") is gcbb and resolve_relocator(gcbb) is gcbb
    assert resolve_relocator("slam_gym.association.relocation.gcbb:gcbb") is gcbb
    with pytest.raises(ValueError, match="random_sampling"):
        resolve_relocator("nothing")


@pytest.mark.parametrize("locality", LOCALITIES)
@pytest.mark.parametrize("seed", range(20))
def test_outwards_is_the_same_search_with_the_measurements_sorted_from_their_centre(seed, locality):
    scan, landmarks, _, localities = plant(seed)
    order = np.argsort(np.hypot(*(scan.points - scan.points.mean(axis=0)).T))
    names = ("points", "covariances", "sizes", "size_variances")
    sorted_scan = replace(scan, **{name: getattr(scan, name)[order] for name in names})
    found = gcbb(scan, landmarks, localities[locality], outwards=True)
    expected = gcbb(sorted_scan, landmarks, localities[locality])
    np.testing.assert_array_equal(found.features[order], expected.features)
    assert found.effort.nodes == expected.effort.nodes and found.ties == expected.ties
