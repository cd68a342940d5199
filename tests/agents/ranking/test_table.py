"""Places follow paired differences: what cannot be told apart shares one."""

from dataclasses import replace

import numpy as np
import pytest

from agents.ranking.entries import Ranked
from agents.ranking.protocol import PARTS, protocol
from agents.ranking.table import markdown, rows

PARTS_USED = [part for part in PARTS["agent"] if not part.needs_data]


def entry(name, shift, seed=0, noise=0.001):
    """Losses of worlds that differ much from each other, shifted by little."""
    hard, own = np.random.default_rng(1), np.random.default_rng(seed)
    losses = {
        part.setting: (hard.uniform(0.1, 0.9, part.count) + shift + noise * own.standard_normal(part.count)).tolist()
        for part in PARTS_USED
    }
    return Ranked("agent", name, protocol("agent").about, "w", losses, {"seconds": 1})


def test_small_differences_on_the_same_worlds_are_told_apart_and_noise_is_not():
    found = rows([entry("worse", 0.02, 1), entry("best", 0.0, 2), entry("tied", 0.0, 3, noise=0.03)])
    assert {row.entry.name: row.place for row in found} == {"best": 1, "tied": 1, "worse": 3}  # two are better
    worse = found[-1]
    assert worse.behind.low > 0.0 and worse.behind.high - worse.behind.low < 0.03 < worse.loss.high - worse.loss.low
    assert found[0].loss.estimate == pytest.approx(np.mean(list(found[0].columns.values())), abs=1e-9)


def test_the_ceiling_takes_nobodys_place_and_nobody_is_behind_it():
    found = rows([entry("true_association", -0.1), entry("jcbb", 0.0)])
    assert [(row.place, row.entry.name) for row in found] == [(0, "true_association"), (1, "jcbb")]
    assert found[1].behind.estimate == 0.0 and found[0].behind.high < 0.0


def test_columns_weigh_alike_whatever_their_number_of_worlds_and_nan_is_left_out():
    one = entry("a", 0.0)
    losses = {setting: [float(k == 0)] * len(v) for k, (setting, v) in enumerate(one.losses.items())}
    losses["office-small"][3] = float("nan")
    (row,) = rows([replace(one, losses=losses)])
    assert row.loss.estimate == pytest.approx(1.0 / len(losses)) and row.loss.low == row.loss.high


def test_what_cannot_be_compared_is_ranked_apart():
    other = replace(entry("b", 0.0), worlds="others")
    with pytest.raises(ValueError, match="not ranked together"):
        rows([entry("a", 0.0), other])
    shown = markdown([entry("a", 0.0), other])
    assert shown.count("### Agents") == 2 and "| 1 | a |" in shown
