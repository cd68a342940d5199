"""GCBB, random sampling and cliques against every hypothesis there is, and what each of them promises besides."""

from dataclasses import replace

import networkx as nx
import numpy as np
import pytest

from benchmarks.locality import losses
from slam_gym.association import gcbb, max_clique, random_sampling
from slam_gym.association.relocation import cliques
from slam_gym.mapping.locality import locality_sizes
from slam_gym.simulation.surveyed_field import surveyed_field
from tests.oracles import relocation as oracles
from tests.oracles.statistics import for_seeds

LOCALITIES = ["everything", "distance", "covisibility"]


@pytest.mark.parametrize("locality", LOCALITIES)
@for_seeds(30)
def test_gcbb_finds_the_best_of_all_hypotheses(seed, locality):
    scan, landmarks, P, localities = oracles.small_problem(seed)
    found = gcbb(scan, landmarks, localities[locality])
    best = oracles.gcbb(scan, landmarks, P, localities[locality], 0.99)
    if len(best) < 200:
        oracles.check_against(found, best, scan, landmarks, P)
    strict = gcbb(scan, landmarks, localities[locality], rivals=False)
    assert strict.pairings == found.pairings
    assert strict.effort.nodes <= found.effort.nodes and strict.ties == 0


@pytest.mark.parametrize("locality", LOCALITIES)
@for_seeds(12)
def test_random_sampling_with_every_sample_finds_the_best_that_a_sample_leads_to(seed, locality):
    scan, landmarks, P, localities = oracles.small_problem(seed + 500, largest=4)
    found = random_sampling(scan, landmarks, localities[locality], tries=207)
    oracles.check_against(
        found, oracles.random_sampling(scan, landmarks, P, localities[locality], 0.99), scan, landmarks, P
    )


def test_same_seed_same_answer():
    _, scan, landmarks = oracles.inside(4)
    first, second = (random_sampling(scan, landmarks, seed=5) for _ in range(2))
    assert first.features.tolist() == second.features.tolist()
    assert replace(first.effort, seconds=0.0) == replace(second.effort, seconds=0.0)


def test_as_many_samples_as_asked_for():
    _, scan, landmarks = oracles.inside(4)
    assert random_sampling(scan, landmarks).effort.tries == 8
    assert random_sampling(scan, landmarks, tries=23).effort.tries == 23


@for_seeds(12)
def test_max_clique_finds_the_largest_set_of_mutually_consistent_pairings(seed):
    scan, landmarks, P, localities = oracles.small_problem(seed)
    for locality in localities.values():
        found = max_clique(scan, landmarks, locality)
        related = oracles.relation(locality, len(landmarks))
        best = [b for b in oracles.mutual(scan, landmarks, P, related, 0.99) if len(b) > 1]
        most = max(map(len, best), default=0)
        largest = [b for b in best if len(b) == most and oracles.holds(scan, landmarks, P, b, 0.99)]
        if largest:
            # mirror images are among these cliques, and may have a second optimum: ties are not compared
            oracles.check_against(found, largest, scan, landmarks, P, ties=False)
        else:
            assert found.pairings < max(most, 1)


def test_all_largest_cliques_are_found_and_no_other():
    rng = np.random.default_rng(0)
    for _ in range(60):
        a, b = np.triu_indices(int(rng.integers(2, 60)), 1)
        kept = rng.random(len(a)) < rng.uniform(0.02, 0.6)
        edges = np.column_stack([a[kept], b[kept]])
        maximal = [tuple(sorted(clique)) for clique in nx.find_cliques(nx.Graph(edges.tolist()))]
        most = max(map(len, maximal), default=0)
        found, complete = cliques.largest_cliques(edges)
        assert complete
        assert sorted(tuple(sorted(c)) for c in found.tolist()) == sorted(c for c in maximal if len(c) == most)


@pytest.mark.parametrize(("groups", "size"), [(9, 2), (30, 3)])
def test_too_many_largest_cliques_are_said_to_be(groups, size):
    """Of groups not joined in themselves: 2⁹ cliques, and 3³⁰, the most there can be (Moon and Moser, 1965)."""
    a, b = np.triu_indices(groups * size, 1)
    kept = a // size != b // size
    found, complete = cliques.largest_cliques(np.column_stack([a[kept], b[kept]]))
    assert not complete and found.shape == (256, groups)


# --- under locality a search is linear in the map: what is tested, and how large localities are -----------------------


@pytest.mark.parametrize("name", ["covisibility", "within 2r"])
def test_the_first_pairing_tests_every_feature_once_and_all_others_only_its_locality(name: str) -> None:
    rng = np.random.default_rng(3)
    area = surveyed_field(300, rng)
    local = area.locality(name)
    for _ in range(5):
        effort = gcbb(area.scan_inside(6, 1, rng).scan, area.landmarks, local).effort
        assert effort.unary_tests <= 6 * 300 + effort.nodes * locality_sizes(local, 300).max()


@pytest.mark.parametrize("name", ["covisibility", "two hops", "within 2r", "local maps"])
def test_localities_do_not_grow_with_the_map(name: str) -> None:
    areas = {n: surveyed_field(n, np.random.default_rng(n)) for n in (400, 1600)}
    small, large = (locality_sizes(area.locality(name), n).mean() for n, area in areas.items())
    assert large < 1.25 * small


def test_covisibility_loses_what_two_hops_and_distance_find() -> None:
    rng = np.random.default_rng(7)
    area = surveyed_field(200, rng)
    truths = [area.scan_inside(8, 2, rng).truth for _ in range(40)]
    lost = {
        name: losses(truths, area.locality(name)) for name in ("everything", "within 2r", "two hops", "covisibility")
    }
    assert set(lost["everything"].values()) == {0.0}
    assert lost["within 2r"]["pairs"] < 0.01 < lost["covisibility"]["pairs"] < 0.3
    assert lost["two hops"]["pairs"] < 0.2 * lost["covisibility"]["pairs"]
