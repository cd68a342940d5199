"""Sweeps count what they say, and end where they must."""

import functools

import numpy as np
import pytest

from slam_gym.association.relocation.gcbb import gcbb
from slam_gym.bench.locality.effort import searches
from slam_gym.bench.locality.fields import LOCALITIES, from_centre, inside, outside, surveyed_field
from slam_gym.bench.locality.sweep import SweepSpec, inside_and_outside, losses, relocate_in_field, sweep
from slam_gym.mapping.locality import locality_sizes
from slam_gym.types import UNPAIRED


def test_losses_are_those_of_the_first_pairing_and_none_where_all_is_local():
    rng = np.random.default_rng(7)
    area = surveyed_field(200, rng)
    truths = [inside(area, 8, 2, rng).truth for _ in range(40)]
    lost = {name: losses(truths, area.locality(name)) for name in LOCALITIES}
    assert set(lost["everything"].values()) == {0.0}
    assert lost["within 2r"]["pairs"] < 0.01 < lost["covisibility"]["pairs"] < 0.3
    assert lost["two hops"]["pairs"] < 0.2 * lost["covisibility"]["pairs"]
    covisible, reached, whole, anyhow = area.locality("covisibility"), 0, 0, 0
    for truth in truths:
        T = [j for j in truth if j != UNPAIRED]
        held = [[l for l in T[t:] if l in covisible.of(T[t])] for t in range(len(T))]
        reached += max(len(h) for h in held)
        whole += len(held[0]) == len(T)
        anyhow += any(all(l in covisible.of(j) for l in T) for j in T)
    assert lost["covisibility"]["pairings"] == pytest.approx(1.0 - reached / (6 * len(truths)))
    assert lost["covisibility"]["scans"] == pytest.approx(1.0 - whole / len(truths))
    assert lost["covisibility"]["anyhow"] == pytest.approx(1.0 - anyhow / len(truths))


def test_from_the_centre_out_less_is_lost():
    rng = np.random.default_rng(8)
    area = surveyed_field(400, rng)
    drawn = [inside(area, 8, 2, rng) for _ in range(100)]
    covisible = area.locality("covisibility")
    came, sorted_ = (losses([one.truth for one in scans], covisible) for scans in (drawn, map(from_centre, drawn)))
    assert sorted_["pairings"] < 0.7 * came["pairings"] and sorted_["pairs"] == came["pairs"]


def test_the_first_pairing_tests_every_feature_once_and_all_others_only_its_locality():
    """Unary tests of GCBB: at most n at the root's levels, and |L(j)| at each node below a first pairing."""
    rng = np.random.default_rng(3)
    area = surveyed_field(300, rng)
    for name in ("covisibility", "within 2r"):
        local = area.locality(name)
        largest = locality_sizes(local, 300).max()
        for _ in range(5):
            effort = gcbb(inside(area, 6, 1, rng).scan, area.landmarks, local).effort
            assert effort.unary_tests <= 6 * 300 + effort.nodes * largest


def test_a_series_ends_where_it_costs_too_much_or_hits_its_limit():
    points = [(50, 6), (100, 6), (200, 6)]
    spec = SweepSpec(searches(), ("covisibility", "everything"), 4, 0, 2e6)
    found = sweep(spec, points, lambda name, a, b: 1e9 if name == "everything" else 1.0)
    run = {(attempt["locality"], attempt["n"]) for attempt in found.attempts}
    assert run == {("covisibility", 50), ("covisibility", 100), ("covisibility", 200), ("everything", 50)}
    assert {row["n"] for row in found.localities} == {50, 100, 200}
    capped = SweepSpec({"GCBB": functools.partial(gcbb, node_limit=20)}, ("covisibility",), 4, 0, 1e9)
    found = sweep(capped, points[:2])
    assert {attempt["n"] for attempt in found.attempts} == {50} and all(a["limit hit"] for a in found.attempts)


def test_scans_are_fewer_where_they_are_expected_to_cost_more():
    spec = SweepSpec({"GCBB": gcbb}, ("everything",), 8, 0, 1.5e6)
    found = sweep(spec, [(50, 6), (100, 6)], lambda *_: 2.0)
    counts = [sum(attempt["n"] == n for attempt in found.attempts) for n in (50, 100)]
    tests = np.mean([attempt["pairing tests"] for attempt in found.attempts if attempt["n"] == 50])
    assert counts == [8, int(min(8, 1.5e6 / (2.0 * tests)))]


def test_the_same_seed_gives_the_same_counts():
    spec = SweepSpec(searches(), ("two hops",), 3, 5, 1e9)
    first, second = (sweep(spec, [(100, 6)]).attempts for _ in range(2))
    assert [row | {"ms": 0.0} for row in first] == [row | {"ms": 0.0} for row in second]


def test_scans_from_inside_and_outside_are_told_apart():
    records = inside_and_outside(gcbb, "two hops", (60, 6), 12, 0)
    assert [record["inside"] for record in records] == [True, False] * 12
    assert all(record["true pairings"] == (5 if record["inside"] else 0) for record in records)
    assert not any(record["right"] for record in records if not record["inside"])
    assert sum(record["right"] for record in records) > 8


def test_an_attempt_counts_its_right_pairings():
    rng = np.random.default_rng(2)
    area = surveyed_field(60, rng)
    drawn = inside(area, 6, 1, rng)
    found = relocate_in_field(gcbb, area, drawn, None)
    answer = gcbb(drawn.scan, area.landmarks)
    right = sum(a == t != UNPAIRED for a, t in zip(answer.features.tolist(), drawn.truth.tolist()))
    assert (found["right pairings"], found["true pairings"]) == (right, 5)
    assert found["all right"] == (right == 5) and found["nodes"] == answer.effort.nodes
    assert not relocate_in_field(gcbb, area, outside(area, 6, rng), None)["right"]
