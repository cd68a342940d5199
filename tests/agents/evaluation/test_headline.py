"""The headline: means that catastrophes count in, and paired differences to the truth with the same relocation."""

import numpy as np
import pytest

from agents.evaluation.headline import headline, subject
from agents.evaluation.tables import best_names

GAP = {"jcbb": 0.3, "jcbb + gcbb": 0.1, "true_association": 0.0, "true_association + gcbb": 0.05}


def records():
    """Worlds differ more than associators do; jcbb without relocation loses the last of eight."""
    rng = np.random.default_rng(0)
    found = []
    for setting in ("drift-1", "loop"):
        worlds = rng.uniform(0.1, 0.4, 8)
        for name, gap in GAP.items():
            for episode, base in enumerate(worlds):
                lost = name == "jcbb" and episode == 7
                found.append({"associator": name, "setting": setting, "episode": episode, "map_lost": float(lost),
                              "map_error": base + gap})  # fmt: skip
    return found


def test_means_medians_and_lost_maps_are_those_of_the_episodes():
    errors, _ = headline(records())
    assert [column.key for column in errors.columns] == ["drift-1", "loop", "mean", "median", "map_lost"]
    for name, row in errors.rows.items():
        own = [record for record in records() if record["associator"] == name]
        values = np.array([record["map_error"] for record in own])
        first = values[[record["setting"] == "drift-1" for record in own]]
        assert row["drift-1"].estimate == pytest.approx(first.mean())
        assert row["mean"].estimate == pytest.approx(values.mean()) and row["median"] == np.median(values)
        assert row["mean"].low < row["mean"].estimate < row["mean"].high
        assert row["map_lost"].estimate == (2 / 16 if name == "jcbb" else 0.0)
    column = next(column for column in errors.columns if column.key == "mean")
    assert "true_association" not in best_names({n: r["mean"] for n, r in errors.rows.items()}, column)


def test_gaps_are_paired_with_the_truth_of_the_same_relocation():
    _, gaps = headline(records())
    assert list(gaps.rows) == ["jcbb", "jcbb + gcbb"] and gaps.differences
    for name, expected in (("jcbb", 0.3), ("jcbb + gcbb", 0.05)):
        for value in gaps.rows[name].values():  # worlds cancel: no interval is left
            assert (value.low, value.estimate, value.high) == pytest.approx((expected,) * 3)


def test_without_the_truth_there_are_no_gaps():
    alone = [record for record in records() if record["associator"] == "jcbb"]
    assert len(headline(alone)) == 1


def test_names_tell_the_relocation():
    assert subject("jcbb", None) == "jcbb" and subject("jcbb", "gcbb") == "jcbb + gcbb"
