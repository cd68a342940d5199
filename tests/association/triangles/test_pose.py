"""Pairings about a pose: who may be paired, and the fit against the location of the same hypothesis."""

import dataclasses

import numpy as np

from slam_gym.association.relocation.location import locate
from slam_gym.association.triangles.index import FeatureIndex, indexed
from slam_gym.association.triangles.pose import is_local
from slam_gym.types import UNPAIRED, Locality
from tests.association.triangles.small_maps import field, is_near, landmarks_at, view


def test_pairings_stay_in_the_locality_of_the_first() -> None:
    rng = np.random.default_rng(12)
    truth = field(rng, 100)
    half = truth[:, 0] < np.median(truth[:, 0])
    members = [np.flatnonzero(half == half[j]) for j in range(100)]
    locality = Locality(np.concatenate([[0], np.cumsum([len(row) for row in members])]), np.concatenate(members))
    index = FeatureIndex(landmarks_at(truth))
    for _ in range(40):
        answer = index.relocate(view(rng, truth, 10, 1)[0], locality=locality, min_pairings=3)
        sides = {bool(half[j]) for j in answer.features if j != UNPAIRED}
        assert len(sides) <= 1


def test_sizes_and_kinds_tell_like_places_apart() -> None:
    rng = np.random.default_rng(13)
    room = rng.uniform(0.0, 20.0, (25, 2))
    both = landmarks_at(np.concatenate([room, room + np.array([40.0, 0.0])]))
    kinds = np.repeat([0, 1], 25)
    sizes, variances = np.repeat([0.2, 0.6], 25), np.full(50, 1e-4)
    scan, pose, _ = view(rng, room, 10, 0)
    m = len(scan)
    with_sizes = dataclasses.replace(scan, sizes=np.full(m, 0.2), size_variances=np.full(m, 1e-4))
    for landmarks, seen in (
        (dataclasses.replace(both, kinds=kinds), dataclasses.replace(scan, kinds=np.zeros(m, np.int64))),
        (dataclasses.replace(both, sizes=sizes, size_variances=variances), with_sizes),
    ):
        answer = indexed(seen, landmarks)
        assert answer.accepted and is_near(answer, pose)
    assert indexed(scan, both).ambiguous


def test_is_exact_without_noise() -> None:
    rng = np.random.default_rng(5)
    truth = field(rng, 300)
    index = FeatureIndex(landmarks_at(truth, 0.0))
    for _ in range(30):
        scan, pose, sources = view(rng, truth, 10, 3, sigma=0.0)
        answer = index.relocate(scan)
        assert np.array_equal(answer.features, sources)
        np.testing.assert_allclose(answer.pose, pose, atol=1e-7)


def test_the_fit_is_the_location_of_its_pairings() -> None:
    rng = np.random.default_rng(35)
    truth = field(rng, 120)
    halves = 0.04 * rng.standard_normal((120, 2, 2))
    errors = halves @ halves.transpose(0, 2, 1) + 1e-4 * np.eye(2)
    landmarks = dataclasses.replace(landmarks_at(truth), covariances=errors)
    index, found = FeatureIndex(landmarks), 0
    for _ in range(30):
        scan = view(rng, truth, 10, 2)[0]
        wide = scan.covariances * rng.uniform(1.0, 2.0, (10, 1, 1)) + 1e-3 * np.array([[1.0, 0.5], [0.5, 0.6]])
        scan = dataclasses.replace(scan, covariances=wide)
        answer = index.relocate(scan)
        if answer.pairings == 0:
            continue
        located = locate(scan, landmarks, answer.features)
        deviations = np.sqrt(np.diag(located.covariance))
        assert np.all(np.abs(answer.pose - located.pose) < 1e-3 * deviations)
        np.testing.assert_allclose(
            answer.covariance / np.outer(deviations, deviations),
            located.covariance / np.outer(deviations, deviations),
            atol=0.01,
        )
        np.testing.assert_allclose(answer.joint_distance, located.joint_distance, rtol=1e-3)
        found += 1
    assert found >= 27


def test_local_are_the_members_of_the_anchor_and_without_localities_all() -> None:
    rng = np.random.default_rng(36)
    rows = [np.flatnonzero(rng.random(15) < share) for share in np.linspace(0.0, 1.0, 15)]
    starts, members = np.concatenate([[0], np.cumsum([len(row) for row in rows])]), np.concatenate(rows)
    none = np.empty(0, np.int64)
    for anchor in range(15):
        for j in range(15):
            assert is_local(starts, members, anchor, j) == (j in rows[anchor])
            assert is_local(none, none, anchor, j)
