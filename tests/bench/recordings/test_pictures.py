"""The picture of relocation on real data."""

import pytest

from slam_gym.bench.answers import count_answers

pytest.importorskip("matplotlib")
from slam_gym.bench.recordings.pictures import answers


def test_every_place_has_a_line_of_three_panels():
    flags = {"right": True, "pairings": 4, "accepted": True, "ambiguous": False}
    rows = [flags | {"inside": inside} for inside in (True, False)]
    counts = [
        {"place": place, "sizes": sizes, "search": search, **count_answers(rows, asked)}
        for place, sizes in (("park", "used"), ("park", "unknown"), ("room", "unknown"))
        for search in ("gcbb", "random_sampling", "indexed")
        for asked in (0, 3, 4, 5)
    ]
    axes = answers(counts).axes
    assert len(axes) == 9
    assert [text.get_text() for text in axes[2].get_legend().get_texts()] == ["GCBB", "RS", "feature index"]
