"""What a relocation walk shows: finite, scaled, and independent of where the map lies."""

from dataclasses import replace

import numpy as np
import pytest

from slam_gym.association.relocation.walk import RelocationWalk, WalkSpec, observe_walk, walk_shapes
from slam_gym.types import UNKNOWN_KIND
from tests.oracles import relocation as oracles
from tests.oracles import relocation_walks as walks


def test_sizes_off_looks_at_no_sizes():
    scan, landmarks, *_ = walks.easy(2)
    other = replace(scan, sizes=scan.sizes + 5.0)
    pair = [RelocationWalk(WalkSpec(sizes=False), s, landmarks) for s in (scan, other)]
    assert pair[0].problem.allowed.all()
    assert not RelocationWalk(WalkSpec(), other, landmarks).problem.allowed.all()
    for a, b in zip(*(observe_walk(walk, 20).values() for walk in pair)):
        np.testing.assert_array_equal(a, b)


def degenerate():
    scan, landmarks, *_ = walks.easy(4)
    nothing = oracles.landmarks_of(np.empty((0, 2)), np.empty((0, 0)))
    unknown = np.full(len(scan), np.nan)

    def some(k):
        return oracles.scan_of(scan.points[:k], scan.covariances[:k])

    line = oracles.scan_of(np.stack([np.arange(5.0), np.zeros(5)], axis=1), np.tile(1e-4 * np.eye(2), (5, 1, 1)))
    return {
        "as it is": (scan, landmarks),
        "no sizes": (replace(scan, sizes=unknown, size_variances=unknown), landmarks),
        "kinds": (replace(scan, kinds=np.arange(len(scan)) % 3), replace(landmarks, kinds=np.arange(25) % 3)),
        "kinds unknown": (replace(scan, kinds=np.full(len(scan), UNKNOWN_KIND)), landmarks),
        "no measurements": (some(0), landmarks),
        "one": (some(1), landmarks),
        "two": (some(2), landmarks),
        "empty map": (scan, nothing),
        "nothing at all": (some(0), nothing),
        "more measurements than features": (scan, oracles.landmarks_of(landmarks.positions[:3], 1e-4 * np.eye(6))),
        "on a line": (line, oracles.landmarks_of(np.stack([np.arange(9.0), np.zeros(9)], 1), 1e-4 * np.eye(18))),
        "all in one place": (oracles.scan_of(np.ones((4, 2)), np.tile(np.eye(2), (4, 1, 1))), landmarks),
        "no noise": (oracles.scan_of(scan.points, np.zeros((len(scan), 2, 2))), landmarks),
    }


@pytest.mark.parametrize("case", degenerate())
def test_observations_are_finite_and_in_range_whatever_scan_and_map(case):
    scan, landmarks = degenerate()[case]
    rng = np.random.default_rng(0)
    walk, shapes = RelocationWalk(WalkSpec(5, node_limit=60), scan, landmarks), walk_shapes(5, 6)
    while True:
        observation = observe_walk(walk, 6)
        assert {name: part.shape for name, part in observation.items()} == {k: (a * b,) for k, (a, b) in shapes.items()}
        for name, part in observation.items():
            assert part.dtype == np.float32 and np.isfinite(part).all() and (np.abs(part) <= 1.0).all(), name
        if walk.done:
            break
        walk.take(int(rng.choice(np.flatnonzero(walk.mask))))
    answer = walk.answer()
    assert answer.features.shape == (len(scan),) and answer.effort.nodes <= 60
    assert np.isfinite(answer.pose).all() == (answer.pairings >= 2)


def test_nothing_observed_depends_on_where_the_map_lies():
    scan, landmarks, P, localities, _ = walks.easy(6)
    C = oracles.rotation(2.0)
    T = np.kron(np.eye(len(landmarks)), C)
    kept = "dense" if len(landmarks.covariance) else "blocks" if len(landmarks.blocks) else "none"
    moved = oracles.landmarks_of(
        landmarks.positions @ C.T + [300.0, -70.0],
        T @ P @ T.T,
        keep=kept,
        sizes=landmarks.sizes,
        size_variances=landmarks.size_variances,
    )
    pair = [RelocationWalk(WalkSpec(order="as_scanned"), scan, m, localities["distance"]) for m in (landmarks, moved)]
    while not pair[0].at_leaf:
        for name, part in observe_walk(pair[0], 9).items():
            np.testing.assert_allclose(part, observe_walk(pair[1], 9)[name], atol=1e-5, err_msg=name)
        for walk in pair:
            walk.take(0 if walk.mask[0] else walk.spec.star)
    np.testing.assert_array_equal(pair[0].node.hypothesis, pair[1].node.hypothesis)
