"""The benchmark of locality: the bound exactly, and the laws of its worlds and its counts."""

import functools
import importlib.util
import itertools
from dataclasses import replace

import numpy as np
import pytest

from slam_gym.association.relocation.gcbb import gcbb
from slam_gym.bench.locality import locality
from slam_gym.bench.locality import tables as locality_tables
from slam_gym.bench.locality.acceptance import RULE, Outcome, outcomes, share
from slam_gym.bench.locality.bound import bound, enumerate_hypotheses, exact_bound, hypotheses, verify
from slam_gym.bench.locality.locality import searches
from slam_gym.bench.locality.sweep import Cell, Plan, growth, out_of_reach, power, sweep
from slam_gym.bench.locality.tables import Size
from slam_gym.bench.locality.worlds import LOCALITIES, FieldSpec, from_centre, inside, mapped_field, outside
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
    covisible = area.locality("covisibility")
    for j in range(60):
        assert covisible.of(j).tolist() == np.flatnonzero(together[j]).tolist()
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


def test_losses_are_those_of_the_first_pairing_and_none_where_all_is_local():
    rng = np.random.default_rng(7)
    area = mapped_field(200, rng)
    looks = [inside(area, 8, 2, rng) for _ in range(40)]
    lost = {name: out_of_reach(looks, area.locality(name)) for name in LOCALITIES}
    assert set(lost["everything"].values()) == {0.0}
    assert lost["within 2r"]["pairs"] < 0.01 < lost["covisibility"]["pairs"] < 0.3
    assert lost["two hops"]["pairs"] < 0.2 * lost["covisibility"]["pairs"]
    covisible, reached, whole, anyhow = area.locality("covisibility"), 0, 0, 0
    for look in looks:
        T = [j for j in look.truth if j != NONE]
        held = [[l for l in T[t:] if l in covisible.of(T[t])] for t in range(len(T))]
        reached += max(len(h) for h in held)
        whole += len(held[0]) == len(T)
        anyhow += any(all(l in covisible.of(j) for l in T) for j in T)
    assert lost["covisibility"]["pairings"] == pytest.approx(1.0 - reached / (6 * len(looks)))
    assert lost["covisibility"]["scans"] == pytest.approx(1.0 - whole / len(looks))
    assert lost["covisibility"]["anyhow"] == pytest.approx(1.0 - anyhow / len(looks))


def test_from_the_centre_out_a_scan_is_the_same_and_loses_less():
    rng = np.random.default_rng(8)
    area = mapped_field(400, rng)
    looks = [inside(area, 8, 2, rng) for _ in range(100)]
    sorted_ = [from_centre(look) for look in looks]
    for before, after in zip(looks, sorted_):
        away = np.hypot(*(after.scan.points - after.scan.points.mean(axis=0)).T)
        assert (np.diff(away) >= 0.0).all()
        told = {(*p, *R.ravel(), t) for p, R, t in zip(before.scan.points, before.scan.covariances, before.truth)}
        assert told == {(*p, *R.ravel(), t) for p, R, t in zip(after.scan.points, after.scan.covariances, after.truth)}
    locality = area.locality("covisibility")
    assert out_of_reach(sorted_, locality)["pairings"] < 0.7 * out_of_reach(looks, locality)["pairings"]
    assert out_of_reach(sorted_, locality)["pairs"] == out_of_reach(looks, locality)["pairs"]


def test_localities_do_not_grow_with_the_map():
    """The mean |L(j)|, the c that makes the bound linear, rises towards that of a map without edges."""
    for name in ("covisibility", "two hops", "within 2r", "local maps", "joined maps"):
        small, large = (
            locality_sizes(area.locality(name), len(area)).mean()
            for area in (mapped_field(n, np.random.default_rng(n)) for n in (400, 1600))
        )
        assert large < 1.25 * small


def run_of(search, locality, n, m, **measured):
    """A cell of made-up scans."""
    cell = Cell(search, locality, n, m)
    for name, values in measured.items():
        cell.values[name] = [float(value) for value in values]
    return cell


def test_fits_recover_the_exponents_that_counts_were_made_with():
    rng = np.random.default_rng(0)
    cells = [run_of("GCBB", "", n, 8, tests=3.0 * n**1.5 * rng.lognormal(0.0, 0.2, 40)) for n in (800, 1600, 3200)]
    fit = power(cells, lambda cell: cell.n, "tests", rng)
    assert fit.low < 1.5 < fit.high and fit.high - fit.low < 0.2
    cells = [run_of("GCBB", "", 400, m, nodes=7.0 * 1.8**m * np.ones(3)) for m in (4, 6, 8)]
    assert growth(cells, "nodes", rng).estimate == pytest.approx(1.8)
    assert growth(cells, "nodes", rng).low == pytest.approx(1.8)
    assert np.isnan(growth(cells[:1], "nodes", rng).estimate)


def test_pairing_tests_grow_linearly_under_locality_and_quadratically_without():
    """The law that the benchmark is about, on small maps; counts, not times."""
    plan = Plan(searches(), ("covisibility", "everything"), 10, 0, 1e12)
    cells, reaches = sweep(plan, [(200, 6), (400, 6), (800, 6)], lambda *_: 1.0)
    assert len(cells) == 12 and len(reaches) == 18
    for search in ("GCBB", "RS"):
        exponents = {
            name: power(
                [c for c in cells if (c.search, c.locality) == (search, name)],
                lambda cell: cell.n,
                "tests",
                np.random.default_rng(0),
            ).estimate
            for name in ("covisibility", "everything")
        }
        assert 0.7 < exponents["covisibility"] < 1.35
        assert 1.7 < exponents["everything"] < 2.35
    for cell in cells:
        if cell.locality == "everything":  # true pairings mostly pass gates of .99
            assert cell.recall > 0.75 and cell.mean("found") > 0.75
        assert cell.mean("nodes") <= hypotheses(np.full(cell.n, cell.n), cell.m)


def test_the_first_pairing_tests_every_feature_once_and_all_others_only_its_locality():
    """Unary tests of GCBB: at most n at the root's levels, and |L(j)| at each node below a first pairing."""
    rng = np.random.default_rng(3)
    area = mapped_field(300, rng)
    for name in ("covisibility", "within 2r"):
        local = area.locality(name)
        largest = locality_sizes(local, 300).max()
        for _ in range(5):
            effort = gcbb(inside(area, 6, 1, rng).scan, area.landmarks, local).effort
            assert effort.unary_tests <= 6 * 300 + effort.nodes * largest


def test_a_series_ends_where_it_costs_too_much_or_hits_its_limit():
    plan = Plan(searches(), ("covisibility", "everything"), 4, 0, 2e6)
    cells, _ = sweep(plan, [(50, 6), (100, 6), (200, 6)], lambda name, a, b: 1e9 if name == "everything" else 1.0)
    run = {(cell.locality, cell.n) for cell in cells}
    assert run == {("covisibility", 50), ("covisibility", 100), ("covisibility", 200), ("everything", 50)}
    capped = {"GCBB": functools.partial(gcbb, node_limit=20)}
    cells, _ = sweep(Plan(capped, ("covisibility",), 4, 0, 1e9), [(50, 6), (100, 6)], lambda *_: 1.0)
    assert len(cells) == 1 and cells[0].mean("limit") == 1.0


def test_the_same_seed_gives_the_same_counts():
    plan = Plan(searches(), ("two hops",), 3, 5, 1e9)
    first, second = (sweep(plan, [(100, 6)], lambda *_: 1.0)[0] for _ in range(2))
    for a, b in zip(first, second):
        assert {k: v for k, v in a.values.items() if k != "ms"} == {k: v for k, v in b.values.items() if k != "ms"}


def test_blocks_within_a_scan_s_reach_decide_as_the_whole_covariance_does():
    """All covariances of a map whose scans span no more than the blocks: the searches take the same decisions."""
    rng = np.random.default_rng(11)
    area = mapped_field(8, rng)
    whole = replace(
        area.landmarks,
        covariance=np.ascontiguousarray(dense(area.landmarks)),
        block_starts=np.empty(0, np.int64),
        block_columns=np.empty(0, np.int64),
        blocks=np.empty((0, 2, 2)),
    )
    for _ in range(20):
        look = inside(area, 4, 2, rng)
        a, b = gcbb(look.scan, area.landmarks), gcbb(look.scan, whole)
        assert a.features.tolist() == b.features.tolist() and a.effort.binary_tests == b.effort.binary_tests


def test_answers_are_counted_by_their_pairings_and_their_rivals():
    inside_ = run_of("", "", 9, 4, pairings=[4, 4, 3, 0], found=[1, 0, 1, 0], ambiguous=[0] * 4, accepted=[1, 1, 0, 0])
    outside_ = run_of("", "", 9, 4, pairings=[3, 3, 2, 0], found=[0] * 4, ambiguous=[0, 1, 0, 0], accepted=[1, 0, 0, 0])
    rule, two, three, four = outcomes(inside_, outside_)
    assert rule == Outcome(RULE, 1, 1, 2, 1, 3, 1)
    assert two == Outcome(2, 2, 1, 1, 3, 1, 2)
    assert three == Outcome(3, 2, 1, 1, 2, 2, 1)
    assert four == Outcome(4, 1, 1, 2, 0, 4, 0)


def test_intervals_of_shares_cover_them():
    assert (share(0, 300).low, share(0, 300).high) == (0.0, 0.01)
    assert share(5, 5).high == 1.0
    rng, covered = np.random.default_rng(0), 0
    for _ in range(400):
        interval = share(int(rng.binomial(40, 0.2)), 40)
        covered += interval.low <= 0.2 <= interval.high
    assert covered >= 0.94 * 400


def test_the_command_prints_its_tables_and_writes_files(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(locality, "QUICK", Size((50, 100), (4, 6), 50, 4, 1e7, 6, (6,)))
    monkeypatch.setattr(locality_tables, "LARGE", 50)
    locality.main(["--quick", "--out", str(tmp_path)])
    shown = capsys.readouterr().out
    for words in ("Equation 9.22", "Exponents in n", "Growth in m", "Gates", "Answers", "(n+1)^m", "rule"):
        assert words in shown
    assert "NO" not in shown.split("Localities")[0]
    names = {path.name for path in tmp_path.iterdir()}
    assert {"bound.csv", "map_size.csv", "measurements.csv", "localities.csv", "settings.csv", "answers.csv"} <= names
    if importlib.util.find_spec("matplotlib"):
        assert {"map_size.png", "measurements.png", "losses.png", "answers.png"} <= names
    with pytest.raises(SystemExit):
        locality.main(["--no-such-option"])
