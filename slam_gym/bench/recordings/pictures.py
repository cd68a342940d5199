"""The picture of relocation on real data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from slam_gym.bench.figures import BLUE, GREEN, INK, YELLOW, panels, proportions
from slam_gym.bench.records import Record, grouped

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SEARCHES = {"gcbb": ("GCBB", BLUE), "random_sampling": ("RS", YELLOW), "indexed": ("feature index", GREEN)}
_PANELS = {"right of inside": "right, inside", "wrong of inside": "wrong, inside", "wrong of outside": "wrong, outside"}


def answers(counts: Sequence[Record]) -> Figure:
    """Right inside, wrong inside and wrong outside, with 95 % intervals, by the number of pairings asked for."""
    lines = grouped(counts, "place", "sizes")
    figure, axes = panels(len(lines), 3, (10.5, 0.7 + 2.1 * len(lines)), sharex=True, sharey=True)
    for row, (key, line) in zip(axes, lines):
        for ax, name in zip(row, _PANELS):
            for k, (of_search, found) in enumerate(grouped(line, "search")):
                label, colour = _SEARCHES[of_search["search"]]
                style = {"color": colour, "marker": "o", "label": label}
                proportions(ax, found, name, shift=0.16 * (k - 1), **style)
        row[0].set(title=f"{key['place']}, sizes {key['sizes']}", ylabel="fraction of scans", ylim=(-0.03, 1.03))
    for ax, title in zip(axes[0], _PANELS.values()):
        ax.annotate(title, (0.5, 1.0), (0, 22), "axes fraction", "offset points", ha="center", color=INK, size=11)
    for ax in axes[-1]:
        ax.set_xlabel("pairings asked for")
    axes[0][2].legend(loc="upper right")
    return figure
