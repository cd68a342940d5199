"""Seeds: map triangles like a triple of measurements, against all triples of features; none of them mirrored."""

import dataclasses
import itertools

import numpy as np

from slam_gym.association.triangles.index import FeatureIndex
from slam_gym.association.triangles.seeds import _matches
from tests.association.triangles.small_maps import SIGMA, field, is_near, landmarks_at, store_of, view


def test_refuses_the_mirror_image() -> None:
    rng = np.random.default_rng(4)
    truth = field(rng, 200)
    index = FeatureIndex(landmarks_at(truth))
    for _ in range(40):
        scan, pose, _ = view(rng, truth, 10, 0)
        assert is_near(index.relocate(scan), pose)
        mirrored = dataclasses.replace(scan, points=scan.points * [1.0, -1.0])
        assert not index.relocate(mirrored).accepted


def test_every_triangle_within_the_gates_is_a_seed_and_few_others_are() -> None:
    rng, gate, doubt = np.random.default_rng(39), 6.63, 2.0 * SIGMA**2
    positions = field(rng, 60)
    index = FeatureIndex(landmarks_at(positions), reach=9.0, noise=0.07, triangles=1e4)
    store, ordered = store_of(index), np.array(list(itertools.permutations(range(60), 3)))
    A, B, C = positions[ordered].transpose(1, 0, 2)
    sides = np.column_stack([np.hypot(*(B - A).T), np.hypot(*(C - B).T), np.hypot(*(A - C).T)])
    (ux, uy), (vx, vy) = (B - A).T, (C - A).T
    once = (ux * vy > uy * vx) & (sides[:, 0] == sides.max(1)) & (sides[:, 0] <= 9.0)
    ordered, sides, compared_in_all = ordered[once], sides[once], 0
    for asked in sides[rng.permutation(len(sides))[:100]] + 0.05 * rng.standard_normal((100, 3)):
        like, compared = _matches(store.cells, store.pool, store.settings, gate, asked, np.full(3, doubt))
        seeds, off = {tuple(t) for t in like.tolist()}, np.abs(sides - asked).max(1)
        assert len(seeds) == len(like) <= compared
        within = {tuple(t) for t in ordered[off < np.sqrt(gate * (doubt + 2.0 * SIGMA**2))].tolist()}
        beyond = {tuple(t) for t in ordered[off < 1.1 * np.sqrt(gate * (doubt + 2.0 * SIGMA**2)) + 0.01].tolist()}
        assert within <= seeds <= beyond
        compared_in_all += compared
    assert compared_in_all < 0.5 * 100 * len(sides)
