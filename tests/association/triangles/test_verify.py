"""Poses held against the whole scan: a true one passes, one in the void or of wrong corners does not."""

import numpy as np

from slam_gym.association.triangles.index import FeatureIndex
from slam_gym.association.triangles.pose import FIT
from slam_gym.association.triangles.seeds import _arrange, _matches, _side
from slam_gym.association.triangles.verify import ALL, LIMIT, NODES, Found, _implied_poses, _meets, _promising, verify
from slam_gym.types import UNPAIRED, Array, Scan
from tests.association.triangles.small_maps import SIGMA, field, landmarks_at, look_at, store_of, view


def test_a_limit_is_reported() -> None:
    rng = np.random.default_rng(21)
    truth = field(rng, 300)
    index = FeatureIndex(landmarks_at(truth))
    assert index.relocate(view(rng, truth, 10, 3)[0], node_limit=3).effort.limit_hit
    assert not index.relocate(view(rng, truth, 10, 3)[0]).effort.limit_hit


def _verified(index: FeatureIndex, scan: Scan, corners: Array, triangles: Array, nodes: int = 1000) -> Found:
    """What is found of at least 6 pairings by the poses that put three measurements on each of some triangles."""
    m, look, store = len(scan), look_at(scan), store_of(index)
    found = Found(
        np.full((16, m), UNPAIRED),
        np.full((16, FIT), np.nan),
        np.zeros(16),
        np.array([5, 0, ALL]),
        np.zeros(7, np.int64),
        np.array([6, nodes, m + 1]),
    )
    seed, variance, inertia = _arrange(look, store, corners, UNPAIRED)
    seed.corners[:] = corners
    verify(look, store, seed, triangles.astype(np.int32), variance, inertia, found, False)
    return found


def test_a_true_pose_passes_and_one_in_the_void_does_not() -> None:
    rng, passed = np.random.default_rng(43), 0
    for _ in range(30):
        truth = field(rng, 100)
        scan, _, sources = view(rng, truth, 9, 0)
        corners = rng.permutation(9)[:3]
        alone = truth[sources[corners]] + [500.0, 0.0]  # a triangle like the true one, and nothing around
        index = FeatureIndex(landmarks_at(np.concatenate([truth, alone]) + SIGMA * rng.standard_normal((103, 2))))
        void = _verified(index, scan, corners, np.array([[100, 101, 102]]))
        assert void.state[1] == 0 and void.spent[NODES] == 1
        true = _verified(index, scan, corners, np.array([[100, 101, 102], sources[corners]]))
        assert true.spent[NODES] == 2
        if true.state[1] > 0:
            best = true.features[0]
            assert true.state[1] == 1 and true.state[0] == np.sum(best != UNPAIRED) >= 6
            assert np.sum(best == sources) >= 6 and np.array_equal(best[corners], sources[corners])
            passed += 1
    assert passed >= 27


def test_nothing_is_verified_beyond_the_limit_of_nodes() -> None:
    rng = np.random.default_rng(44)
    truth = field(rng, 100)
    scan, _, sources = view(rng, truth, 9, 0, sigma=0.01)
    corners, triangles = np.array([0, 1, 2]), np.tile(sources[:3], (4, 1))
    index = FeatureIndex(landmarks_at(truth))
    assert _verified(index, scan, corners, triangles, 3).spent[LIMIT] == 1
    assert _verified(index, scan, corners, triangles, 3).state[1] == 0
    enough = _verified(index, scan, corners, triangles, 34)
    assert enough.spent[LIMIT] == 0 and enough.state[1] == 1  # four times the same, recorded once; a fit counts 30


def test_bitmaps_turn_away_nothing_that_the_gates_would_not() -> None:
    rng, kept, given_up = np.random.default_rng(45), 0, 0
    for sigma in (0.01, 0.05, 0.12):
        truth = field(rng, 400)
        index = FeatureIndex(landmarks_at(truth, sigma), noise=0.07)
        store = store_of(index)
        for _ in range(8):
            look = look_at(view(rng, truth, 12, 6, sigma)[0])
            corners = rng.permutation(12)[:3]
            seed, _, _ = _arrange(look, store, corners, UNPAIRED)
            seed.corners[:] = corners
            for k in range(3):
                seed.sides[k], seed.doubts[k] = _side(look.points, look.noise, corners[k], corners[(k + 1) % 3])
            like, _ = _matches(store.cells, store.pool, store.settings, look.gates[0], seed.sides, seed.doubts)
            like = np.concatenate([like, rng.integers(400, size=(200, 3)).astype(np.int32)])
            poses = _implied_poses(store.positions, seed.corners, seed.offsets, like).T
            for asked in (np.full(9, True), np.arange(9) % 2 > 0, np.arange(9) == 0):
                allowed = int(asked.sum()) * 5 // 9
                chosen, all_poses = _promising(store, seed, asked, like, allowed)
                slowly = [at for at, pose in enumerate(poses) if _meets(store, seed, asked, tuple(pose), allowed)]
                assert chosen.tolist() == slowly and np.array_equal(all_poses, poses.T)
                kept, given_up = kept + len(chosen), given_up + len(like) - len(chosen)
    assert kept > 100 and given_up > 10 * kept
