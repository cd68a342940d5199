"""The benchmark of locality: the bound exactly, and the laws of its worlds and its counts."""

import itertools

import numpy as np
import pytest

from slam_gym.bench.locality_bound import bound, enumerate_hypotheses, exact_bound, hypotheses, verify
from slam_gym.bench.locality_sweep import out_of_reach
from slam_gym.bench.locality_worlds import LOCALITIES, FieldSpec, inside, mapped_field, outside
from slam_gym.geometry import observe
from slam_gym.mapping.locality import locality_sizes
from slam_gym.types import NONE, Locality


def listed(n: int, m: int, local: list[set[int]]) -> int:
    """Hypotheses with all later pairings local to the first one: every m-tuple is written out and looked at."""
    count = 0
    for decisions in itertools.product([NONE, *range(n)], repeat=m):
        paired = [j for j in decisions if j != NONE]
        count += not paired or set(paired[1:]) <= local[paired[0]]
    return count


def rows_of(local: list[set[int]]) -> Locality:
    starts = np.cumsum([0, *(len(members) for members in local)])
    return Locality(starts, np.array([j for members in local for j in sorted(members)], np.int64))


@pytest.mark.parametrize("seed", range(60))
def test_the_bound_holds_for_any_locality_and_is_exact_where_all_are_of_one_size(seed):
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(1, 6)), int(rng.integers(1, 5))
    local = [{j} for j in range(n)]
    for a, b in itertools.combinations(range(n), 2):
        if rng.random() < rng.choice([0.0, 0.4, 1.0]):
            local[a].add(b)
            local[b].add(a)
    counted = listed(n, m, local)
    sizes = np.array([len(members) for members in local])
    assert enumerate_hypotheses(n, m, rows_of(local)) == counted
    assert round(hypotheses(sizes, m)) == counted
    assert counted <= exact_bound(n, m, int(sizes.max())) <= (n + 1) ** m
    assert (counted == exact_bound(n, m, int(sizes.max()))) == (m == 1 or sizes.min() == sizes.max())
    assert bound(n, m, float(sizes.mean())) <= counted * (1 + 1e-12)


@pytest.mark.parametrize(("n", "m", "c"), list(itertools.product((1, 4, 6), (1, 3, 5), (1, 2, 3))))
def test_equation_9_22_is_met_exactly_by_local_maps_of_one_size(n, m, c):
    count = c * n
    local = [set(range(c * (j // c), c * (j // c) + c)) for j in range(count)]
    found = enumerate_hypotheses(count, m, rows_of(local)) if (c + 1) ** m * count < 1e5 else exact_bound(count, m, c)
    assert found == exact_bound(count, m, c) == round(bound(count, m, c))
    assert enumerate_hypotheses(c, m, None) == (c + 1) ** m == exact_bound(c, m, c)


def test_the_table_of_the_bound_holds_in_every_row():
    rows = verify(np.random.default_rng(0), (1, 2, 3))
    assert len(rows) > 20 and all(row["holds"] for row in rows)
    assert any(row["min c"] < row["max c"] for row in rows)
    for row in rows:
        assert row["each feature once"] <= row["counted"] <= row["9.22, max c"] <= row["(n+1)^m"]


def test_a_negative_size_is_refused():
    with pytest.raises(ValueError, match="negative"):
        exact_bound(3, -1, 2)
    with pytest.raises(ValueError, match="features"):
        mapped_field(0, np.random.default_rng(0))
    with pytest.raises(ValueError, match="none of"):
        mapped_field(5, np.random.default_rng(0)).locality("nearby")


def dense(landmarks):
    """(2n, 2n) from the blocks; only where all pairs have one."""
    n = len(landmarks)
    assert len(landmarks.blocks) == n * n
    return landmarks.blocks.reshape(n, n, 2, 2).transpose(0, 2, 1, 3).reshape(2 * n, 2 * n)


def test_map_errors_have_the_covariance_that_the_map_states():
    """NEES over maps of 8 features, all pairs of which a scan can span: its mean is 2n within sampling error."""
    nees, n = [], 8
    for seed in range(300):
        area = mapped_field(n, np.random.default_rng(seed))
        P = dense(area.landmarks)
        np.testing.assert_allclose(P, P.T, atol=1e-12)
        error = (area.landmarks.positions - area.features).ravel()
        nees.append(error @ np.linalg.solve(P, error))
    assert np.mean(nees) == pytest.approx(2 * n, abs=4.0 * np.sqrt(4 * n / 300))


@pytest.mark.parametrize("seed", range(4))
def test_blocks_are_kept_for_all_pairs_that_a_scan_can_span_both_ways(seed):
    area = mapped_field(150, np.random.default_rng(seed))
    landmarks = area.landmarks
    row = np.repeat(np.arange(150), np.diff(landmarks.block_starts))
    blocks = {(j, l): block for j, l, block in zip(row.tolist(), landmarks.block_columns.tolist(), landmarks.blocks)}
    for j, l in itertools.combinations(range(150), 2):
        if np.hypot(*(area.features[j] - area.features[l])) < 2.0 * area.spec.reach:
            np.testing.assert_allclose(blocks[j, l], blocks[l, j].T, atol=1e-12)
            spread = landmarks.covariances[j] + landmarks.covariances[l] - blocks[j, l] - blocks[l, j]
            assert np.linalg.eigvalsh(spread).min() > 0.0
            # errors are shared: neighbours are known better relative to each other than either in the map
            assert np.trace(blocks[j, l]) > 0.0


def test_the_field_is_as_dense_as_asked_and_numbered_as_first_seen():
    spec = FieldSpec()
    area = mapped_field(300, np.random.default_rng(1))
    assert len(area) / area.side**2 == pytest.approx(spec.density)
    first = []
    for j in range(300):
        local = np.array([observe(pose, area.features[j : j + 1])[0] for pose in area.path])
        first.append(np.flatnonzero((np.hypot(*local.T) <= spec.reach) & (local[:, 0] >= 0.0))[0])
    assert (np.diff(first) >= 0).all()
    assert (np.diff(area.map_of) >= 0).all() and area.map_of[0] == 0


def test_covisible_features_are_those_of_one_scan_of_the_pass():
    area = mapped_field(60, np.random.default_rng(2))
    together = np.eye(60, dtype=bool)
    for pose in area.path:
        local = observe(pose, area.features)
        seen = np.flatnonzero((np.hypot(*local.T) <= area.spec.reach) & (local[:, 0] >= 0.0))
        together[np.ix_(seen, seen)] = True
    locality = area.locality("covisibility")
    for j in range(60):
        assert locality.of(j).tolist() == np.flatnonzero(together[j]).tolist()
        assert area.locality("two hops").of(j).tolist() == np.flatnonzero(together[together[j]].any(axis=0)).tolist()


@pytest.mark.parametrize("m", [4, 8, 12])
def test_scans_show_what_they_say(m):
    rng = np.random.default_rng(m)
    area = mapped_field(200, rng)
    deviations = []
    for _ in range(60):
        look = inside(area, m, m // 4, rng)
        real = look.truth != NONE
        assert len(look.scan) == m and real.sum() == m - m // 4
        assert len(set(look.truth[real].tolist())) == real.sum()
        exact = observe(look.pose, area.features[look.truth[real]])
        assert (exact[:, 0] >= 0.0).all() and (np.hypot(*exact.T) <= area.spec.reach).all()
        for error, R in zip(look.scan.points[real] - exact, look.scan.covariances[real]):
            deviations.append(error @ np.linalg.solve(R, error))
        stray = outside(area, m, rng)
        assert len(stray.scan) == m and (stray.truth == NONE).all() and np.isnan(stray.pose).all()
    assert np.mean(deviations) == pytest.approx(2.0, abs=4.0 * 2.0 / np.sqrt(len(deviations)))


def test_what_cannot_be_seen_from_anywhere_is_not_promised():
    with pytest.raises(RuntimeError, match="no pose"):
        inside(mapped_field(5, np.random.default_rng(0)), 12, 2, np.random.default_rng(0))


def test_losses_are_those_of_the_best_first_pairing_and_none_where_all_is_local():
    rng = np.random.default_rng(7)
    area = mapped_field(200, rng)
    looks = [inside(area, 8, 2, rng) for _ in range(40)]
    lost = {name: out_of_reach(looks, area.locality(name)) for name in LOCALITIES}
    assert lost["everything"] == {"pairs": 0.0, "pairings": 0.0, "scans": 0.0}
    assert lost["within 2r"]["pairs"] < 0.01 < lost["covisibility"]["pairs"] < 0.3
    assert lost["two hops"]["pairs"] < 0.2 * lost["covisibility"]["pairs"]
    locality = area.locality("covisibility")
    best = [max(sum(l in locality.of(j) for l in T) for j in T) for T in (k.truth[k.truth != NONE] for k in looks)]
    assert lost["covisibility"]["pairings"] == pytest.approx(1.0 - sum(best) / (6 * len(looks)))


def test_localities_do_not_grow_with_the_map():
    """The mean |L(j)|, the c that makes the bound linear, rises towards that of a map without edges."""
    for name in ("covisibility", "two hops", "within 2r", "local maps", "joined maps"):
        small, large = (
            locality_sizes(area.locality(name), len(area)).mean()
            for area in (mapped_field(n, np.random.default_rng(n)) for n in (400, 1600))
        )
        assert large < 1.25 * small
