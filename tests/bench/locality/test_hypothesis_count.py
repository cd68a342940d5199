"""The bound, exactly: against all hypotheses written out."""

import itertools

import numpy as np
import pytest

from slam_gym.bench.locality.hypothesis_count import bound, enumerate_hypotheses, exact_bound, hypotheses, verify
from slam_gym.types import UNPAIRED, Locality


def listed(n: int, m: int, local: list[set[int]]) -> int:
    """Hypotheses with all later pairings local to the first one: every m-tuple is written out and looked at."""
    count = 0
    for decisions in itertools.product([UNPAIRED, *range(n)], repeat=m):
        paired = [j for j in decisions if j != UNPAIRED]
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
