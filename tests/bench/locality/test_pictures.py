"""The pictures of the benchmark of locality."""

import pytest

from slam_gym.bench.answers import ACCEPTED, count_answers
from slam_gym.bench.locality.effort import searches
from slam_gym.bench.locality.fields import LOCALITIES
from slam_gym.bench.locality.sweep import SweepSpec, sweep

pytest.importorskip("matplotlib")
from slam_gym.bench.locality import pictures


@pytest.fixture(scope="module")
def found():
    return sweep(SweepSpec(searches(), ("covisibility", "everything"), 3, 0, 1e9), [(50, 4), (100, 4), (100, 6)])


@pytest.mark.parametrize("axis", ["n", "m"])
def test_effort_has_a_panel_for_each_search_and_one_for_the_bound(found, axis):
    axes = pictures.effort(found, axis, "fixed").axes
    assert [ax.get_title(loc="left") or ax.get_title() for ax in axes] == [
        "GCBB: pairing tests per scan", "RS: pairing tests per scan", "hypotheses, fixed",
    ]  # fmt: skip
    marked = [line.get_label() for line in axes[0].lines if not line.get_label().startswith("_")]
    assert marked == ["covisibility", "everything"]


def test_losses_are_shown_of_every_locality(found):
    axes = pictures.losses([row for row in found.localities if row["m"] == 4]).axes
    assert len(axes) == 3 and all(len(ax.lines) == len(LOCALITIES) for ax in axes)


def test_answers_have_a_panel_for_each_search_and_size():
    flags = {"inside": True, "right": True, "pairings": 3, "accepted": True, "ambiguous": False}
    rows = [flags, flags | {"inside": False, "right": False}]
    counts = [
        {"search": name, "m": m, **count_answers(rows, asked)}
        for name in ("GCBB", "RS")
        for m in (4, 6, 8)
        for asked in (ACCEPTED, 2, 3)
    ]
    assert len(pictures.answers(counts, "title").axes) == 6
