"""The hash of triangles against the best of all hypotheses, and the laws it must keep."""

import dataclasses
import math

import numpy as np
import pytest

from slam_gym.association import gcbb
from slam_gym.association.relocation.constraints import map_arrays, relative_covariances
from slam_gym.association.relocation.triangles import FeatureIndex, indexed
from slam_gym.geometry import observe
from slam_gym.types import SPURIOUS, UNPAIRED, Landmarks, Locality, Scan
from slam_gym.world import corridor
from tests.oracles.geometry import rigid_motions

SIGMA = 0.05


def landmarks_at(positions, sigma=SIGMA):
    return Landmarks.from_points(positions, sigma=sigma)


def scan_at(points, sigma=SIGMA):
    return Scan.from_points(points, sigma=sigma)


def field(rng, n):
    """n features at 1/16 per m²."""
    return rng.uniform(0.0, 4.0 * math.sqrt(n), (n, 2))


def view(rng, truth, m, spurious, sigma=SIGMA, half=False):
    """A scan from a random place, its pose, and the feature behind each measurement."""
    seen = m - spurious
    pose = np.array([*rng.uniform(0.2, 0.8, 2) * truth.max(0), rng.uniform(-np.pi, np.pi)])
    near = np.argsort(np.hypot(*(truth - pose[:2]).T))[: 2 * seen if half else seen]
    sources = np.concatenate([rng.permutation(near)[:seen], np.full(spurious, SPURIOUS)])
    radius = np.hypot(*(truth[near[-1]] - pose[:2])) * np.sqrt(rng.random(spurious))
    angle = rng.uniform(-np.pi, np.pi, spurious)
    strays = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    points, order = np.concatenate([observe(pose, truth[sources[:seen]]), strays]), rng.permutation(m)
    return scan_at(points[order] + sigma * rng.standard_normal((m, 2)), sigma), pose, sources[order]


def is_near(answer, pose):
    turn = (answer.pose[2] - pose[2] + np.pi) % (2 * np.pi) - np.pi
    return bool(np.hypot(*(answer.pose[:2] - pose[:2])) < 0.3 and abs(turn) < math.radians(3.0))


@pytest.mark.parametrize("spurious", [0, 2, 3])
def test_as_many_pairings_as_the_best_of_all_hypotheses(spurious):
    rng = np.random.default_rng(spurious)
    for _ in range(40):
        truth = field(rng, 18)
        landmarks = landmarks_at(truth + SIGMA * rng.standard_normal(truth.shape))
        scan, pose, _ = view(rng, truth, 7, spurious, half=bool(rng.integers(2)))
        index = FeatureIndex(landmarks)
        answers = (index.relocate(scan, min_pairings=k) for k in (7, 6, 5, 4))
        answer = next((found for found in answers if found.pairings >= found.min_pairings), index.relocate(scan))
        best = gcbb(scan, landmarks)
        # Gates are taken at slightly different poses, which may cost either one pairing at their edge.
        assert abs(answer.pairings - best.pairings) <= 1
        if best.pairings >= 5 and not best.ambiguous:
            assert (answer.features == best.features)[best.features != UNPAIRED].sum() >= best.pairings - 1
            assert is_near(answer, pose)


@pytest.mark.parametrize("half", [False, True])
@pytest.mark.parametrize("spurious", [0, 3])
def test_recovers_the_pose_in_larger_maps(spurious, half):
    rng = np.random.default_rng(10 + spurious)
    truth = field(rng, 500)
    index = FeatureIndex(landmarks_at(truth + SIGMA * rng.standard_normal(truth.shape)))
    right = wrong_pairings = 0
    for _ in range(60):
        scan, pose, sources = view(rng, truth, 10, spurious, half=half)
        answer = index.relocate(scan)
        assert not answer.accepted or is_near(answer, pose)
        right += answer.accepted
        unlike = (answer.features != sources) & (answer.features != UNPAIRED) & (sources != SPURIOUS)
        wrong_pairings += unlike.sum() if answer.accepted else 0  # a feature that was not seen is nearer by chance
    assert right >= 57 and wrong_pairings <= 2


def test_refuses_what_was_never_mapped_and_mirror_images():
    rng = np.random.default_rng(3)
    truth = field(rng, 1000)
    index, accepted = FeatureIndex(landmarks_at(truth)), 0
    for m in (6, 8, 10, 14):
        for _ in range(30):
            accepted += index.relocate(view(rng, field(rng, 100), m, 0)[0]).accepted
            scan = view(rng, truth, m, 0)[0]
            accepted += index.relocate(scan_at(scan.points * [1.0, -1.0])).accepted
    assert accepted <= 8  # 2 % of 240 are expected at most


def test_the_corridor_looks_alike_from_four_sides_until_it_is_thinned():
    rng = np.random.default_rng(23)
    world = corridor.features()
    thinned = world[rng.random(len(world)) < 0.6]
    for features, symmetric in ((world, True), (thinned, False)):
        index, accepted = FeatureIndex(landmarks_at(features + 0.01 * rng.standard_normal(features.shape), 0.01)), 0
        for _ in range(40):
            turn = 0.5 * np.pi * rng.integers(4)
            heading = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
            pose = np.array([*(heading @ (np.array([rng.uniform(0.0, 10.0), 0.0]) - 5.0) + 5.0), turn])
            seen = observe(pose, features)
            seen = seen[(np.hypot(*seen.T) < corridor.RANGE) & (seen[:, 0] > 0.0)]
            answer = index.relocate(scan_at(seen + 0.01 * rng.standard_normal(seen.shape), 0.01))
            assert (answer.ambiguous and answer.ties >= 1) or not symmetric
            assert not answer.accepted or is_near(answer, pose)
            accepted += answer.accepted
        assert accepted == 0 if symmetric else accepted >= 24


def test_work_grows_slower_than_pairs_of_features():
    work = []
    for n in (500, 8000):
        rng = np.random.default_rng(15)
        truth = field(rng, n)
        index = FeatureIndex(landmarks_at(truth))
        effort = [index.relocate(view(rng, truth, 10, 3)[0], min_pairings=6).effort for _ in range(20)]
        work.append(np.median([e.nodes + e.binary_tests for e in effort]))
    # 16 times the features: linear at most, and far below one test per feature and measurement
    assert work[1] < 24 * work[0] and work[1] < 2.0 * 8000


def test_pairings_stay_in_the_locality_of_the_first():
    rng = np.random.default_rng(12)
    truth = field(rng, 100)
    half = truth[:, 0] < np.median(truth[:, 0])
    members = [np.flatnonzero(half == half[j]) for j in range(100)]
    locality = Locality(np.concatenate([[0], np.cumsum([len(row) for row in members])]), np.concatenate(members))
    index = FeatureIndex(landmarks_at(truth))
    for _ in range(40):
        answer = index.relocate(view(rng, truth, 10, 1)[0], locality, min_pairings=3)
        assert len({bool(half[j]) for j in answer.features if j != UNPAIRED}) <= 1


def test_sizes_and_kinds_tell_like_places_apart():
    rng = np.random.default_rng(13)
    room = rng.uniform(0.0, 20.0, (25, 2))
    both = landmarks_at(np.concatenate([room, room + np.array([40.0, 0.0])]))
    sizes, variances = np.repeat([0.2, 0.6], 25), np.full(50, 1e-4)
    scan, pose, _ = view(rng, room, 10, 0)
    sized = dataclasses.replace(scan, sizes=np.full(10, 0.2), size_variances=np.full(10, 1e-4))
    of_one_kind = dataclasses.replace(scan, kinds=np.zeros(10, np.int64))
    for landmarks, seen in (
        (dataclasses.replace(both, kinds=np.repeat([0, 1], 25)), of_one_kind),
        (dataclasses.replace(both, sizes=sizes, size_variances=variances), sized),
    ):
        answer = indexed(seen, landmarks)
        assert answer.accepted and is_near(answer, pose)
    assert indexed(scan, both).ambiguous


def test_drift_that_near_features_share_does_not_open_the_gates():
    rng = np.random.default_rng(11)
    truth = field(rng, 120)
    J = rigid_motions(truth)
    covariance = J @ np.diag([1.0, 1.0, 0.02]) ** 2 @ J.T + SIGMA**2 * np.eye(240)
    drawn = truth.ravel() + np.linalg.cholesky(covariance) @ rng.standard_normal(240)
    landmarks = Landmarks.from_points(drawn.reshape(-1, 2), covariance=covariance)
    relative, marginal = (
        np.trace(P, axis1=1, axis2=2) for P in (relative_covariances(map_arrays(landmarks)), landmarks.covariances)
    )
    assert np.median(relative) < 0.1 * np.median(marginal)
    index, right = FeatureIndex(landmarks), 0
    for _ in range(40):
        scan, _, sources = view(rng, truth, 10, 3)
        answer = index.relocate(scan)
        right += answer.accepted
        paired = (answer.features != UNPAIRED) & (sources != SPURIOUS)
        assert not answer.accepted or np.all(answer.features[paired] == sources[paired])
    assert right >= 36
    independent = landmarks_at(truth)
    np.testing.assert_array_equal(relative_covariances(map_arrays(independent)), independent.covariances)


def test_measurements_on_a_line_and_duplicates_are_handled():
    rng = np.random.default_rng(19)
    truth = np.concatenate([field(rng, 60), np.column_stack([np.cumsum(rng.uniform(1.0, 3.0, 12)), np.full(12, 50.0)])])
    index, pose = FeatureIndex(landmarks_at(truth, 0.01)), np.array([10.0, 48.0, 0.3])
    answer = index.relocate(scan_at(observe(pose, truth[60:]), 0.01))
    assert answer.accepted and is_near(answer, pose)
    twice = FeatureIndex(landmarks_at(np.concatenate([truth, truth]), 0.01))
    answer = twice.relocate(scan_at(observe(pose, truth[60:]), 0.01))
    assert is_near(answer, pose) and answer.pairings == 12
    assert not index.relocate(scan_at(np.zeros((6, 2)), 0.01)).accepted


def test_crowds_and_far_outliers_leave_the_tables_small():
    rng = np.random.default_rng(21)
    crowd = np.concatenate([rng.normal(0.0, 0.2, (400, 2)), field(rng, 200), [[1e6, -1e6]]])
    index = FeatureIndex(landmarks_at(crowd))
    table = index._hash
    assert len(table.corners) <= 64 * len(crowd) and table.raster.steps.nbytes < 1024 * len(crowd)
    FeatureIndex(landmarks_at(np.concatenate([field(rng, 40), np.full((400, 2), 3.0)])))  # at one place: it ends


@pytest.mark.parametrize("wrong", [{"min_pairings": 2}, {"confidence": 1.0}])
def test_settings_out_of_range_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        FeatureIndex(landmarks_at(np.eye(2))).relocate(scan_at(np.eye(2)), **wrong)


def test_a_crowd_of_likenesses_ends_at_the_limit_and_says_so():
    """On a lattice every pose looks like every other: there are more of them than are worth verifying."""
    lattice = np.stack(np.meshgrid(np.arange(12.0), np.arange(12.0)), axis=-1).reshape(-1, 2)
    scan, index = scan_at(np.random.default_rng(0).uniform(-4.0, 4.0, (20, 2))), FeatureIndex(landmarks_at(lattice))
    bounded, short = index.relocate(scan, min_pairings=9), index.relocate(scan, min_pairings=9, node_limit=50)
    assert bounded.effort.limit_hit and short.effort.limit_hit
    assert short.effort.nodes < bounded.effort.nodes < 40_000
    assert not index.relocate(scan, min_pairings=20).effort.limit_hit
    assert index.relocate(scan, min_pairings=99).effort.tries == 0  # more than there are measurements


def test_one_uncertain_feature_does_not_hide_the_others():
    rng = np.random.default_rng(0)
    truth, sigmas = field(rng, 300), np.full(300, SIGMA)
    scan, _, sources = view(rng, truth, 15, 5)
    sigmas[np.setdiff1d(np.arange(300), sources)[0]] = 3.0
    answer = FeatureIndex(landmarks_at(truth, sigmas)).relocate(scan)
    assert answer.accepted and not answer.effort.limit_hit
    assert np.array_equal(answer.features[sources != SPURIOUS], sources[sources != SPURIOUS])
