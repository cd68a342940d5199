"""Records are grouped and averaged by their headings."""

import numpy as np
import pytest

from slam_gym.bench.records import column, grouped, means, medians


def made_up(rng, count=60):
    return [
        {"search": str(rng.choice(["b", "a", "c"])), "n": int(rng.integers(3)), "hit": bool(rng.random() < 0.5), "i": i}
        for i in range(count)
    ]


@pytest.mark.parametrize("seed", range(10))
def test_every_record_is_in_one_group_and_groups_agree_in_their_key(seed):
    records = made_up(np.random.default_rng(seed))
    groups = grouped(records, "search", "n")
    assert sorted(r["i"] for _, group in groups for r in group) == list(range(60))
    for key, group in groups:
        assert all({name: r[name] for name in ("search", "n")} == key for r in group)
        assert [r["i"] for r in group] == sorted(r["i"] for r in group)


def test_values_come_in_the_order_in_which_they_first_appear():
    records = [{"a": x, "b": y} for x, y in (("z", 2), ("y", 1), ("z", 1), ("y", 2))]
    assert [tuple(key.values()) for key, _ in grouped(records, "a", "b")] == [("z", 2), ("z", 1), ("y", 2), ("y", 1)]
    assert grouped([], "a") == []


def test_figures_of_columns():
    records = [{"hit": True, "ms": 1.0}, {"hit": False, "ms": 2}, {"hit": True, "ms": 6.0}]
    assert column(records, "hit").tolist() == [1.0, 0.0, 1.0]
    assert means(records, "hit", "ms") == {"hit": pytest.approx(2 / 3), "ms": 3.0}
    assert medians(records, "ms") == {"ms": 2.0}
    assert np.isnan(means([], "ms")["ms"]) and np.isnan(medians([], "ms")["ms"])
