"""Two robots' maps merged without a known relation; and what is served to the search instead of a scan."""

import functools
from dataclasses import dataclass, replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import slam_gym  # noqa: F401  (registers the environments)
from slam_gym.association.relocation.gcbb import gcbb
from slam_gym.bench.exploration import Pilot
from slam_gym.geometry import relative, transform, wrap_angle
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.locality import covisible, same_local_map
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.metrics.map_quality import map_error
from slam_gym.scenarios import get_scenario
from slam_gym.slam.local_maps import LocalMapSlam
from slam_gym.slam.merging import Merge, MergeSpec, as_scan, merge, shape_covariance
from slam_gym.types import Array, IntArray, Odometry, Scan

OFFICE = replace(get_scenario("office"), budget=500)


@dataclass(frozen=True)
class Robot:
    """What a robot brought home from an office, and the truth about it."""

    map: StochasticMap
    graph: CovisibilityGraph
    base: Array  # (3,) true pose of its base in W
    sources: IntArray  # (n,) true feature behind each of the map
    features: Array  # (N, 2) true positions in W
    log: list[tuple[Odometry, Scan]]
    poses: list[Array]  # true, in W


@functools.cache
def robot(world: int, number: int) -> Robot:
    """A robot that explored test world `world` with JCBB, from a start of its own."""
    env: Any = gym.make(
        "slam_gym/Explore-v0", scenario=OFFICE, split="test", action="twist", associator="jcbb"
    ).unwrapped
    seed = 100 * world + number
    env.reset(seed=seed, options={"world": world})
    pilot, over, step = Pilot(seed), False, 0
    log = [(env.episode.odometry, env.episode.scan)]
    while not over:
        _, _, over, _, _ = env.step(pilot.action(env.episode, step))
        log.append((env.episode.odometry, env.episode.scan))
        step += 1
    e = env.episode
    sources = e.identities.source_of(e.slam.map.ids)
    features = e.site.plan.features.positions
    return Robot(e.slam.map, e.slam.covisibility, e.base, sources, features, log, list(e.poses))


def merged(a: Robot, b: Robot, **settings: Any) -> Merge:
    spec = MergeSpec(**settings)
    return merge(a.map, b.map, gcbb, locality=covisible(a.graph), grouping=covisible(b.graph), spec=spec)


@pytest.mark.parametrize("world", [1, 2, 3])
def test_two_robots_in_one_office_merge_their_maps(world: int) -> None:
    a, b = robot(world, 0), robot(world, 1)
    result = merged(a, b)
    assert result.map is not None
    right = a.sources[result.pairs[:, 0]] == b.sources[result.pairs[:, 1]]
    common = set(a.sources.tolist()) & set(b.sources[b.sources >= 0].tolist())
    assert right.mean() > 0.95 and right.sum() > 0.8 * len(common)
    true = relative(a.base, b.base)
    assert np.hypot(*(result.relation - true)[:2]) < 0.4
    assert abs(wrap_angle(result.relation[2] - true[2])) < 0.05
    assert result.map.n == a.map.n + b.map.n - len(result.pairs)

    sources = np.concatenate([a.sources, np.delete(b.sources, result.pairs[:, 1])])
    real = sources >= 0
    error = transform(a.base, result.map.positions)[real] - a.features[sources[real]]
    own = transform(a.base, a.map.positions) - a.features[a.sources]
    rms, before = np.sqrt((error**2).sum(axis=1).mean()), np.sqrt((own[a.sources >= 0] ** 2).sum(axis=1).mean())
    assert rms < max(0.3, 2.0 * before)
    both = map_error(transform(a.base, result.map.confirmed), a.features, 0.5)
    for one in (a, b):
        assert both < map_error(transform(one.base, one.map.confirmed), a.features, 0.5) - 0.05
    assert np.linalg.eigvalsh(result.map.covariance).min() > -1e-9


@pytest.mark.parametrize(("first", "second"), [(1, 3), (3, 1), (1, 4), (4, 3), (3, 4), (4, 1)])
def test_maps_of_different_offices_are_not_merged(first: int, second: int) -> None:
    result = merged(robot(first, 0), robot(second, 1))
    assert result.map is None
    assert len(result.pairs) < 0.3 * max(result.expected, 10)


def test_merging_the_other_way_round_finds_the_inverse_relation() -> None:
    a, b = robot(4, 0), robot(4, 1)
    there, back = merged(a, b), merged(b, a)
    assert there.map is not None and back.map is not None
    np.testing.assert_allclose(relative(there.relation, np.zeros(3)), back.relation, atol=0.3)
    assert len(set(map(tuple, there.pairs.tolist())) & {(j, i) for i, j in back.pairs.tolist()}) > 0.9 * len(back.pairs)


def test_ids_of_both_maps_live_on() -> None:
    a, b = robot(4, 0), robot(4, 1)
    result = merged(a, b)
    assert result.map is not None
    ids = result.map.ids
    assert len(set(ids.tolist())) == len(ids)
    np.testing.assert_array_equal(ids[: a.map.n], a.map.ids)
    raised = np.delete(b.map.ids, result.pairs[:, 1]) - ids[a.map.n :]
    assert len(set(raised.tolist())) == 1


def test_maps_stay_as_they_were_and_demands_are_kept() -> None:
    a, b = robot(4, 0), robot(4, 1)
    before = a.map.mean, b.map.mean
    assert merged(a, b, min_pairs=1000).map is None
    assert merged(a, b, min_fraction=1.0).map is None
    for old, new in zip(before, (a.map.mean, b.map.mean)):
        np.testing.assert_array_equal(old, new)


def test_local_maps_of_one_run_join_in_an_office_and_close_its_loops() -> None:
    """The log of a robot, replayed in local maps: joined it is as good a map; and where two local maps that do not
    follow each other overlap, the search finds their relation without being told how the robot came."""
    r = robot(4, 0)
    slam = LocalMapSlam(OFFICE.slam, 25)
    graphs, starts = [slam.slam.covisibility], [r.poses[0]]
    for pose, (odometry, scan) in zip(r.poses, r.log):
        slam.step(odometry, scan)
        if slam.slam.covisibility is not graphs[-1]:
            graphs.append(slam.slam.covisibility)
            starts.append(pose)
    assert len(slam.maps) > 4
    single = map_error(transform(r.base, r.map.confirmed), r.features, 0.5)
    joined = map_error(transform(r.base, slam.joined().confirmed), r.features, 0.5)
    assert joined < single + 0.1
    closed = 0
    for i in range(len(slam.maps)):
        for j in range(i + 2, len(slam.maps)):
            result = merge(slam.maps[i], slam.maps[j], gcbb, locality=covisible(graphs[i]))
            if result.map is not None:
                closed += 1
                true = relative(starts[i], starts[j])
                assert np.hypot(*(result.relation - true)[:2]) < 0.3
    assert closed > 0


def test_a_search_among_local_maps_loses_pairings_at_their_borders() -> None:
    """Scans as a map ends and the next begins, looked for in the joined map: covisibility finds what local maps split.

    Away from borders the two do equally well.
    """
    r = robot(4, 0)
    slam, borders = LocalMapSlam(OFFICE.slam, 20), []
    for step, (odometry, scan) in enumerate(r.log):
        before = len(slam.maps)
        slam.step(odometry, scan)
        if len(slam.maps) > before:
            borders.append(step)
    joined = slam.joined()
    landmarks, maps, together = joined.landmarks(), slam.locality(joined), slam.covisible(joined)
    counts = []
    for border in borders:
        scan = r.log[border][1]
        if len(scan) >= 6:
            counts.append([gcbb(scan, landmarks, locality).pairings for locality in (maps, together, None)])
    split, whole, everything = np.array(counts).T
    assert len(counts) >= 4
    assert split.sum() < 0.9 * whole.sum()
    assert whole.sum() > 0.9 * everything.sum()


# --- a group as a scan ------------------------------------------------------------------------------------------------


def drifting(rng: np.random.Generator, n: int) -> StochasticMap:
    """A map of n features that share most of their errors, as after a long way from its base."""
    m = StochasticMap(MapSpec(unconfirmed_age=None))
    m.predict(Odometry(np.array([20.0, 5.0, 1.0]), np.diag([0.8, 0.8, 0.1]) ** 2))
    for _ in range(n):
        m.predict(Odometry(np.array([0.3, 0.0, 0.1]), np.diag([0.02, 0.02, 0.01]) ** 2))
        unknown = np.full(1, np.nan)
        m.add(Scan(rng.uniform(-3, 3, (1, 2)), 0.02**2 * np.eye(2)[None], unknown, unknown), np.array([0]))
    return m


def block_diagonal(blocks: Array) -> Array:
    out = np.zeros((2 * len(blocks), 2 * len(blocks)))
    for i, block in enumerate(blocks):
        out[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = block
    return out


def without_pose(points: Array, S: Array) -> Array:
    """The information that errors with covariance S hold once a rigid motion has been fitted to them: D² = eᵀ(·)e."""
    G = np.zeros((2 * len(points), 3))
    G[0::2, 0] = G[1::2, 1] = 1.0
    G[0::2, 2], G[1::2, 2] = -points[:, 1], points[:, 0]
    W = np.linalg.inv(S)
    out: Array = W - W @ G @ np.linalg.inv(G.T @ W @ G) @ G.T @ W
    return out


@pytest.mark.parametrize("seed", range(25))
def test_a_group_never_claims_more_than_the_map_knows(seed: int) -> None:
    """D² of any error, a pose being fitted, is at most what the true covariance makes of it; for every subset too."""
    rng = np.random.default_rng(seed)
    m, group = drifting(rng, 12), rng.permutation(12)[:8]
    scan = as_scan(m, group)
    entries = (3 + 2 * group[:, None] + np.arange(2)).ravel()
    P, claimed = m.covariance[np.ix_(entries, entries)], block_diagonal(scan.covariances)
    np.testing.assert_array_equal(scan.points, m.positions[group])
    for _ in range(5):
        subset = rng.permutation(8)[: int(rng.integers(2, 9))]
        rows = (2 * subset[:, None] + np.arange(2)).ravel()
        true = without_pose(scan.points[subset], P[np.ix_(rows, rows)] + 1e-12 * np.eye(len(rows)))
        ours = without_pose(scan.points[subset], claimed[np.ix_(rows, rows)])
        for _ in range(20):
            e = rng.standard_normal(len(rows))
            assert e @ ours @ e <= (1.0 + 1e-6) * (e @ true @ e)
    drift = np.trace(P) / len(P)
    assert np.trace(claimed) / len(claimed) < 0.1 * drift  # and yet what is common does not count


def test_shape_covariance_is_blind_to_rigid_motion() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-5, 5, (6, 2))
    G = np.zeros((12, 3))
    G[0::2, 0] = G[1::2, 1] = 1.0
    G[0::2, 2], G[1::2, 2] = -points[:, 1], points[:, 0]
    factor, common = rng.standard_normal((12, 12)), 100.0 * rng.standard_normal((3, 3))
    P = factor @ factor.T
    moved = P + G @ common @ common.T @ G.T
    np.testing.assert_allclose(shape_covariance(points, moved), shape_covariance(points, P), atol=1e-6)
    np.testing.assert_allclose(shape_covariance(points, P) @ G, 0.0, atol=1e-9)


# --- what is refused --------------------------------------------------------------------------------------------------


def test_maps_with_nothing_to_match_are_not_merged() -> None:
    small = StochasticMap()
    for pair in ((robot(4, 0).map, small), (small, robot(4, 0).map), (small, small)):
        result = merge(*pair, gcbb)
        assert result.map is None and not len(result.pairs)
        assert np.isnan(result.relation).all()


def test_settings_that_make_no_sense_are_refused() -> None:
    m = robot(4, 0).map
    bad = {"group_size": 2, "min_pairs": -1, "min_fraction": 1.5, "mapped_within": 0.0, "confidence": 1.0}
    for name, value in bad.items():
        with pytest.raises(ValueError, match=name):
            MergeSpec(**{name: value})
    for name in ("locality", "grouping"):
        with pytest.raises(ValueError, match=name):
            merge(m, m, gcbb, **{name: same_local_map([0])})
    with pytest.raises(ValueError, match="relocator"):
        merge(m, m, "no such search")
    for group in ([0, 1], [0, 1, m.n], [-1, 0, 1]):
        with pytest.raises(ValueError, match="group"):
            as_scan(m, np.array(group))
